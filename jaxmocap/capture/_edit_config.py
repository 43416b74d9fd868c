"""Completing `capture.toml` in place: single values change, everything else stays to the last character."""

import re
import tomllib
from collections.abc import Sequence
from pathlib import Path

from jaxmocap._results import InputError

_CAMERA = re.compile(r"\s*\[\[\s*(?:camera|\"camera\"|'camera')\s*\]\]\s*(?:#.*)?$")
_HEADER = re.compile(r"\s*\[")
_OFFSET = re.compile(r"(\s*(?:offset|\"offset\"|'offset')\s*=\s*)([^\s#]+)(.*)$", re.DOTALL)
_KEY = re.compile(r"(\s*)[\w\"'.\-]+\s*=")


def with_offsets(text: str, offsets: Sequence[float], file: Path) -> str:
    """The text of `capture.toml` with these offsets, seconds, one per `[[camera]]` section, in order.

    Raises `InputError` if the file is laid out so that this cannot be done without changing anything else.
    """
    lines = text.splitlines(keepends=True)
    starts = [number for number, line in enumerate(lines) if _CAMERA.match(line.rstrip("\r\n"))]
    cannot = InputError(
        f"{file} cannot be completed in place, for its cameras are not written as one [[camera]] section each; write "
        "them so, as the README shows"
    )
    if len(starts) != len(offsets):
        raise cannot
    for start, offset in reversed(list(zip(starts, offsets, strict=True))):
        _set_offset(lines, start, f"{round(offset, 6) + 0.0!r}")
    edited = "".join(lines)
    wanted = _values(text)
    for camera, offset in zip(wanted["camera"], offsets, strict=True):
        camera["offset"] = round(offset, 6)
    if _values(edited) != wanted:
        raise cannot
    return edited


def _set_offset(lines: list[str], start: int, value: str) -> None:
    """Change or add `offset` in the section whose header is line `start`."""
    end = next((n for n in range(start + 1, len(lines)) if _HEADER.match(lines[n])), len(lines))
    for number in range(start + 1, end):
        found = _OFFSET.match(lines[number])
        if found is not None:
            lines[number] = f"{found[1]}{value}{found[3]}"
            return
    last, indent = start, ""
    for number in range(start + 1, end):
        found = _KEY.match(lines[number])
        if found is not None:
            last, indent = number, found[1]
    ending = "\r\n" if lines[start].endswith("\r\n") else "\n"
    if not lines[last].endswith("\n"):
        lines[last] += ending
    lines.insert(last + 1, f"{indent}offset = {value}{ending}")


def _values(text: str) -> dict:
    """What the text says, without a `frames` line, which is forgiven if it is not valid when a capture is opened."""
    kept = [line for line in text.removeprefix("\ufeff").splitlines() if not re.match(r"\s*frames\s*=", line)]
    return tomllib.loads("\n".join(kept))
