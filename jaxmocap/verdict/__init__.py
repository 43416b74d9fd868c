"""How far results may be trusted: signals, confidence, lost parts, outlier cameras, uncertainty."""

from ._doubts import Doubt as Doubt, doubts as doubts
from ._frame_verdict import (
    FrameResult as FrameResult,
    VerdictSettings as VerdictSettings,
    judge_frame as judge_frame,
    passed_over as passed_over,
    poses_between as poses_between,
)
from ._lost import LostSpan as LostSpan, lost_spans as lost_spans
from ._outlier_camera import OutlierCamera as OutlierCamera, outlier_cameras as outlier_cameras
from ._sequence_verdict import (
    GUIDE_ENTRIES as GUIDE_ENTRIES,
    SequenceVerdict as SequenceVerdict,
    judge_sequence as judge_sequence,
)
from ._signals import FrameSignals as FrameSignals, frame_signals as frame_signals
from ._uncertainty import (
    UncertaintySettings as UncertaintySettings,
    joint_covariances as joint_covariances,
    usual_deviations as usual_deviations,
)
