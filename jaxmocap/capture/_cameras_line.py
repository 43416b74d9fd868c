"""Setting `cameras` in `capture.toml` in place: one line changes or is added, everything else stays."""

import re
import tomllib
from pathlib import Path

from jaxmocap._results import InputError

_CAMERAS = re.compile(r"(\s*(?:cameras|\"cameras\"|'cameras')\s*=\s*)(\"[^\"]*\"|'[^']*')(.*)$", re.DOTALL)
_HEADER = re.compile(r"\s*\[")
_KEY = re.compile(r"\s*[\w\"']+\s*=")


def with_cameras_line(text: str, cameras: str, file: Path) -> str:
    """The text of `capture.toml` with `cameras` naming this folder; comments and order are kept.

    Raises `InputError` if the file is laid out so that this cannot be done without changing anything else.
    """
    lines = text.splitlines(keepends=True)
    end = next((number for number, line in enumerate(lines) if _HEADER.match(line)), len(lines))
    found = [number for number in range(end) if _CAMERAS.match(lines[number])]
    if found:
        match = _CAMERAS.match(lines[found[0]])
        assert match is not None
        lines[found[0]] = f'{match[1]}"{cameras}"{match[3]}'
    else:
        keys = [number for number in range(end) if _KEY.match(lines[number])]
        after = keys[-1] + 1 if keys else 0
        ending = "\r\n" if lines and lines[0].endswith("\r\n") else "\n"
        if after and not lines[after - 1].endswith("\n"):
            lines[after - 1] += ending
        lines.insert(after, f'cameras = "{cameras}"{ending}')
    edited = "".join(lines)
    if _values(edited) != {**(_values(text) or {}), "cameras": cameras}:
        raise InputError(
            f'{file} cannot be completed in place; write the line cameras = "{cameras}" before the first [[camera]] '
            "by hand"
        )
    return edited


def _values(text: str) -> dict | None:
    """What the text says, without a `frames` line, which is forgiven if it is not valid when a capture is opened."""
    kept = [line for line in text.removeprefix("\ufeff").splitlines() if not re.match(r"\s*frames\s*=", line)]
    try:
        return tomllib.loads("\n".join(kept))
    except tomllib.TOMLDecodeError:
        return None
