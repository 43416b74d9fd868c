"""Completing `capture.toml` in place: single values change, everything else stays to the last character."""

import re
import tomllib
from collections.abc import Sequence
from pathlib import Path

from jaxmocap._results import InputError

_CAMERA = re.compile(r"\s*\[\[\s*(?:camera|\"camera\"|'camera')\s*\]\]\s*(?:#.*)?$")
_HEADER = re.compile(r"\s*\[")
_OFFSET = re.compile(r"(\s*(?:offset|\"offset\"|'offset')\s*=\s*)([^\s#]+)(.*)$", re.DOTALL)
_CAMERAS = re.compile(r"(\s*(?:cameras|\"cameras\"|'cameras')\s*=\s*)(\"[^\"]*\"|'[^']*')(.*)$", re.DOTALL)
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


def with_cameras_line(text: str, cameras: str, file: Path) -> str:
    """The text of `capture.toml` with `cameras` naming this folder; comments and order are kept.

    Raises `InputError` if the file is laid out so that this cannot be done without changing anything else.
    """
    lines = text.splitlines(keepends=True)
    end = next((number for number, line in enumerate(lines) if _HEADER.match(line)), len(lines))
    found = next((match for match in map(_CAMERAS.match, lines[:end]) if match is not None), None)
    if found is not None:
        lines[lines.index(found.string)] = f'{found[1]}"{cameras}"{found[3]}'
    else:
        keys = [number for number in range(end) if _KEY.match(lines[number])]
        _add_line(lines, keys[-1] if keys else None, f'cameras = "{cameras}"')
    edited = "".join(lines)
    try:
        done = _values(edited) == {**_values(text), "cameras": cameras}
    except tomllib.TOMLDecodeError:
        done = False
    if not done:
        raise InputError(
            f'{file} cannot be completed in place; write the line cameras = "{cameras}" before the first [[camera]] '
            "by hand"
        )
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
    _add_line(lines, last, f"{indent}offset = {value}")


def _add_line(lines: list[str], after: int | None, line: str) -> None:
    """Insert a line behind another one, or at the top, with the line ends of the file."""
    ending = "\r\n" if lines and lines[0].endswith("\r\n") else "\n"
    if after is not None and not lines[after].endswith("\n"):
        lines[after] += ending
    lines.insert(0 if after is None else after + 1, line + ending)


def _values(text: str) -> dict:
    """What the text says, without a `frames` line, which is forgiven if it is not valid when a capture is opened."""
    kept = [line for line in text.removeprefix("\ufeff").splitlines() if not re.match(r"\s*frames\s*=", line)]
    return tomllib.loads("\n".join(kept))
