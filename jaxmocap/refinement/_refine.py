"""Settings of the refinement of sec. 4.2."""

from dataclasses import dataclass, field
from typing import Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmocap._results import InputError
from jaxmocap._types import Knob, knob
from jaxmocap.character import Pose, Skeleton, difference, retract
from jaxmocap.energies import ContourSettings, Keypoints, LandmarkRays, contour_lines, keypoint_rays
from jaxmocap.motion import MotionHistory
from jaxmocap.observation import BODY_25, FACE, Frame, FrameProblem, Observations, draw
from jaxmocap.refiners import AbstractRefiner, LeastSquares

from ._compare import FlowSettings
from ._least_squares import Prior, Rows, descend, free_prior
from ._surface_flow import surface_flow
from ._views import View, current_views, known_view

EVIDENCE_SCALE = np.float32(0.02)
"""Metres that count as 1 in the J^T J that a refinement tells, whatever counts as 1 in what it minimises."""


class RefineWeights(eqx.Module):
    """Numbers of Eqs 8 to 10, all array leaves.

    Attributes:
        regularisation: lambda_reg, 3 in the paper.
        residual_scale: metres that count as 1 in the data term, for which the paper gives no unit; with it the L1's
            dead zone is about 0.06 degrees for a forearm.
        prior: factor on the pull to the autoregression's prediction against lambda_reg; 1 is the paper.
        robust: Geman-McClure scale, metres.
        contour: weight of contour rows.
        surface: weight of surface rows, which are not in the paper.
    """

    regularisation: Knob = knob(3.0)
    residual_scale: Knob = knob(0.10)
    prior: Knob = knob(1.0)
    robust: Knob = knob(0.02)
    contour: Knob = knob(1.0)
    surface: Knob = knob(1.0)


@dataclass(frozen=True)
class RefinePlan:
    """The local refinement of sec. 4.2. `RefinePlan()` is the paper.

    Attributes:
        rounds: of association and solving; 6 in the paper.
        steps: of Gauss-Newton per round.
        robust_start: widens the robust scale of the first round; halved every round.
        contours: how contours look for their edge.
        surface_flow: adds the correspondences transferred over the surface from the selected frames and the other
            views.
        weights: of the rows and the prior.
        refiner: solves the compressed least-squares problem with the L1, the prior and the joint limits.
        autoregression: how the next increment is predicted, see `predict_difference`.
    """

    rounds: int = 6
    steps: int = 2
    robust_start: float = 1.0
    contours: ContourSettings = field(default_factory=ContourSettings)
    surface_flow: bool = False
    weights: RefineWeights = field(default_factory=RefineWeights)
    refiner: AbstractRefiner = field(default_factory=LeastSquares)
    autoregression: Literal["ridge", "quadratic", "velocity"] = "ridge"

    def __post_init__(self) -> None:
        if self.rounds < 1 or self.steps < 1:
            raise InputError(
                f"a refinement has one round of one step at least, not {self.rounds} of {self.steps}; to leave it out "
                "say refine=off."
            )


@dataclass(frozen=True)
class DetectionPlan:
    """How a detector's keypoints count, where the observations have any. Not in the paper.

    Attributes:
        search: the term of the search energy.
        weight: of a point's rows in the refinement, where those of a contour have `RefineWeights.contour`.
        robust: metres beyond which a point fades there (Geman and McClure).
    """

    search: Keypoints = field(default_factory=Keypoints)
    weight: float = 1.0
    robust: float = 0.05


def detection_rays(
    skeleton: Skeleton, problem: FrameProblem, scale: float | Array, robust: float | Array
) -> LandmarkRays:
    """Build the rows of a frame's detections: `scale` metres count as 1, beyond `robust` metres a point fades."""
    return keypoint_rays(
        skeleton,
        problem.intrinsics,
        problem.cam_from_world,
        problem.keypoints,
        scale=scale,
        robust=robust,
        table=BODY_25 | FACE,
        offsets=problem.keypoint_offsets,
    )


