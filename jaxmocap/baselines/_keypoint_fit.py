"""A body fitted to a detector's keypoints in all views together, as SMPLify does it: Bogo et al., Keep it SMPL, ECCV
2016."""

from dataclasses import dataclass

import jax.numpy as jnp
from jaxtyping import PRNGKeyArray

from jaxmocap.character import ROOT_DOFS, Character, Pose, clamp, retract
from jaxmocap.motion import MotionHistory
from jaxmocap.observation import Frame, Observations
from jaxmocap.refinement import Prior, descend, detection_rays, free_prior
from jaxmocap.refiners import Shooting

from ._follower import Baseline, Follower
from ._keypoints import asked_for_keypoints


@dataclass(frozen=True)
class KeypointFit(Baseline):
    """The pose whose joints lie nearest to the rays of the keypoints of all views, weighed by confidence, with a robust
    loss (Geman and McClure) that is made stricter, joint limits and a pose prior. No pixel is looked at.

    SMPLify knows one view, projects onto the picture, has a mixture of Gaussians of recorded poses as prior, and fits
    the shape. Here the character is known, distances are those to the rays, and the prior is a Gaussian over the limits
    of every joint. Needs observations with `detections`.

    Attributes:
        scale: metres that count as 1; 0.02, as in `KeypointTriangulation`.
        robust: metres beyond which a keypoint fades, one solve after the other; 0.3, 0.15, 0.08, ours.
        prior: weight of the pull to the middle of a joint's limits, whose half width counts as 1; 0.05, ours.
        smoothness: weight of the pull to the last pose, per radian or metre squared; 0.02, as in
            `KeypointTriangulation`.
        steps: of each solve; 8, ours.
    """

    scale: float = 0.02
    robust: tuple[float, ...] = (0.3, 0.15, 0.08)
    prior: float = 0.05
    smoothness: float = 0.02
    steps: int = 8

    name = "keypoint fit"

    def follow(self, observations: Observations, key: PRNGKeyArray) -> Follower:
        """Make the worker of one sequence. Raises `InputError` where the observations hold no detections."""
        return super().follow(asked_for_keypoints(observations, "a fit to keypoints"), key)

    def start(self, worker: Follower, history: MotionHistory, timestamp: float) -> Pose:
        """Begin at the last pose."""
        return history.pose

    def find(self, worker: Follower, frame: Frame, start: Pose) -> Pose:
        character, skeleton = worker.character, worker.character.skeleton
        delta, prior = jnp.zeros(skeleton.num_dofs), self._prior(character, start)
        if not bool((frame.problem.keypoints[..., 2] > 0).any()):
            return start
        for robust in self.robust:
            rays = (detection_rays(skeleton, frame.problem, self.scale, robust),)
            delta, _ = descend(character, start, delta, (), rays, prior, Shooting(), steps=self.steps)
        return clamp(skeleton, retract(skeleton, start, delta))

    def _prior(self, character: Character, base: Pose) -> Prior:
        """Join both pulls to one: squares with a common weight and place."""
        skeleton, prior = character.skeleton, free_prior(character, base, self.smoothness)
        middle = 0.5 * (skeleton.lower + skeleton.upper) - base.angles
        half = jnp.maximum(0.5 * (skeleton.upper - skeleton.lower), 1e-3)
        pull = jnp.concatenate([jnp.zeros(ROOT_DOFS), self.prior / half**2])
        weight = prior.weight + pull
        target = pull * jnp.concatenate([jnp.zeros(ROOT_DOFS), middle]) / weight
        return prior._replace(weight=weight, target=target)
