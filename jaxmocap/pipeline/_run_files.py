"""The files that a run is given beside its videos: what cannot be used of them, before anything is done."""

import os
import re
import shutil
from collections.abc import Callable, Collection, Sequence
from pathlib import Path

from jaxmocap._results import InputError
from jaxmocap.capture import VideoIndex
from jaxmocap.detection import (
    LayoutName,
    VideoKeypoints,
    best_person,
    farthest_outside,
    get_weights,
    open_model,
    require_runner,
)
from jaxmocap.rigging import refuse_unreadable_actor

from ._run_options import RunOptions
from ._scan_folder import is_views_folder
from ._scan_frames import index_of_walk
from ._scan_pictures import pictures_in


def examine_files(
    options: RunOptions, indices: Sequence[VideoIndex], names: Sequence[str], layout: LayoutName | None
) -> None:
    """Read the files that a run is given, whose cameras have these names.

    `layout` of keypoints is what `capture.toml` says. Raises `InputError` for a file that is not there or not what it
    should be: a mesh or character, a walk around the person, weights of a detector, keypoints of every camera.
    """
    for what in ("actor", "scan", "weights", "keypoints"):
        path = getattr(options, what)
        if path is not None and not path.exists():
            raise InputError(f"--{what} {path} does not exist")
    if options.actor is not None:
        refuse_unreadable_actor(options.actor)
    if options.scan is not None and options.scan.is_file():
        index_of_walk(options.scan)
    elif options.scan is not None and not is_views_folder(options.scan):
        pictures_in(options.scan)
    if options.keypoints is not None:
        _examine_keypoints(options.keypoints, indices, names, layout)
    if options.keypoints is None or _scan_detects(options):
        require_runner()
        if options.weights is not None:
            open_model(get_weights(None, options.weights))


def fetch_weights(options: RunOptions, to_do: Collection[str], say: Callable[[str], None]) -> None:
    """Get the detector's weights if a stage that needs them is to be done. Raises `InputError`, as `get_weights`."""
    detects = options.keypoints is None and "detect" in to_do
    if options.weights is None and (detects or (_scan_detects(options) and "body" in to_do)):
        get_weights(say=say)


def _scan_detects(options: RunOptions) -> bool:
    """Tell whether the person has to be found for a scan, which views with masks spare."""
    return options.scan is not None and not is_views_folder(options.scan)


def _examine_keypoints(
    given: Path, indices: Sequence[VideoIndex], names: Sequence[str], layout: LayoutName | None
) -> None:
    if not given.is_dir():
        raise InputError(f"--keypoints {given} is a file; the folder of a detector's files was expected")
    for name, called, index in zip(names, _called(indices, names), indices, strict=True):
        sources = [VideoKeypoints(given, (one,), layout, index.size) for one in called]
        people = [found for source in sources for found in source.read_all().items()]
        if not people:
            raise InputError(
                f"--keypoints {given} has no file for camera '{name}', {index.path}; {name}_00000_keypoints.json "
                f"and so on, one for every picture, or {name}.json for the whole video, were expected"
            )
        shown = [best_person(everybody) for frame, everybody in people if frame < index.num_frames]
        chosen = [person for person in shown if person is not None]
        if not chosen:
            raise InputError(
                f"--keypoints {given} show nobody in the {index.num_frames} pictures of camera '{name}', "
                f"{index.path}; leave the option out, and the person is looked for"
            )
        if (farthest := farthest_outside(chosen, index.size)) is not None:
            raise InputError(
                f"--keypoints {given}: those of camera '{name}' lie as far as {farthest[0]:.4g}, {farthest[1]:.4g}, "
                f"outside the {index.size[0]} x {index.size[1]} pixels of {index.path}: the detector saw pictures of "
                "another size; run it on this video"
            )


def copy_keypoints(given: Path, folder: Path, indices: Sequence[VideoIndex], names: Sequence[str]) -> None:
    """Copy a detector's files; those that are named like a video whose camera is called otherwise get its name."""
    shutil.copytree(given, folder, dirs_exist_ok=True)
    for name, called in zip(names, _called(indices, names), strict=True):
        for stem in called[1:]:
            _rename_all(folder, stem, name)
            if (folder / "predictions").is_dir():
                _rename_all(folder / "predictions", stem, name)


def _called(indices: Sequence[VideoIndex], names: Sequence[str]) -> list[tuple[str, ...]]:
    """List how a camera's files may be called: like itself, and like its video where that tells them apart."""
    stems = [index.path.stem for index in indices]
    return [
        (name, stem) if stems.count(stem) == 1 and stem not in names else (name,)
        for name, stem in zip(names, stems, strict=True)
    ]


def _rename_all(folder: Path, stem: str, name: str) -> None:
    """Rename all files and folders that a detector called after a video, `stem`, after its camera."""
    form = re.compile(rf"(results_)?{re.escape(stem)}(|_json|\.json|_\d{{5,}}_keypoints\.json)")
    for entry in sorted(folder.iterdir()):
        found = form.fullmatch(entry.name)
        target = None if found is None else folder / f"{found[1] or ''}{name}{found[2]}"
        if target is not None and not target.exists():
            entry.rename(target)


def link_or_copy(video: Path, place: Path) -> None:
    """Link a video, which costs no room; where the file system has no links, copy it."""
    try:
        os.link(video.resolve(), place)
    except OSError:
        shutil.copyfile(video, place)
