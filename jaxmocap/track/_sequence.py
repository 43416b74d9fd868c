"""From a registered start to a whole motion: frames in order, forwards and, before the start, backwards."""

from collections.abc import Callable
from dataclasses import asdict, replace
from typing import NamedTuple, Protocol

import jax
import numpy as np
from jaxtyping import Float, Int, PRNGKeyArray

from jaxmocap._cache import make_room
from jaxmocap._results import InputError
from jaxmocap._runtime import release_memory
from jaxmocap._shapes import check_key
from jaxmocap.character import Pose
from jaxmocap.clip import ClipPlan, SolvedClip, flow_steps, solve_clip
from jaxmocap.motion import Contact, Motion, cameras_at
from jaxmocap.observation import Observations
from jaxmocap.registration import Registration
from jaxmocap.verdict import FrameResult, VerdictSettings, joint_covariances, judge_sequence

from ._checkpoint import Checkpoint, Saved
from ._frame import FrameTracker, Worker
from ._tracker import Tracker

RELEASE_EVERY = 16
"""Frames after which free memory goes back to the system: what is given back has to be fetched again."""


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

    def follow(self, observations: Observations, key: PRNGKeyArray) -> Worker: ...


def track_frames(
    observations: Observations,
    tracker: Tracker | Method,
    *,
    key: PRNGKeyArray,
    frames: tuple[int, int] | None = None,
    progress: Callable[[Progress], None] | None = None,
    checkpoint: Checkpoint | None = None,
) -> list[FrameResult]:
    """Track every frame in `frames` (start, stop), in order, and return their results.

    Tracking starts at the last selected frame not after the first one wanted; when all selected frames come later, it
    starts at the earliest and also runs backwards. With a `checkpoint` what is done
    is kept on disk, and what it holds is not done again: the results are the same bits.
    """
    legs, wanted = _legs(observations, frames)
    begin = legs[0].start
    total = sum(len(leg) for leg in legs) - (len(legs) - 1)
    saved = checkpoint.load(observations) if checkpoint is not None else None
    results = saved.results if saved is not None else {}
    for number, leg in enumerate(legs):
        if saved is not None and number < saved.leg:
            continue
        make_room()
        worker: Worker = (
            FrameTracker(observations, tracker, key)
            if isinstance(tracker, Tracker)
            else tracker.follow(observations, key)
        )
        state = None
        if saved is not None and number == saved.leg:
            state = saved.state
            worker.restore_sizes(saved.sizes)
            leg = range(saved.frame + leg.step, leg.stop, leg.step)
            saved = None
        for shown in observations.frames(leg):
            if state is None:
                step = worker.first(shown, observations.key_poses[begin])
            else:
                step = worker.track(state, shown)
            state = step.state
            if shown.frame % RELEASE_EVERY == 0:
                release_memory()
            if shown.frame in results:
                continue
            results |= {result.frame: result for result in (step.result, *step.revised)}
            if checkpoint is not None:
                checkpoint.keep(Saved(results, number, shown.frame, state, worker.sizes()), observations)
            if progress is not None:
                progress(Progress(len(results), total, step.result))
    return [results[frame] for frame in wanted]


def _legs(observations: Observations, frames: tuple[int, int] | None) -> tuple[list[range], range]:
    """List the frames to track, leg by leg, and those that are wanted of them."""
    capture = observations.capture
    if frames is not None and len(np.shape(frames)) != 1:
        raise InputError(f"frames is {frames!r}; give the first and the one after the last, such as (0, 30).")
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
    return legs, range(first, stop)


