"""Settings of the refinement of sec. 4.2."""

from dataclasses import dataclass, field
from typing import Literal

import equinox as eqx

from jaxmocap._types import Knob, knob
from jaxmocap.energies import ContourSettings, Keypoints
from jaxmocap.refiners import AbstractRefiner, LeastSquares

from ._surface_flow import FlowSettings


class RefineWeights(eqx.Module):
    """Numbers of Eqs 8 to 10, all array leaves.

    `regularisation` is lambda_reg = 3 of the paper; `residual_scale` the metres that count as 1 in the data term (the
    paper gives no unit): with it the L1's dead zone is about 0.06 degrees for a forearm. `prior` scales the pull to the
    autoregression's prediction against lambda_reg, 1 is the paper. `robust` is the Geman-McClure scale in metres.
    """

    regularisation: Knob = knob(3.0)
    residual_scale: Knob = knob(0.10)
    prior: Knob = knob(1.0)
    robust: Knob = knob(0.02)
    contour: Knob = knob(1.0)
    surface: Knob = knob(1.0)


@dataclass(frozen=True)
class RefinePlan:
    """The local refinement: `rounds` of association and solving; `robust_start` widens the robust scale of the first
    round, halved every round; `edges` is where contours look for their edge, the Canny picture (the paper) or the
    outline of what is not background; `surface_flow` adds to the paper's contour rows the correspondences carried over
    the surface from the selected frames and the other views."""

    rounds: int = 6
    steps: int = 2
    robust_start: float = 1.0
    contours: ContourSettings = field(default_factory=ContourSettings)
    edges: Literal["canny", "background"] = "canny"
    surface_flow: bool = False
    flow: FlowSettings = field(default_factory=FlowSettings)
    weights: RefineWeights = field(default_factory=RefineWeights)
    refiner: AbstractRefiner = field(default_factory=LeastSquares)
    autoregression: Literal["ridge", "quadratic", "velocity"] = "ridge"


@dataclass(frozen=True)
class DetectionPlan:
    """How a detector's keypoints count, where the observations have any: as the term `search` of the search energy, and
    as rows of the refinement, where `scale` metres from a point's ray count as 1 and beyond `robust` metres it fades.
    """

    search: Keypoints = field(default_factory=Keypoints)
    scale: float = 0.1
    robust: float = 0.05
