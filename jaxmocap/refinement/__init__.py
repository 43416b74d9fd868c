"""The local refinement of sec. 4.2: correspondences, rows, least squares."""

from ._compare import (
    Comparison as Comparison,
    FlowSettings as FlowSettings,
    compare as compare,
)
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
    FOLLOWED_SCALE as FOLLOWED_SCALE,
    follow_surface as follow_surface,
    surface_flow as surface_flow,
)
from ._views import View as View, current_views as current_views, known_view as known_view