def motion_of(
    observations: Observations,
    results: list[FrameResult],
    provenance: dict | None = None,
    verdict: VerdictSettings | None = None,
    clip: ClipPlan | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Motion:
    """Judge tracked frames, solve them as a clip if there is a plan for it, and record them as a motion.

    `results` are of frames in a row. `progress` hears how many of them the clip's optical flow has seen, and of how
    many.
    `provenance["contacts"]` lists where heels and toes stand, if the clip was solved, or is None if that was not looked
    for; `Motion.contacts` reads it.
    `provenance["doubts"]` lists the frames that are not to be trusted and why, `provenance["lost"]` the spans in which
    a part is lost, whose landmarks have no confidence, and `provenance["outlier_cameras"]` those in which a camera
    shows the body elsewhere than the others, by which alone these frames are judged; all in frames of the first video
    like the motion's own. `provenance["risks"]` has the probabilities that a "frame" is wrong and that a limb is, one
    for each of its "frames".
    """
    capture, character = observations.capture, observations.character
    settings = verdict or VerdictSettings()
    judged = judge_sequence(results, character.skeleton, settings, observations.key_poses, capture.camera_names)
    numbers, positions = capture.video_frames[0], np.array([result.frame for result in results])
    poses = Pose(
        jax.device_put(np.stack([r.pose.root for r in results])),
        jax.device_put(np.stack([r.pose.angles for r in results])),
    )
    moments = capture.timestamps[positions]
    clip_record = {}
    if clip is not None:
        hessians = [result.hessian for result in results]
        poses, contacts = _solve(observations, positions, poses, judged.confidence, hessians, clip, progress)
        clip_record["contacts"] = (
            None
            if contacts is None
            else [
                Contact(name, int(numbers[positions[first]]), int(numbers[positions[last]]))._asdict()
                for name, first, last in contacts
            ]
        )
    covariance = None  # of what was not refined nothing is known
    if any(result.hessian is not None for result in results):
        known = (judged.confidence, float(character.misfit))
        covariance = joint_covariances(character.skeleton, results, None, *known)
    names, each = ("frame", *character.skeleton.limb_labels.values()), (judged.risk, *judged.limb_risk.T)
    risks = {name: np.round(risk, 3).tolist() for name, risk in zip(names, each, strict=True)}
    terms = sorted({name for result in results for name in result.energy})
    seconds = [sum(result.seconds.values()) for result in results]
    return Motion.from_poses(
        character,
        poses,
        numbers[positions],
        moments,
        confidence=judged.confidence,
        status=judged.status,
        covariance=covariance,
        energy={name: np.array([result.energy.get(name, np.nan) for result in results]) for name in terms},
        provenance={
            "seconds_per_frame": float(np.mean(seconds)),
            **{
                name: [
                    asdict(replace(span, first=int(numbers[span.first]), last=int(numbers[span.last])))
                    for span in getattr(judged, name)
                ]
                for name in ("lost", "doubts", "outlier_cameras")
            },
            "risks": {"frames": numbers[positions].tolist(), **risks},
            **clip_record,
            **(provenance or {}),
        },
        cameras=cameras_at(capture.cameras_as_filmed(observations.cameras), positions),
        up=capture.up,
    )


def _solve(
    observations: Observations,
    positions: Int[np.ndarray, " frame"],
    poses: Pose,
    confidence: Float[np.ndarray, "frame landmark"],
    hessians: list[Float[np.ndarray, "dof dof"] | None],
    plan: ClipPlan,
    progress: Callable[[int, int], None] | None,
) -> SolvedClip:
    """Solve the clip; then, along what came out, see how the surface moves from frame to frame, and solve it again."""
    skeleton, capture = observations.character.skeleton, observations.capture
    told = skeleton, poses, capture.timestamps[positions], confidence, capture.up, plan
    solved = solve_clip(*told, hessians=hessians)
    if not plan.flow or len(positions) < 4:
        return solved
    frames = range(int(positions[0]), int(positions[-1]) + 1)
    return solve_clip(*told, flow_steps(observations, frames, solved.poses, progress), hessians)


def clip_plan(tracker: Tracker | Method) -> ClipPlan | None:
    """Return how the clip is solved as a whole; what goes on frame by frame, as the baselines do, has no plan."""
    return tracker.clip if isinstance(tracker, Tracker) else None


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

    `start` replaces the registered pose of the frame at which tracking starts. `frames` (start, stop) are positions in
    the span that all cameras share. Same key, same bits. Raises `InputError` for what is no tracker, no key, and no
    range of the capture's frames.
    """
    tracker = Tracker() if tracker is None else tracker
    if not hasattr(tracker, "verdict"):
        raise InputError(f"tracker is {tracker!r}; give a Tracker, such as Tracker.preset('normal'), or a baseline.")
    key = jax.random.key(0) if key is None else key
    check_key(key)
    if start is not None:
        legs, _ = _legs(observations, frames)
        pose = start.pose if isinstance(start, Registration) else start
        observations = observations.with_key_pose(legs[0].start, pose)
    results = track_frames(observations, tracker, key=key, frames=frames, progress=progress)
    return motion_of(observations, results, verdict=tracker.verdict, clip=clip_plan(tracker))
