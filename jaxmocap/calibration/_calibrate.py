"""Calibrating the cameras of a capture: structure from motion, or from the person where they stand still; then scale,
gravity and a report."""

import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from jaxmocap._files import atomic_folder, write_bytes, write_json
from jaxmocap._results import InputError
from jaxmocap.camera import Cameras, look_at_point, read_cameras
from jaxmocap.capture import Capture, shared_frames

from ._child import Solved, run_worker
from ._footage import Report, as_recorded, footage_of
from ._person_clock import PersonClock, person_clock
from ._placeable import advise_part, longest_run
from ._report import draw_paths, make_record, png_bytes, pose_table
from ._route import choose_route
from ._scale import find_scale, refuse_without_scale
from ._standing import find_up
from ._static_job import write_static_job
from ._subject import keypoints_of, known_bone_lengths, subject_views, triangulate_views
from ._world import find_gravity, world_from_model

_MODEL_FILES = ("cameras.bin", "images.bin", "points3D.bin", "rigs.bin", "frames.bin")
_LONGEST = 1.0  # seconds: a hand moves too much for longer ones to be filled in
_LARGEST_SHARE = 0.2  # of the shared frames that may be filled in
_LOOSE = 20  # degrees, standard deviation of a camera's direction: real ones have 0.1 by the background, 2 by a person


@dataclass(frozen=True)
class Calibration:
    """Calibrated cameras over a capture's shared frames, in metres, and how they were found.

    Attributes:
        cameras: over the shared frames, metres.
        record: what `calibration.json` holds.
        poses: what `uncertainty.json` holds.
        picture: of the cameras' paths, RGB.
        files: the COLMAP model in the capture's units and axes, by file name.
        offsets: seconds to add to each video's own time, what `capture.toml` should say: those of the capture, or
            found better by the person.
        folder: where they lie, once written; None before.
    """

    cameras: Cameras
    record: dict[str, Any]
    poses: dict[str, Any]
    picture: UInt8[np.ndarray, "height width 3"]
    files: Mapping[str, bytes]
    offsets: tuple[float, ...]
    folder: Path | None = None

    def save(self, folder: str | Path) -> None:
        """Write the model, `calibration.json`, `uncertainty.json` and `calibration.png` to a new folder, whole or not
        at all."""
        with atomic_folder(folder) as partial:
            for name, data in self.files.items():
                write_bytes(partial / name, data)
            write_json(partial / "calibration.json", self.record)
            write_json(partial / "uncertainty.json", self.poses)
            write_bytes(partial / "calibration.png", png_bytes(self.picture))


def calibrate(
    capture: Capture,
    *,
    height: float | None = None,
    camera_distance: float | None = None,
    up: tuple[float, float, float] | None = None,
    focal: Mapping[str, float] | None = None,
    intrinsics: str | Path | None = None,
    static: bool | None = None,
    frames: tuple[int, int | None] = (0, None),
    keep_offsets: bool = False,
    key_step: int = 5,
    seed: int = 0,
    progress: Report = lambda stage, done, total: None,
) -> Calibration:
    """Find poses at all frames, focal lengths and radial distortion of all cameras of a capture, from its videos.

    Cameras that move are found by the background that they see; cameras that all stand still by the person's
    keypoints at all frames. Which it is, is told by the background, or by `static`.

    Scale: `camera_distance`, metres between the first two cameras at the first shared frame; else the person's bones,
    from keypoints in two views, against the capture's actor, or against a person of `height` metres. Up: the direction
    `up` in the first camera at the first shared frame (x right, y down, z forward), else found. `focal` lengths in
    pixels, by camera, are kept; without them they are found. `intrinsics` is a calibration file whose lenses are kept,
    of cameras that stand still. `frames` (first, end) are the shared frames that are wanted: elsewhere a camera may be
    lost for as long as it likes, and lies between its neighbours, and keypoints there tell neither scale nor up.
    Whatever cameras the capture has are not looked at.

    Where keypoints at many frames tell when a video began to a quarter of a frame, better than sound does,
    `Calibration.offsets` says so, and the person's bones are measured at those moments; not with `keep_offsets`. The
    cameras are those at the shared frames of `capture`, whatever its offsets.

    Raises `InputError` for footage that cannot be calibrated; nothing is written.
    """
    began = time.perf_counter()
    recorded = as_recorded(capture)
    _refuse_numbers(height, camera_distance, up)
    first, end = frames[0], recorded.num_frames if frames[1] is None else frames[1]
    if not 0 <= first < end <= recorded.num_frames:
        raise InputError(
            f"frames {first}:{end} are wanted, but the capture has {recorded.num_frames} shared frames, 0 to "
            f"{recorded.num_frames - 1}"
        )
    file = None if intrinsics is None else Path(intrinsics)
    footage = footage_of(recorded, focal, (first, end), key_step, seed)
    lengths, source = known_bone_lengths(recorded, height)
    route = choose_route(recorded, footage, static, file, progress)
    wanted = set(recorded.video_frames[0, first:end].tolist())
    keypoints = keypoints_of(recorded, wanted)
    refuse_without_scale(recorded, lengths, keypoints, camera_distance)
    with tempfile.TemporaryDirectory(prefix="jaxmocap-") as temporary:
        work = Path(temporary)
        (work / "job.json").write_text(route.footage.to_json(), encoding="utf-8")
        if route.static:
            write_static_job(recorded, route.matrices, route.distortion, lengths, work / "person.npz")
        route.run(work, progress)
        solved = Solved.read(work / "result.npz", recorded)
        interpolated = {(int(c), int(f)) for c, f in solved.tables["interpolated"]}
        refuse_gaps(recorded, interpolated, (first, end))
        clock = None if keep_offsets else person_clock(recorded, solved)
        timed = recorded if clock is None else _moved(recorded, clock)
        if timed is not recorded:
            solved, keypoints = Solved.read(work / "result.npz", timed), keypoints_of(timed, wanted)
        views = subject_views(timed, solved, keypoints)
        scale = find_scale(solved, views, lengths, source, camera_distance)
        people = [triangulate_views(view) for view in views]
        given = None if up is None else solved.pose(0, 0)[:3, :3].T @ np.asarray(up, float)
        if route.static:
            shared = solved.shared_poses()[:, 0]
            gravity = find_up(shared, solved.tables["joints"], scale.metres_per_unit, given)
        else:
            gravity = find_gravity(solved.poses, solved.points, solved.distance, people, given)
        joints = np.concatenate([p[np.isfinite(p).all(1)] for p in people]) if people else np.zeros((0, 3))
        ankles = np.concatenate([p[[11, 14]] for p in people]) if people else np.zeros((0, 3))
        world = world_from_model(
            solved.shared_poses().reshape(-1, 4, 4),
            scale.metres_per_unit,
            gravity,
            recorded.up,
            joints if len(joints) else look_at_point(solved.poses)[None],
            ankles[np.isfinite(ankles).all(1)],
        )
        units = 1 / recorded.metres_per_unit
        write_json(
            work / "similarity.json",
            {"scale": units * world.scale, "rotation": world.rotation, "translation": units * world.translation},
        )
        run_worker("transform", work, progress)
        files = {name: (work / "cameras" / name).read_bytes() for name in _MODEL_FILES}
        cameras = read_cameras(
            work / "cameras",
            recorded.camera_names,
            recorded.num_frames,
            recorded.sizes,
            recorded.video_frames,
            recorded.metres_per_unit,
        )
    record = make_record(timed, solved, scale, gravity, world, joints, time.perf_counter() - began)
    _refuse_loose_cameras(capture, record)
    record["time"] = None if clock is None else clock.record(recorded)
    picture = draw_paths(timed, world.cameras(solved.shared_poses()), world(solved.points), world(joints), interpolated)
    return Calibration(cameras, record, pose_table(timed, solved, world), picture, files, timed.offsets)


