"""What one frame hands to the next: all that grows while a sequence is tracked, in one value."""

from typing import NamedTuple

from jaxmocap.motion import MotionHistory
from jaxmocap.observation import Background, DetectorOffsets, Frame, FrameImages, LightMeter, Rectangle
from jaxmocap.search import SearchMemory
from jaxmocap.verdict import FrameResult


class Tracked(NamedTuple):
    """A frame that has been tracked: what it began with, what it showed, and what was found."""

    history: MotionHistory | None
    frame: Frame
    result: FrameResult


class TrackingState(NamedTuple):
    """The state of the tracker between two frames. Nothing else remembers a frame, so that a state and the same inputs
    lead to the same bits.

    Attributes:
        background: what the frames so far have told of the background.
        rectangle: the last rectangle; sizes never shrink within a sequence.
        previous: images of the last frame that was tracked, in the light of the first.
        history: how the person has moved up to it; None before the first frame.
        detector: where the detector sees the landmarks; None where no detections count.
        light: per camera the light so far; empty where the tracker leaves light alone.
        search: what the search remembers; None without a search.
        recent: the last frames, which the backward search may search again, oldest first.
        passed_over: results of the frames that were passed over since the last one that was tracked.
        lost: whether the last verdict was "lost".
    """

    background: Background
    rectangle: Rectangle | None = None
    previous: FrameImages | None = None
    history: MotionHistory | None = None
    detector: DetectorOffsets | None = None
    light: tuple[LightMeter, ...] = ()
    search: SearchMemory | None = None
    recent: tuple[Tracked, ...] = ()
    passed_over: tuple[FrameResult, ...] = ()
    lost: bool = False


def known(state: TrackingState) -> tuple[MotionHistory, FrameImages]:
    """Return the history and the previous images, which every state after the first frame holds."""
    assert state.history is not None
    assert state.previous is not None
    return state.history, state.previous
