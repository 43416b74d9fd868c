"""Metrics: the paper's marker protocol, joint errors, silhouette agreement, and the evaluation of a result."""

from jaxmocap.geometry import Similarity as Similarity, align_cameras as align_cameras, fit_similarity as fit_similarity

from ._evaluate import evaluate as evaluate, evaluation_table as evaluation_table
from ._joints import (
    COMPARABLE as COMPARABLE,
    JOINTS as JOINTS,
    JointErrors as JointErrors,
    joint_errors as joint_errors,
    joint_statistics as joint_statistics,
)
from ._markers import (
    MarkerError as MarkerError,
    marker_error as marker_error,
    marker_statistics as marker_statistics,
)
from ._motion_quality import (
    FootSkate as FootSkate,
    accelerations as accelerations,
    foot_skate as foot_skate,
    jitter as jitter,
)
from ._surface import (
    nearest_on_surface as nearest_on_surface,
    silhouette_iou as silhouette_iou,
)
from ._truth import Truth as Truth
