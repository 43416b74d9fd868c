"""What is known about the videos' synchronisation: from `sync.json`, which `sync` writes beside `capture.toml`."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ._config import CaptureConfig
from ._findings import Finding
from .synchronisation import SURE

SYNC_REPORT = "sync.json"
_BY_HAND = 0.002  # seconds: less is rounding


def check_sync(file: Path, config: CaptureConfig) -> Iterator[Finding]:
    """Per pair of cameras: methods, confidences and where they disagree; offsets that nothing has measured."""
    if len(config.camera) < 2:
        return
    report = file.parent / SYNC_REPORT
    if not report.is_file():
        if not any("offset" in entry.model_fields_set for entry in config.camera):
            yield Finding(
                "note",
                "sync",
                "no camera has an offset: the videos are taken to start at the same moment; if they do not, run "
                "jaxmocap sync first",
            )
        return
    try:
        record = json.loads(report.read_text(encoding="utf-8"))
        yield from _findings(record, config)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        yield Finding(
            "warning",
            "sync",
            f"{report} is not what sync writes ({type(error).__name__}: {error}); remove it, or run jaxmocap sync "
            f"{file.parent} again",
        )


def _findings(record: dict[str, Any], config: CaptureConfig) -> Iterator[Finding]:
    measured = {name: float(camera["offset_seconds"]) for name, camera in record["cameras"].items()}
    for entry in config.camera:
        if entry.name in measured and abs(measured[entry.name] - entry.offset) > _BY_HAND:
            yield Finding(
                "note",
                "sync",
                f"{entry.name} has the offset {entry.offset:g} s in capture.toml, where sync measured "
                f"{measured[entry.name]:g} s: changed since",
            )
    for note in record["notes"]:
        yield Finding("warning", "sync", str(note))
    for pair in record["pairs"]:
        yield _pair(pair)


def _pair(pair: dict[str, Any]) -> Finding:
    names, used, estimates = " and ".join(pair["cameras"]), pair["used"], pair["estimates"]
    if used is None:
        return Finding("note", "sync", f"{names} have nothing in common to compare them by; others tie them together")
    listed = ", ".join(
        f"{method} {one['offset_frames']:+.2f} (confidence {one['confidence']:.2f})"
        for method, one in estimates.items()
    )
    said = f"{names} are {estimates[used]['offset_frames']:+.2f} frames apart by {used}: {listed}"
    if len(estimates) == 1 and (used == "motion" or estimates[used]["confidence"] < SURE):
        return Finding(
            "warning",
            "sync",
            f"{said}; nothing else confirms it: look at a fast moment in both videos at frames that the capture pairs, "
            "correct offset in capture.toml where they differ, and flash a lamp or clap next time",
        )
    return Finding("note", "sync", said)
