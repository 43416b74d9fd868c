"""Sec. 4.2: the local refinement of one frame, Eqs 8 to 10, on the increment from the last frame."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt8

from jaxmocap.character import Pose, Skeleton, difference, retract
from jaxmocap.energies import LandmarkRays, contour_lines, keypoint_rays
from jaxmocap.motion import MotionHistory
from jaxmocap.observation import BODY_25, FACE, Frame, FrameProblem, Observations, draw

from ._least_squares import Prior, Rows, descend, free_prior
from ._plan import DetectionPlan, RefinePlan
from ._surface_flow import Source, padded, picture_source, same_time_sources, surface_flow


def detection_rays(
    skeleton: Skeleton, problem: FrameProblem, plan: DetectionPlan, robust: float | None = None
) -> LandmarkRays:
    """The rows of a frame's detections."""
    return keypoint_rays(
        skeleton,
        problem.intrinsics,
        problem.cam_from_world,
        problem.keypoints,
        scale=plan.scale,
        robust=plan.robust if robust is None else robust,
        table=BODY_25 | FACE,
    )


class Refinement:
    """Refines poses of a sequence's frames; keeps the pictures of the selected frames it compares with (host)."""

    def __init__(self, observations: Observations, plan: RefinePlan, detections: DetectionPlan | None = None):
        self.observations = observations
        self.character = observations.character
        self.plan = plan
        self.detections = detections
        self._selected: dict[tuple[int, int], Source] = {}

    def __call__(
        self, frame: Frame, pose: Pose, history: MotionHistory | None
    ) -> tuple[Pose, Float[np.ndarray, "dof dof"] | None]:
        """The refined pose, and J^T J of the last step."""
        plan, skeleton, problem = self.plan, self.character.skeleton, frame.problem
        base = history.pose if history is not None else pose
        prior = self._motion_prior(base, history)
        detections = self.detections
        points = () if detections is None else (detection_rays(skeleton, problem, detections),)
        hessian = None
        crops = frame.crops()
        for round_index in range(plan.rounds):
            widen = max(1.0, plan.robust_start / 2.0**round_index)
            vertices, ids, inverse = draw(self.character, pose, problem)
            lines = contour_lines(vertices, self.character.faces, ids, inverse, problem, plan.contours)
            weights = plan.weights
            scale = weights.residual_scale / jnp.sqrt(jnp.maximum(weights.contour, 1e-9))
            rows = [Rows(lines, scale, widen * weights.robust)]
            if plan.surface_flow:
                rows += self._surface_rows(vertices, ids, crops, frame, widen)
            delta = difference(skeleton, base, pose)
            delta, hessian = descend(
                self.character, base, delta, tuple(rows), points, prior, plan.refiner, steps=plan.steps
            )
            pose = retract(skeleton, base, delta)
        return pose, np.asarray(hessian) if hessian is not None else None

    def _surface_rows(
        self,
        vertices: Float[Array, "vertex 3"],
        ids: Int[Array, "camera height width"],
        crops: list[UInt8[np.ndarray, "height width 3"]],
        frame: Frame,
        widen: float,
    ) -> list[Rows]:
        problem = frame.problem
        cameras, weights = range(problem.num_cameras), self.plan.weights
        sources = self._selected_sources(frame.number)
        pictures = [padded(crop, origin) for crop, origin in zip(crops, np.asarray(problem.origins), strict=True)]
        views = same_time_sources(pictures, problem, vertices, ids)
        for m in cameras:
            sources[m] = sources[m] + [views[n] for n in cameras if n != m]
        flows = surface_flow(self.character, vertices, ids, crops, problem, sources, self.plan.flow)
        scale = weights.residual_scale / jnp.sqrt(jnp.maximum(weights.surface, 1e-9))
        return [Rows(lines, scale, widen * weights.robust) for lines in flows]

    def _selected_sources(self, frame: int) -> list[list[Source]]:
        """Per camera the nearest selected frame, seen by that camera."""
        observed = self.observations
        serving = sorted(observed.key_poses, key=lambda g: (abs(g - frame), g))[:1]
        for camera in range(observed.cameras.num_cameras):
            for selected in serving:
                if (camera, selected) not in self._selected:
                    image, pose = observed.capture.image(camera, selected), observed.key_poses[selected]
                    self._selected[camera, selected] = picture_source(
                        self.character, observed.cameras, image, selected, camera, pose
                    )
        return [[self._selected[camera, g] for g in serving] for camera in range(observed.cameras.num_cameras)]

    def _motion_prior(self, base: Pose, history: MotionHistory | None) -> Prior:
        limits = free_prior(self.character, base)
        if history is None:
            return limits
        lam, pull = np.float32(self.plan.weights.regularisation), np.float32(self.plan.weights.prior)
        target = np.asarray(history.predicted(self.plan.autoregression), np.float32)
        unit = np.repeat(np.array([2, 1], np.float32), [3, len(target) - 3])
        return limits._replace(l1=lam * unit, weight=lam * pull * unit**2, target=target)
