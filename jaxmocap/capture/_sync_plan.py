"""What synchronising would write: a completed `capture.toml`, or a new capture made from videos."""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from jaxmocap._results import InputError

from ._capture import Capture
from ._config import CameraEntry, CaptureConfig, config_path, read_config
from ._edit_config import with_offsets
from ._video import VideoIndex, index_video
from .synchronisation import Progress, Span, Synchronisation, SyncMethod, synchronise


@dataclass(frozen=True)
class SyncPlan:
    """What synchronising would write.

    Attributes:
        file: the capture's `capture.toml`.
        text: its content.
        found: the offsets.
        copies: videos that belong into a new capture's folder, by their name there; none for a capture that exists.
    """

    file: Path
    text: str
    found: Synchronisation
    copies: Mapping[str, Path] = field(default_factory=dict)


def plan_sync(
    path: str | Path, method: SyncMethod = "auto", progress: Progress | None = None, span: Span = (0, None)
) -> SyncPlan:
    """Synchronise the videos of a capture, with or without cameras, by a span of their frames. Writes nothing.

    Raises `InputError` if `capture.toml` or a video cannot be used, or no method can decide.
    """
    file = config_path(path)
    config, findings = read_config(file)
    if config is None:
        raise InputError(next(finding.message for finding in findings if finding.severity == "error"))
    text = file.read_bytes().decode("utf-8")
    names = [entry.name for entry in config.camera]
    videos = [index_video(file.parent / entry.video) for entry in config.camera]
    found = synchronise(videos, names, method, progress, span)
    found = replace(found, notes=(*found.notes, *_consequences(file, config, videos, found)))
    return SyncPlan(file, with_offsets(text, found.offsets, file), found)


def _consequences(
    file: Path, config: CaptureConfig, videos: Sequence[VideoIndex], found: Synchronisation
) -> tuple[str, ...]:
    """List what else in `capture.toml` no longer fits, if anything."""
    entries = [
        entry.model_copy(update={"offset": offset}) for entry, offset in zip(config.camera, found.offsets, strict=True)
    ]
    try:
        Capture.from_config(file, config.model_copy(update={"camera": entries}), list(videos), [])
    except InputError as error:
        return (str(error),)
    return ()


def plan_new_capture(
    videos: Sequence[str | Path],
    folder: str | Path,
    method: SyncMethod = "auto",
    progress: Progress | None = None,
    span: Span = (0, None),
) -> SyncPlan:
    """Synchronise videos for a new capture in `folder`, whose cameras are named like the files, by a span of their
    frames. Writes nothing."""
    folder, paths = Path(folder), [Path(video) for video in videos]
    if len(paths) < 2:
        raise InputError(f"a new capture needs two or more videos, and {len(paths)} was given")
    indices = [index_video(path) for path in paths]
    refuse_single_pictures(indices)
    names = camera_names(paths)
    found = synchronise(indices, names, method, progress, span)
    copies = video_names(paths, names)
    text = new_capture_text(folder, found.frame, dict(zip(names, copies, strict=True)), found.offsets)
    return SyncPlan(folder / "capture.toml", text, found, copies)


def refuse_single_pictures(indices: Sequence[VideoIndex]) -> None:
    """Raise `InputError` for a file that holds one picture, such as a photo."""
    for index in indices:
        if index.num_frames < 2:
            raise InputError(f"{index.path} holds one picture; a video of the person was expected")


def new_capture_text(
    folder: Path, interval: float, videos: Mapping[str, str], offsets: Sequence[float] | None = None
) -> str:
    """Write down a new capture of `videos`, files in `folder` by camera, whose first takes a picture every `interval`
    seconds; without offsets it says nothing of when they began."""
    lines = [f"name = {_quoted(folder.resolve().name)}", f"fps = {round(1 / interval, 3):g}", 'units = "metres"']
    lines.append('up = "y"')
    for number, (name, video) in enumerate(videos.items()):
        entry = CameraEntry(name=name, video=video)
        lines += ["", "[[camera]]", f"name = {_quoted(entry.name)}", f"video = {_quoted(entry.video)}"]
        if offsets is not None:
            lines.append(f"offset = {round(offsets[number], 6) + 0.0!r}")
    return "\n".join(lines) + "\n"


def video_names(paths: Sequence[Path], names: Sequence[str]) -> dict[str, Path]:
    """Name the videos as files of a new capture."""
    return {f"{name}{path.suffix}": path for name, path in zip(names, paths, strict=True)}


def camera_names(paths: Sequence[Path]) -> list[str]:
    """Name cameras by their files without suffix, or cam0, cam1, ... if those are not different or not usable."""
    names = [re.sub(r"[^\w.\-]", "_", path.stem).lstrip(".-") for path in paths]
    if len({name.lower() for name in names}) < len(names) or not all(names):
        return [f"cam{number}" for number in range(len(paths))]
    return names


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
