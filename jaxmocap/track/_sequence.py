"""From a registered start to a whole motion: frames in order, forwards and, before the start, backwards."""

from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from typing import NamedTuple, Protocol

import jax
import numpy as np
from jaxtyping import PRNGKeyArray

from jaxmocap._results import InputError
from jaxmocap._runtime import make_room, release_memory
from jaxmocap.character import Pose
from jaxmocap.motion import Motion, cameras_at
from jaxmocap.observation import FrameImages, Observations, key_poses_of
from jaxmocap.registration import Registration
from jaxmocap.verdict import (
    FrameResult,
    VerdictSettings,
    doubts,
    joint_covariances,
    lost_spans,
    mean_deviations,
    outlier_cameras,
    with_doubts,
    without_trust,
)

from ._checkpoint import Checkpoint
from ._frame import FrameTracker
from ._tracker import Tracker


class Progress(NamedTuple):
    """Told after every frame: frames done, frames in all, and the frame's result."""

    done: int
    total: int
    result: FrameResult


class Method(Protocol):
    """Anything that tracks one frame after the other from a registered pose, such as the baselines: a value that hands
    out the worker of one sequence."""

    @property
    def verdict(self) -> VerdictSettings: ...

    def follow(self, observations: Observations, key: PRNGKeyArray) -> FrameTracker: ...


def _shown(observations: Observations, leg: range) -> Iterator[FrameImages]:
    """The frames of a leg, decoded as they are needed."""
    if leg.step > 0:
        yield from observations.frames(leg.start, leg.stop)
        return
    capture = observations.capture
    for frame in leg:
        images = [capture.image(camera, frame) for camera in range(capture.num_cameras)]
        yield FrameImages(frame, float(capture.timestamps[frame]), images)


def track_frames(
    observations: Observations,
    tracker: Tracker | Method,
    *,
    key: PRNGKeyArray,
    frames: tuple[int, int] | None = None,
    progress: Callable[[Progress], None] | None = None,
    checkpoint: Checkpoint | None = None,
) -> list[FrameResult]:
    """Results of every frame in `frames` (start, stop), in order.

    Tracking starts at the last selected frame not after the first one wanted; when all selected frames come later, it
    starts at the earliest and also runs backwards. With a `checkpoint` what is done is kept on disk, and what it holds
    is not done again: the results are the same bits.
    """
    capture = observations.capture
    first, stop = frames if frames is not None else (0, capture.num_frames)
    if not 0 <= first < stop <= capture.num_frames:
        raise InputError(
            f"frames {first}:{stop} are asked for, but capture '{capture.name}' has frames 0:{capture.num_frames}; "
            "give a range inside it."
        )
    known = sorted(observations.key_poses)
    before = [frame for frame in known if frame <= first]
    start = before[-1] if before else known[0]
    legs = [range(start, max(stop, start + 1))]
    if start > first:
        legs.append(range(start, first - 1, -1))
    total = max(stop - start, 1) + max(start - first, 0)
    saved = checkpoint.load(observations) if checkpoint is not None else None
    results = saved.results if saved is not None else {}
    for number, leg in enumerate(legs):
        if saved is not None and number < saved.leg:
            continue
        make_room()
        if isinstance(tracker, Tracker):
            worker = FrameTracker(observations, tracker, key)
        else:
            worker = tracker.follow(observations, key)
        if saved is not None and number == saved.leg:
            worker.restore(saved.state)
            saved = saved._replace(state={})
            leg = range(saved.frame + leg.step, leg.stop, leg.step)
        for shown in _shown(observations, leg):
            is_start = shown.frame == start
            result = worker.first(shown, observations.key_poses[start]) if is_start else worker.track(shown)
            release_memory()
            if shown.frame in results:
                continue
            results[shown.frame] = result
            for revised in worker.search_backwards():
                results[revised.frame] = revised
            if checkpoint is not None:
                checkpoint.keep(results, number, shown.frame, worker)
            if progress is not None:
                progress(Progress(len(results), total, result))
    return [results[frame] for frame in range(first, stop)]


def motion_of(
    observations: Observations,
    results: list[FrameResult],
    provenance: dict | None = None,
    verdict: VerdictSettings | None = None,
) -> Motion:
    """The record of tracked frames, judged. `provenance["doubts"]` lists the frames that are not to be trusted and why,
    `provenance["lost"]` the spans in which a part is lost, whose landmarks have no confidence, and
    `provenance["outlier_cameras"]` those in which a camera shows the body elsewhere than the others, by which alone
    these frames are judged; all in frames of the first video like the motion's own."""
    capture, character = observations.capture, observations.character
    settings = verdict or VerdictSettings()
    spans, found, odd = (
        lost_spans(results, character, capture.fps, settings),
        doubts(
            *(results, settings, key_poses_of(observations.key_poses)), mean_deviations(character.skeleton, results)
        ),
        outlier_cameras(results, settings, capture.camera_names),
    )
    results = without_trust(with_doubts(results, found, settings), spans, character)
    numbers, positions = capture.video_frames[0], np.array([result.frame for result in results])
    poses = Pose(
        jax.device_put(np.stack([r.pose.root for r in results])),
        jax.device_put(np.stack([r.pose.angles for r in results])),
    )
    terms = sorted({name for result in results for name in result.energy})
    seconds = [sum(result.seconds.values()) for result in results]
    return Motion.from_poses(
        character,
        poses,
        numbers[positions],
        capture.timestamps[positions],
        confidence=np.stack([result.confidence for result in results]),
        status=[result.status for result in results],
        covariance=joint_covariances(character.skeleton, results),
        energy={name: np.array([result.energy.get(name, np.nan) for result in results]) for name in terms},
        provenance={
            "seconds_per_frame": float(np.mean(seconds)),
            **{
                name: [asdict(replace(s, first=int(numbers[s.first]), last=int(numbers[s.last]))) for s in listed]
                for name, listed in (("lost", spans), ("doubts", found), ("outlier_cameras", odd))
            },
            **(provenance or {}),
        },
        cameras=cameras_at(observations.cameras, positions),
        up=capture.up,
    )


def track(
    observations: Observations,
    start: Pose | Registration | None = None,
    tracker: Tracker | Method | None = None,
    *,
    key: PRNGKeyArray | None = None,
    frames: tuple[int, int] | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Motion:
    """Track the person through the capture (sec. 4): `Tracker()` is the paper; `jaxmocap.baselines` has others.

    `start` replaces the registered pose of the frame at which tracking starts. Same key, same bits.
    """
    tracker = Tracker() if tracker is None else tracker
    if start is not None:
        first = (frames or (0, 0))[0]
        before = [frame for frame in sorted(observations.key_poses) if frame <= first]
        anchor = before[-1] if before else min(observations.key_poses)
        observations.key_poses[anchor] = start.pose if isinstance(start, Registration) else start
    key = jax.random.key(0) if key is None else key
    results = track_frames(observations, tracker, key=key, frames=frames, progress=progress)
    return motion_of(observations, results, verdict=tracker.verdict)
