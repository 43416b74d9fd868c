"""Doing one run: open, register, fit the appearance, track, evaluate. What runs share is prepared once."""

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxmocap._cache import make_room
from jaxmocap._results import InputError
from jaxmocap._runtime import versions
from jaxmocap._types import Quality
from jaxmocap.appearance import Appearance, appearance_preset
from jaxmocap.baselines import METHODS, method, without_keypoints
from jaxmocap.camera import Cameras
from jaxmocap.capture import Capture, Detections, config_path, content_hash
from jaxmocap.character import Character, Pose
from jaxmocap.clip import ClipPlan
from jaxmocap.geometry import so3_exp, vertex_normals
from jaxmocap.metrics import evaluate
from jaxmocap.motion import Motion
from jaxmocap.observation import key_poses_of, observe
from jaxmocap.pipeline import fit_capture_appearance, open_character, with_person_masks, with_selected_frames
from jaxmocap.registration import register
from jaxmocap.track import Method, Tracker, clip_plan, motion_of, track_frames, with_settings
from jaxmocap.verdict import FrameResult

from ._run import Inputs, Run
from ._suite import DETECTIONS, CaptureSpec, film

MEANS = ("marker_error_cm", "joint_error_cm")
"""Errors that a row has three times: of the method as it is, of its poses frame by frame, and solved as a clip."""


class Prepared(NamedTuple):
    """What the runs of one capture and one set of inputs share."""

    capture: Capture
    cameras: Cameras
    character: Character
    key_poses: dict[int, Pose]
    hash: str


def check_runs(runs: Sequence[Run]) -> None:
    """Raise `InputError`, before hours of work, for a method, preset, setting or capture that does not exist."""
    known: set[str] = set()
    for run in runs:
        asked = repr((run.method, run.quality, run.settings, run.appearance, run.capture))
        if asked in known:
            continue
        known.add(asked)
        if run.method not in METHODS:
            method(run.method)
        with_settings(appearance_preset(run.quality), run.appearance)
        if run.settings:
            tracker_of(run)
        if isinstance(run.capture, str):
            config_path(run.capture)


def tracker_of(run: Run) -> Tracker | Method:
    """Return the method of a run with its settings. Raises `InputError` for one that it does not have."""
    tracker = method(run.method, run.quality)
    if not run.settings:
        return tracker
    if not isinstance(tracker, Tracker):
        raise InputError(f"method '{run.method}' has no settings of the tracker; leave {list(run.settings)} out.")
    return with_settings(tracker, run.settings)


def perform(run: Run, captures: Path) -> tuple[dict[str, Any], Motion]:
    """Do one run: its record, which is one row of the table, and its motion.

    The synthetic captures of a suite are filmed into `captures` when they are first needed. Raises whatever the run
    raises.
    """
    make_room()
    begin, used = time.perf_counter(), time.process_time()
    key = jax.random.key(run.seed)
    folder = film(run.capture, captures) if isinstance(run.capture, CaptureSpec) else Path(run.capture)
    prepared = _prepare(folder, run.inputs, run.seed)
    capture = prepared.capture
    appearance = _appearance(folder, run.inputs, run.seed, run.quality, tuple(sorted(run.appearance.items())))
    detections = _detections(capture)
    observations = observe(capture, prepared.cameras, prepared.character, appearance, prepared.key_poses, detections)
    tracker = tracker_of(run)
    if isinstance(tracker, Tracker) and tracker.detections is not None and detections is None:
        raise without_keypoints(capture, f"'{run.method}'")
    ready = time.perf_counter()
    results = track_frames(observations, tracker, key=jax.random.fold_in(key, 3), frames=run.frames)
    plan = clip_plan(tracker)
    motion = motion_of(observations, results, {"method": run.method}, tracker.verdict, plan)
    done, spent = time.perf_counter(), time.process_time() - used
    record = _record(run, prepared.hash, motion, results, done - begin, done - ready, spent) | _errors({})
    if capture.truth is not None:
        other = motion_of(observations, results, None, tracker.verdict, ClipPlan() if plan is None else None)
        own, others = (_errors(evaluate(one, capture.truth)) for one in (motion, other))
        by_frame, solved = (own, others) if plan is None else (others, own)
        for name, found in (("by_frame", by_frame), ("solved", solved)):
            own |= {column.replace("_cm", f"_{name}_cm"): found[column] for column in MEANS}
        record |= own
    return record, motion


def _detections(capture: Capture) -> Detections | None:
    """Open keypoints of more than the selected frames: the suite's own, or the capture's, as `detect` leaves them."""
    if (capture.folder / DETECTIONS).is_dir():
        return Detections.open(capture, capture.folder / DETECTIONS)
    found = {frame for camera in range(capture.num_cameras) for frame in capture.keypoint_frames(camera)}
    if capture.keypoints_folder is None or found <= set(capture.selected_frames or ()):
        return None
    return Detections.open(capture, capture.keypoints_folder)


