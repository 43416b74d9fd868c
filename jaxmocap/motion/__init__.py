"""Motion: poses over time with confidence and provenance, their storage, and motion priors in time."""

from ._autoregression import predict_difference as predict_difference
from ._history import AngleChoice as AngleChoice, MotionHistory as MotionHistory, after as after
from ._interpolate import at_times as at_times, continuous as continuous
from ._motion import Motion as Motion, cameras_at as cameras_at
from ._storage import read_npz as read_npz
from ._turned import turned as turned