class Refinement:
    """Refines poses of a sequence's frames; keeps the pictures of the selected frames it compares with (host)."""

    def __init__(
        self,
        observations: Observations,
        plan: RefinePlan,
        flow: FlowSettings | None = None,
        detections: DetectionPlan | None = None,
    ):
        self.observations = observations
        self.character = observations.character
        self.plan = plan
        self.flow = FlowSettings() if flow is None else flow
        self.detections = detections
        self._selected: dict[tuple[int, int], View] = {}

    def __call__(
        self, frame: Frame, pose: Pose, history: MotionHistory | None
    ) -> tuple[Pose, Float[np.ndarray, "dof dof"] | None]:
        """Refine the pose; return it with J^T J of the last step, of rows in units of `EVIDENCE_SCALE`."""
        plan, skeleton, problem = self.plan, self.character.skeleton, frame.problem
        base = history.pose if history is not None else pose
        prior = self._motion_prior(base, history, frame.timestamp)
        points = () if self.detections is None else (self._detection_rows(problem, self.detections),)
        hessian = None
        for round_index in range(plan.rounds):
            rows = self.rows(frame, pose, max(1.0, plan.robust_start / 2.0**round_index))
            delta = difference(skeleton, base, pose)
            delta, hessian = descend(self.character, base, delta, rows, points, prior, plan.refiner, steps=plan.steps)
            pose = retract(skeleton, base, delta)
        unit = np.float32(plan.weights.residual_scale) / EVIDENCE_SCALE
        return pose, unit**2 * np.asarray(hessian) if hessian is not None else None

    def _detection_rows(self, problem: FrameProblem, plan: DetectionPlan) -> LandmarkRays:
        scale = self.plan.weights.residual_scale / np.sqrt(max(plan.weight, 1e-9))
        return detection_rays(self.character.skeleton, problem, scale, plan.robust)

    def rows(self, frame: Frame, pose: Pose, widen: float = 1.0) -> tuple[Rows, ...]:
        """Associate the surface at a pose with the pictures: what the next step pulls at, and how the pictures of the
        frame disagree with the pose. `widen` is a factor of the robust scale."""
        problem, weights = frame.problem, self.plan.weights
        vertices, ids, inverse = draw(self.character, pose, problem)
        lines = contour_lines(vertices, self.character.faces, ids, inverse, problem, self.plan.contours)
        scale = weights.residual_scale / jnp.sqrt(jnp.maximum(weights.contour, 1e-9))
        rows = [Rows(lines, scale, widen * weights.robust)]
        if self.plan.surface_flow:
            sources, views = self._selected_sources(frame.number), current_views(frame.crops(), problem, vertices, ids)
            for m, own in enumerate(sources):
                own += [view for n, view in enumerate(views) if n != m]
            flows = surface_flow(self.character.faces, problem.surface.near_faces, views, sources, self.flow)
            scale = weights.residual_scale / jnp.sqrt(jnp.maximum(weights.surface, 1e-9))
            rows += [Rows(lines, scale, widen * weights.robust) for lines in flows]
        return tuple(rows)

    def _selected_sources(self, frame: int) -> list[list[View]]:
        """Per camera the nearest selected frame, seen by that camera."""
        observed = self.observations
        serving = sorted(observed.key_poses, key=lambda g: (abs(g - frame), g))[:1]
        for camera in range(observed.cameras.num_cameras):
            for selected in serving:
                if (camera, selected) not in self._selected:
                    image, pose = observed.capture.image(camera, selected), observed.key_poses[selected]
                    self._selected[camera, selected] = known_view(
                        self.character, observed.cameras, image, selected, camera, pose
                    )
        return [[self._selected[camera, g] for g in serving] for camera in range(observed.cameras.num_cameras)]

    def _motion_prior(self, base: Pose, history: MotionHistory | None, timestamp: float) -> Prior:
        """Eq. 10 for the increment to the next frame, which may be several steps away.

        Of the frames between, Eq. 10 is at its least over their increments: the L1 of all of them is that of their sum,
        and where velocity drifts by equal variances from step to step, its sum over s steps has that of one step times
        1 + 4 + ... + s^2.
        """
        limits = free_prior(self.character, base)
        if history is None:
            return limits
        lam, pull = np.float32(self.plan.weights.regularisation), np.float32(self.plan.weights.prior)
        target = np.asarray(history.predicted(self.plan.autoregression, timestamp), np.float32)
        steps = history.steps(timestamp)
        spread = np.float32(steps * (steps + 1) * (2 * steps + 1) / 6)
        unit = np.repeat(np.array([2, 1], np.float32), [3, len(target) - 3])
        return limits._replace(l1=lam * unit, weight=lam * pull * unit**2 / spread, target=target)
