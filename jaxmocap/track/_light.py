"""Before a frame is tracked: one that a flash lights is passed over, the others are shown in the light of the first."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from jaxmocap._runtime import cores
from jaxmocap.capture import lit_apart
from jaxmocap.character import Pose, Skeleton
from jaxmocap.observation import FrameImages, LightMeter
from jaxmocap.verdict import FrameResult, passed_over, poses_between

from ._state import TrackingState, known


def in_flash(state: TrackingState, shown: FrameImages, longest: int) -> bool:
    """Whether a flash lights the frame, after fewer than `longest` frames in a row that were passed over for one."""
    if len(state.passed_over) >= longest:
        return False
    _, previous = known(state)
    as_before = shown if previous.light is None else shown.in_light(previous.light)
    return lit_apart(as_before.images, previous.images)


def pass_over(
    state: TrackingState, shown: FrameImages, skeleton: Skeleton, limbs: int
) -> tuple[TrackingState, FrameResult]:
    """Pass over a frame in another light; the next one that can be tracked will tell its pose."""
    history, _ = known(state)
    result = passed_over(skeleton, shown, history.pose, limbs)
    return state._replace(passed_over=(*state.passed_over, result), recent=()), result


def filled_in(state: TrackingState, shown: FrameImages, skeleton: Skeleton, pose: Pose) -> tuple[FrameResult, ...]:
    """Give the frames that were passed over poses on the way to that of the first one which was tracked again."""
    if not state.passed_over:
        return ()
    history, _ = known(state)
    way = history.steps(shown.timestamp)
    shares = [history.steps(one.timestamp) / way for one in state.passed_over]
    return tuple(poses_between(skeleton, state.passed_over, pose, shares))


def in_first_light(state: TrackingState, shown: FrameImages) -> tuple[FrameImages, TrackingState]:
    """Show the frame in the light of the one at which the sequence started."""
    with ThreadPoolExecutor(cores()) as pool:
        light = tuple(pool.map(LightMeter.at, state.light, shown.images))
    factors = np.stack([meter.factors() for meter in light])
    shown = shown if (factors == 1).all() else shown.in_light(factors)
    return shown, state._replace(light=light)
