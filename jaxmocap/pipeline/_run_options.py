"""What a run is told, and what of it is wrong before anything is done."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import get_args

from jaxmocap._results import InputError
from jaxmocap._types import Quality
from jaxmocap.calibration import check_camera_distance
from jaxmocap.capture import VideoIndex, index_video, path_hash, refuse_single_pictures
from jaxmocap.rigging import check_height

from ._scan_folder import is_views_folder


@dataclass(frozen=True)
class RunOptions:
    """What a run is told beside its videos.

    Attributes:
        height: of the person, metres; None: not known.
        camera_distance: metres between the first two cameras at their first shared frame; None: not known.
        focal: pixels, by camera.
        offset: seconds to add to a camera's own time, by camera, 0 for those left out; empty: found.
        frames: (first, behind the last) of the shared frames to track; None for the end.
        quality: preset of the tracker.
        actor: the person's mesh or character; None: the built-in body is made to measure.
        scan: a video once around the person, or pictures from all around, that an actor is made of (`pipeline.scan`);
            without a height and a size of its own it is as tall as the person is in the videos.
        person: pixel on the person in the first picture that all videos share, by camera.
        weights: a detector's networks, for a machine without a network.
        keypoints: folder of a detector's files, instead of looking for the person.
        static: whether all cameras stand still, whatever the background says.
        detections: whether keypoints count beside the pixels while tracking.
        seed: of all random numbers.
    """

    height: float | None = None
    camera_distance: float | None = None
    focal: Mapping[str, float] = field(default_factory=dict)
    offset: Mapping[str, float] = field(default_factory=dict)
    frames: tuple[int, int | None] = (0, None)
    quality: Quality = "normal"
    actor: Path | None = None
    scan: Path | None = None
    person: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    weights: Path | None = None
    keypoints: Path | None = None
    static: bool = False
    detections: bool = True
    seed: int = 0

    @property
    def body_first(self) -> bool:
        """Whether the person's own body can be made before cameras are found: its size is told, or it has one."""
        sized = self.height is not None or (self.scan is not None and is_views_folder(self.scan))
        return self.actor is not None or (self.scan is not None and sized)

    def renamed(self, names: Mapping[str, str]) -> "RunOptions":
        """Call cameras by other names, which those that bear them keep."""
        kept = set(names.values())
        told = {what: getattr(self, what) for what in ("focal", "offset", "person")}
        changed = {
            what: {name if name in kept else names.get(name, name): value for name, value in by_name.items()}
            for what, by_name in told.items()
        }
        return replace(self, **changed)


def examine(videos: Sequence[Path], options: RunOptions, names: Sequence[str]) -> list[VideoIndex]:
    """Open the videos of a run, whose cameras have these names, and refuse what cannot work before anything is done.

    Raises `InputError` for a video that cannot be read or is given twice, for numbers that nobody's body or cameras
    have, and where nothing tells the scale.
    """
    if not videos:
        raise InputError("no video is given; give one, or better two or three of the same moment")
    if folder := next((video for video in videos if video.is_dir()), None):
        raise InputError(f"{folder} is a folder; the file of a video was expected")
    indices = [index_video(video) for video in videos]
    paths = [index.path.resolve() for index in indices]
    twice = next((path for path in paths if paths.count(path) > 1), None)
    if twice is not None:
        raise InputError(f"{twice} is given twice; give every video once")
    for one, other in combinations(paths, 2):
        if one.stat().st_size == other.stat().st_size and path_hash(one) == path_hash(other):
            raise InputError(f"{one} and {other} are the same film; give every video once")
    refuse_single_pictures(indices)
    if options.quality not in get_args(Quality):
        raise InputError(f"--quality is {options.quality!r}; one of {', '.join(get_args(Quality))} was expected")
    if not 0 <= options.seed < 2**31:
        raise InputError(f"--seed is {options.seed}; a whole number from 0 to {2**31 - 1} was expected")
    start, stop = options.frames
    behind = indices[0].num_frames if stop is None else stop
    if not 0 <= start < behind <= indices[0].num_frames:
        raise InputError(
            f"frames {start}:{'' if stop is None else stop} were asked for, but {indices[0].path.name} has "
            f"{indices[0].num_frames} frames, 0 to {indices[0].num_frames - 1}"
        )
    _examine_cameras(indices, options, names)
    if options.height is not None:
        check_height(options.height)
    if options.scan is not None and options.actor is not None:
        raise InputError("--scan and --actor are given, and either is the person's body; leave one of them out")
    if options.scan is not None and not options.body_first and (len(videos) == 1 or options.camera_distance is None):
        raise InputError(
            "--scan does not tell how large the person is; say how tall with --height METRES, or, of two videos, how "
            "far the first two cameras stand apart with --camera-distance METRES"
        )
    if len(videos) == 1:
        if options.height is None and not options.body_first:
            raise InputError(
                "one video does not tell how large the person is: say it with --height METRES, or give a scan of the "
                "person with --actor"
            )
        if options.camera_distance is not None:
            raise InputError("--camera-distance is given, but there is one camera; leave it out")
    elif options.height is None and options.camera_distance is None and not options.body_first:
        raise InputError(
            "videos alone do not tell how large anything is: say how tall the person is with --height METRES, or how "
            "far the first two cameras stand apart with --camera-distance METRES"
        )
    return indices


def _examine_cameras(indices: Sequence[VideoIndex], options: RunOptions, names: Sequence[str]) -> None:
    """Refuse what is said of cameras that are not there, and numbers that no camera has."""
    for name, seconds in options.offset.items():
        if name not in names or len(names) == 1:
            raise InputError(f"--offset names {name!r}; {_offset_wanted(names)}")
        if not math.isfinite(seconds):
            raise InputError(f"--offset {name}={seconds}: a number of seconds was expected, such as {name}=-0.4")
    for option, told in (("--focal", options.focal), ("--person", options.person)):
        if unknown := next((name for name in told if name not in names), None):
            raise InputError(f"{option} names {unknown!r}; {_names_wanted(names)}")
    for name, focal in options.focal.items():
        if not 10 < focal < 1e5:
            raise InputError(f"--focal {name}={focal:g}: pixels were expected, about the width of the pictures")
    if missing := [name for name in names if options.focal and name not in options.focal]:
        raise InputError(f"--focal leaves out {', '.join(missing)}; give it for every camera, or for none")
    for name, (x, y) in options.person.items():
        width, height = indices[names.index(name)].size
        if not (0 <= x < width and 0 <= y < height):
            raise InputError(
                f"--person {name}={x:g},{y:g} lies outside the pictures of {width} x {height} pixels; give a pixel on "
                "the person in the first picture that all videos share"
            )
    check_camera_distance(options.camera_distance)


def _offset_wanted(names: Sequence[str]) -> str:
    if len(names) == 1:
        return "one video needs no offset: leave it out"
    return _names_wanted(names)


def _names_wanted(names: Sequence[str]) -> str:
    return f"the cameras are called like their videos: {', '.join(names)}"


def span_within(frames: tuple[int, int | None], num_frames: int) -> tuple[int, int] | None:
    """Find the frames to track, within those the videos share; None for all of them.

    Raises `InputError` for a span that goes beyond them, or holds none.
    """
    first, stop = frames
    if first == 0 and stop is None:
        return None
    behind = num_frames if stop is None else stop
    if not 0 <= first < behind <= num_frames:
        raise InputError(
            f"frames {first}:{behind} were asked for, but the videos share {num_frames} frames, 0 to {num_frames - 1}; "
            "choose others with --frames"
        )
    return first, behind
