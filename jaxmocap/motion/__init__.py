"""Motion: poses over time with confidence and provenance, their storage, and motion priors in time."""

from jaxmocap._atomic import (
    atomic_folder as atomic_folder,
    atomic_path as atomic_path,
    write_bytes as write_bytes,
    write_json as write_json,
    write_npz as write_npz,
    write_text as write_text,
)

from ._autoregression import predict_difference as predict_difference
from ._folder import check_output as check_output, claim_output as claim_output
from ._interpolate import at_times as at_times, continuous as continuous
from ._motion import Motion as Motion, cameras_at as cameras_at
from ._storage import read_npz as read_npz
from ._turned import turned as turned