def _record(
    run: Run,
    hashed: str,
    motion: Motion,
    results: Sequence[FrameResult],
    wall: float,
    tracking: float,
    cpu: float,
) -> dict[str, Any]:
    """Build the row but for its errors: settings, seed, versions, capture hash and seconds."""
    seconds = [sum(result.seconds.values()) for result in results][1:] or [float("nan")]
    return {
        "key": run.key,
        "status": "done",
        "capture": run.capture_name,
        "capture_hash": hashed,
        **{name: value for name, value in run.described().items() if name != "capture"},
        "frames_tracked": len(motion),
        "frames_lost": int((motion.status == "lost").sum()),
        "frame_numbers": motion.frames.tolist(),
        "seconds_per_frame": float(np.median(seconds)),
        "seconds_tracking": tracking,
        "seconds": wall,
        "cpu_seconds": cpu,
        "device": str(jax.devices()[0]),
        "versions": versions(),
    }


def _errors(scores: dict[str, Any]) -> dict[str, Any]:
    """Pick a row's errors from what `evaluate` says; None for what the truth does not hold."""
    markers, joints = scores.get("marker_error_cm", {}), scores.get("joint_error_cm", {})
    found = {
        "marker_error_cm": markers.get("mean"),
        "marker_error_max_cm": markers.get("max"),
        "marker_error_p95_cm": markers.get("p95"),
        "joint_error_cm": joints.get("mean"),
        "joint_error_p95_cm": joints.get("p95"),
        "pa_mpjpe_cm": scores.get("pa_mpjpe_cm"),
        "error_per_frame_cm": scores.get("marker_error_per_frame_cm"),
    }
    return found | ({"frame_numbers": scores["frame_numbers"]} if "frame_numbers" in scores else {})


@lru_cache(maxsize=3)
def _prepare(folder: Path, inputs: Inputs, seed: int) -> Prepared:
    capture, key = Capture.open(folder).one_way_up(), jax.random.key(seed)
    beyond = [frame for frame in inputs.selected if frame >= capture.num_frames]
    if beyond:
        raise InputError(f"frame {beyond[0]} is selected, but '{capture.name}' has {capture.num_frames} frames.")
    capture = capture.with_selected_frames(inputs.selected) if inputs.selected else with_selected_frames(capture)[0]
    selected = capture.selected_frames or (0,)
    rng = np.random.default_rng([seed, 17])
    cameras = _shaken(capture.cameras, rng, inputs)
    character = _roughened(open_character(capture), rng, inputs.mesh_millimetres)
    capture, _ = with_person_masks(capture, character, key=jax.random.fold_in(key, 4))
    if inputs.start == "truth":
        key_poses = {frame: _true_pose(capture, frame) for frame in selected}
    else:
        key_poses = key_poses_of(register(capture, cameras, character, selected, key=jax.random.fold_in(key, 1)))
    return Prepared(capture, cameras, character, key_poses, content_hash(capture))


@lru_cache(maxsize=3)
def _appearance(
    folder: Path, inputs: Inputs, seed: int, quality: Quality, changes: tuple[tuple[str, Any], ...]
) -> Appearance:
    prepared = _prepare(folder, inputs, seed)
    return fit_capture_appearance(
        prepared.capture,
        prepared.cameras,
        prepared.character,
        prepared.key_poses,
        key=jax.random.fold_in(jax.random.key(seed), 2),
        settings=with_settings(appearance_preset(quality), dict(changes)),
    )


def _true_pose(capture: Capture, frame: int) -> Pose:
    if capture.truth is None:
        raise InputError(f"'{capture.name}' has no truth, from which the first pose was to be taken.")
    with np.load(capture.truth, allow_pickle=False) as truth:
        if "root" not in truth or "angles" not in truth:
            raise InputError(f"{capture.truth} holds no poses (root, angles), only a synthetic capture's does.")
        return Pose(jnp.asarray(truth["root"][frame]), jnp.asarray(truth["angles"][frame]))


def _shaken(cameras: Cameras, rng: np.random.Generator, inputs: Inputs) -> Cameras:
    """Every camera turned about its own centre and moved, by the same amount in all frames."""
    if not (inputs.camera_degrees or inputs.camera_centimetres):
        return cameras
    count = cameras.num_cameras
    turn = np.radians(inputs.camera_degrees) * rng.standard_normal((count, 3)) / np.sqrt(3)
    shift = 0.01 * inputs.camera_centimetres * rng.standard_normal((count, 3)) / np.sqrt(3)
    noise = np.tile(np.eye(4), (count, 1, 1))
    noise[:, :3, :3], noise[:, :3, 3] = np.asarray(jax.vmap(so3_exp)(jnp.asarray(turn))), shift
    moved = np.einsum("cij,cfjk->cfik", noise, np.asarray(cameras.cam_from_world, np.float64))
    return replace(cameras, cam_from_world=jnp.asarray(moved, jnp.float32))


def _roughened(character: Character, rng: np.random.Generator, millimetres: float) -> Character:
    """Every vertex moved along its normal."""
    if not millimetres:
        return character
    vertices, faces = np.asarray(character.vertices, np.float64), np.asarray(character.faces)
    moved = vertices + 1e-3 * millimetres * rng.standard_normal((len(vertices), 1)) * vertex_normals(vertices, faces)
    return replace(character, vertices=jnp.asarray(moved, jnp.float32))
