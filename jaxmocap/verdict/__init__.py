"""How far results may be trusted: signals, confidence, lost parts, outlier cameras, uncertainty."""

from ._doubts import Doubt as Doubt, doubts as doubts, with_doubts as with_doubts
from ._frame_result import FrameResult as FrameResult, between as between, passed_over as passed_over
from ._frame_verdict import Verdict as Verdict, VerdictSettings as VerdictSettings, judge as judge
from ._lost import (
    LostSpan as LostSpan,
    limb_deviation as limb_deviation,
    lost_spans as lost_spans,
    without_trust as without_trust,
)
from ._outlier_camera import OutlierCamera as OutlierCamera, outlier_cameras as outlier_cameras
from ._signals import FrameSignals as FrameSignals, frame_signals as frame_signals
from ._uncertainty import (
    UncertaintySettings as UncertaintySettings,
    joint_covariances as joint_covariances,
    mean_deviations as mean_deviations,
)
