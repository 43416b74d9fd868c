"""Competitors behind the tracker's interface: values for `jm.track(observations, tracker=...)`, all with the same
cameras, mesh, first pose, selected frames and metric."""

from collections.abc import Callable

from jaxmocap._results import InputError
from jaxmocap._types import Quality
from jaxmocap.track import Method, Tracker

from ._colour_histograms import ColourHistograms as ColourHistograms, selected_histograms as selected_histograms
from ._differentiable_rendering import (
    RenderedColours as RenderedColours,
    differentiable_rendering as differentiable_rendering,
)
from ._differentiable_visibility import DifferentiableVisibility as DifferentiableVisibility, descend as descend
from ._follower import Baseline as Baseline, Follower as Follower
from ._gaussian_body import GaussianBody as GaussianBody, colour_cone as colour_cone
from ._gaussian_visibility import GaussianVisibility as GaussianVisibility, gaussian_visibility as gaussian_visibility
from ._graph_cut import GridCut as GridCut
from ._hasler import SegmentAndFit as SegmentAndFit
from ._image_gaussians import image_gaussians as image_gaussians
from ._keypoint_fit import KeypointFit as KeypointFit
from ._keypoints import KeypointTriangulation as KeypointTriangulation, without_keypoints as without_keypoints
from ._optimisers import (
    CovarianceMatrixAdaptation as CovarianceMatrixAdaptation,
    annealed_particle_filter as annealed_particle_filter,
    covariance_matrix_adaptation as covariance_matrix_adaptation,
    flow_only as flow_only,
    local_only as local_only,
    with_keypoints as with_keypoints,
)
from ._posecut import PoseCut as PoseCut
from ._stick_figure import StickFigure as StickFigure
from ._sums_of_gaussians import (
    SumsEnergy as SumsEnergy,
    SumsOfGaussians as SumsOfGaussians,
    colour_similarity as colour_similarity,
    conditioned_ascent as conditioned_ascent,
)

METHODS: dict[str, Callable[[Quality], Tracker | Method]] = {
    "ours": Tracker.preset,
    "ours-with-keypoints": with_keypoints,
    "local": local_only,
    "annealed-particle-filter": annealed_particle_filter,
    "cma-es": covariance_matrix_adaptation,
    "keypoints": lambda quality: KeypointTriangulation(),
    "keypoint-fit": lambda quality: KeypointFit(),
    "hasler-1": lambda quality: SegmentAndFit(iterations=1),
    "hasler-5": lambda quality: SegmentAndFit(iterations=5),
    "posecut": lambda quality: PoseCut(),
    "sums-of-gaussians": lambda quality: SumsOfGaussians(),
    "flow": flow_only,
    "differentiable-rendering": differentiable_rendering,
    "differentiable-visibility": lambda quality: DifferentiableVisibility(),
}
"""By name; those that share parts with the tracker take them from the preset of this quality. Add your own:
`METHODS["still"] = lambda quality: StandingStill()`."""

BUILT_IN = frozenset(METHODS)
"""Names of the methods that jaxmocap comes with."""


def method(name: str, quality: Quality = "normal") -> Tracker | Method:
    """Return the method of this name. Raises `InputError` for an unknown name."""
    if name not in METHODS:
        raise InputError(f"there is no method '{name}'; choose one of {', '.join(METHODS)}.")
    return METHODS[name](quality)
