"""Rhodin, Robertini, Richardt, Seidel, Theobalt: A versatile scene model with differentiable visibility applied to
generative pose estimation, ICCV 2015, as a tracker: downhill on `GaussianVisibility` from the last pose."""

from dataclasses import dataclass
from typing import Literal

from jaxtyping import Array, Float

from jaxmocap._cache import cached_jit
from jaxmocap.character import Pose, Skeleton
from jaxmocap.motion import MotionHistory
from jaxmocap.observation import Frame, FrameProblem, Observations
from jaxmocap.search import downhill

from ._follower import Baseline, Follower
from ._gaussian_visibility import GaussianVisibility, gaussian_visibility


@cached_jit
def descend(
    term: GaussianVisibility, skeleton: Skeleton, pose: Pose, problem: FrameProblem, steps: int, tolerance: float
) -> tuple[Pose, Float[Array, ""]]:
    """Go downhill on the weighted term within the joint limits; return the pose and its energy."""

    def value(moved: Pose) -> tuple[Float[Array, ""], None]:
        return term.weight * term.score_pose(skeleton, moved, problem), None

    found, (energy, _) = downhill(value, skeleton, pose, steps, tolerance)
    return found, energy


@dataclass(frozen=True)
class DifferentiableVisibility(Baseline):
    """The pose at which what is seen of the body's translucent Gaussians, and of the background past them, is most like
    the picture, found by going downhill from the last pose.

    There is no search, no optical flow, no refinement and no solving of the whole clip.

    Departures: colours are compared by psi_f of Eq. 3, the mean over the faces around a Gaussian, and the background by
    psi_b, where the publication has one colour per Gaussian in HSV and a picture of the background; Gaussians come from
    the mesh; a ray meets those eight that block most, each sampled at four quantiles; every second pixel is
    looked at; the method is BFGS in place of conditioned gradient descent. `cost="ratio"` has the costs of Eq. 6. The
    publication is quoted as it is known, not held against the print.

    Attributes:
        gaussians: of the body; 300, ours.
        step: every so many pixels one is looked at; 2, ours.
        cost: "distance", after the publication, or "ratio", Eq. 6.
        weight: of the energy; 10, ours: BFGS takes its first step as long as the slope is steep.
        steps: of the descent at most; 60, ours: an arm bent by ten degrees in every joint is not home after 40.
        tolerance: relative and absolute change of energy and pose at which it stops; 1e-4, as in `PolishPlan`.
    """

    gaussians: int = 300
    step: int = 2
    cost: Literal["distance", "ratio"] = "distance"
    weight: float = 10.0
    steps: int = 60
    tolerance: float = 1e-4

    name = "differentiable visibility"

    def learn_appearance(self, observations: Observations) -> GaussianVisibility:
        """Fill the body with Gaussians, and compare them with the palette as the faces around them do."""
        return gaussian_visibility(
            observations.character,
            observations.surface,
            self.gaussians,
            weight=self.weight,
            cost=self.cost,
            step=self.step,
        )

    def start(self, worker: Follower, history: MotionHistory, timestamp: float) -> Pose:
        """Begin at the last pose."""
        return history.pose

    def find(self, worker: Follower, frame: Frame, start: Pose) -> Pose:
        skeleton = worker.character.skeleton
        return descend(worker.memory, skeleton, start, frame.problem, self.steps, self.tolerance)[0]
