"""Motion: poses over time with confidence and provenance, their storage, and motion priors in time."""

from ._frame_times import (
    STRIDE as STRIDE,
    evened as evened,
    usual_interval as usual_interval,
)
from ._history import (
    AngleChoice as AngleChoice,
    MotionHistory as MotionHistory,
    after as after,
    predict_difference as predict_difference,
)
from ._interpolate import at_times as at_times, continuous as continuous, turned as turned
from ._motion import TAILS as TAILS, Contact as Contact, Motion as Motion, cameras_at as cameras_at
from ._storage import read_npz as read_npz
