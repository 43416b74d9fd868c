"""Spans of frames as they are written on the command line and in files, A:B."""

import re

_SPAN = re.compile(r"\s*(\d{0,9})\s*:\s*(\d{0,9})\s*", re.ASCII)


def read_span(text: str) -> tuple[int, int | None] | None:
    """Read A:B as (A, B), of which either may be left out: 0 and None then; None where the text is no span."""
    found = _SPAN.fullmatch(text)
    return None if found is None else (int(found[1] or 0), int(found[2]) if found[2] else None)
