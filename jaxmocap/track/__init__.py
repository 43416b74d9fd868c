"""The loop of sec. 4: state, one frame, the sequence, checkpoints."""

from ._backward_search import BackwardSearch as BackwardSearch
from ._checkpoint import Checkpoint as Checkpoint
from ._frame import Answer as Answer, FrameTracker as FrameTracker, Step as Step, Worker as Worker
from ._sequence import (
    Method as Method,
    Progress as Progress,
    clip_plan as clip_plan,
    motion_of as motion_of,
    track as track,
    track_frames as track_frames,
)
from ._settings import with_settings as with_settings
from ._start import flow_start as flow_start
from ._state import TrackingState as TrackingState
from ._tracker import Tracker as Tracker
