"""The local refinement of sec. 4.2: correspondences, rows, least squares."""

from ._least_squares import (
    Prior as Prior,
    Rows as Rows,
    descend as descend,
    free_prior as free_prior,
    sum_of_squares as sum_of_squares,
)
from ._refine import (
    DetectionPlan as DetectionPlan,
    Refinement as Refinement,
    RefinePlan as RefinePlan,
    RefineWeights as RefineWeights,
    detection_rays as detection_rays,
)
from ._surface_flow import (
    Comparison as Comparison,
    FlowSettings as FlowSettings,
    Source as Source,
    compare as compare,
    compare_views as compare_views,
    padded as padded,
    picture_source as picture_source,
    same_time_sources as same_time_sources,
    surface_flow as surface_flow,
)
from ._transfer import View as View