def _refuse_loose_cameras(capture: Capture, record: Mapping[str, Any]) -> None:
    """Raise `InputError` where a camera's direction is hardly known, as noise that was matched leaves it."""
    loose = {name: camera["rotation_deviation_degrees"] for name, camera in record["cameras"].items()}
    name = max(loose, key=lambda name: loose[name])
    if loose[name] > _LOOSE:
        raise InputError(
            f"the cameras of capture '{capture.name}' cannot be calibrated: what was found leaves the direction of "
            f"{name} open by {loose[name]:.0f} degrees (standard deviation; {_LOOSE} at most are of use). Too "
            "little background, or too little motion of the person before tripods, tells where the cameras are: film "
            "from farther away, or for longer."
        )


def _moved(capture: Capture, clock: PersonClock) -> Capture:
    """Match the frames of a capture by the moments that the person tells; itself where none is known."""
    known = clock.known(1 / capture.fps)
    if not known.any():
        return capture
    offsets = tuple(round(offset + float(late), 6) for offset, late in zip(capture.offsets, known, strict=True))
    frames = shared_frames(capture.indices, offsets)[:, : capture.num_frames]
    return replace(capture, offsets=offsets, video_frames=frames, num_frames=frames.shape[1])


def _refuse_numbers(height: float | None, distance: float | None, up: tuple[float, float, float] | None) -> None:
    if height is not None and not 0.4 < height < 2.6:
        raise InputError(f"--height is {height:g}; the actor's height in metres was expected, such as 1.75")
    check_camera_distance(distance)
    if up is not None and not (np.isfinite(up).all() and np.linalg.norm(up) > 0):
        raise InputError(f"--up is {up}; three numbers, not all zero, were expected: x right, y down, z forward")


def check_camera_distance(distance: float | None) -> None:
    """Raise `InputError` for a distance between the first two cameras that no recording has; metres, None: unknown."""
    if distance is not None and not 0.01 < distance < 200:
        raise InputError(
            f"--camera-distance is {distance:g}; metres between the first two cameras were expected, 0.01 to 200"
        )


def refuse_gaps(capture: Capture, interpolated: set[tuple[int, int]], frames: tuple[int, int | None]) -> None:
    """Raise `InputError` where a camera could not be placed for a second on end, or in more than a fifth of the frames.

    Short spans are filled in; long ones are a cut, or nothing to go by. `interpolated` are (camera, frame of its own
    video); shared `frames` (first, end) count.
    """
    wanted = capture.video_frames[:, slice(*frames)]
    places = [[(camera, int(frame)) in interpolated for frame in own] for camera, own in enumerate(wanted)]
    filled_of = np.array(places, bool)
    for name, own, filled in zip(capture.camera_names, wanted, filled_of, strict=True):
        start, stop = longest_run(filled)
        if stop == 0 or (stop - start < _LONGEST * capture.fps and filled.mean() <= _LARGEST_SHARE):
            continue
        part = advise_part(np.asarray(~filled_of.any(axis=0)), frames[0])
        raise InputError(
            f"camera '{name}' cannot be placed in {int(filled.sum())} of {len(own)} shared frames, at most at its "
            f"frames {own[start]} to {own[stop - 1]} on end: they show another place (a cut, a phone laid down?), or "
            f"too little background; {part or 'say with --frames A:B which frames are wanted'}, cut that part off "
            "all videos, or film it again."
        )
