"""Metrics: the paper's marker protocol, joint errors, silhouette agreement, and the evaluation of a result."""

from jaxmocap.geometry import Similarity as Similarity, align_cameras as align_cameras, fit_similarity as fit_similarity

from ._evaluate import evaluate as evaluate
from ._foot_skate import FootSkate as FootSkate, foot_skate as foot_skate
from ._joints import (
    JOINTS as JOINTS,
    JointErrors as JointErrors,
    accelerations as accelerations,
    jitter as jitter,
    joint_errors as joint_errors,
)
from ._markers import MarkerError as MarkerError, marker_error as marker_error
from ._masks import silhouette_iou as silhouette_iou
from ._statistics import joint_statistics as joint_statistics, marker_statistics as marker_statistics
from ._surface import nearest_on_surface as nearest_on_surface
from ._table import evaluation_table as evaluation_table
from ._truth import Truth as Truth
