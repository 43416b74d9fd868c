"""A character made to measure: how it is fitted, and what comes of it."""

from dataclasses import dataclass, field, replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxmocap.character import BodyShape, Character, Pose, scaled
from jaxmocap.refiners import AbstractRefiner, LeastSquares, Shooting

from ._fit_surface import SurfaceSettings
from ._shape_problem import ShapePrior


def _levenberg_marquardt(steps: int) -> LeastSquares:
    """Make the solver; the walls of its box are low, for where an angle stands at its limit higher ones stop it."""
    return LeastSquares(smoothing=(1e-2,), max_steps=steps, bound_weight=jnp.asarray(10.0))


@dataclass(frozen=True)
class CharacterFitSettings:
    """How a character is fitted to keypoints and masks of several frames. Not in the paper.

    Attributes:
        prior: keeps the body human.
        keypoint_scale: metres off a keypoint's ray that count as one standard deviation.
        keypoint_scale_beside_masks: the same once masks count, whose outlines are more exact than a detector's points.
        robust: metres beyond which a keypoint fades (Geman and McClure), one solve after the other.
        mask_rounds: times that contours are tied to the masks anew.
        refiner: solves for shape and poses together.
        mask_refiner: the same after every tie to the masks, which moves the body a little.
        pose_refiner: solves for the poses alone.
        surface: moves the surface to the masks' outlines at last; None leaves it to lengths and girths.
        misfit: of the fitted character (`Character.misfit`), metres: about what three films with true joints ask for.
    """

    prior: ShapePrior = field(default_factory=ShapePrior)
    keypoint_scale: float = 0.01
    keypoint_scale_beside_masks: float = 0.03
    robust: tuple[float, ...] = (0.15, 0.05, 0.03)
    mask_rounds: int = 5
    refiner: AbstractRefiner = field(default_factory=lambda: _levenberg_marquardt(40))
    mask_refiner: AbstractRefiner = field(default_factory=lambda: _levenberg_marquardt(20))
    pose_refiner: AbstractRefiner = field(default_factory=Shooting)
    surface: SurfaceSettings | None = field(default_factory=SurfaceSettings)
    misfit: float = 0.01


@dataclass(frozen=True)
class CharacterFit:
    """A character made to measure.

    Attributes:
        character: the fitted one.
        height: how tall it is without what the outlines add to its surface (hair, a cap, soles), metres.
        shape: what makes it of the generic one.
        poses: in which it was fitted, by frame.
        offsets: where a detector sees a landmark of the left side, from the landmark, metres in the rest frame.
        keypoint_error: median distance of points and keypoints' rays, metres.
        generic_error: the same of the generic character in its own best poses.
        num_masks: how many masks took part.
        surface: offsets of the vertices along their normals at rest, metres, that the masks' outlines ask for on top of
            `shape`; None without masks.
        camera_scale: by which the positions of the cameras are to be multiplied for body and poses to belong to them.
    """

    character: Character
    height: float
    shape: BodyShape
    poses: dict[int, Pose]
    offsets: dict[str, Float[np.ndarray, "3"]]
    keypoint_error: float
    generic_error: float
    num_masks: int
    surface: Float[np.ndarray, "vertex"] | None = None
    camera_scale: float = 1.0

    def scaled_to(self, height: float) -> "CharacterFit":
        """Scale the body, its poses and the cameras alike, so that the body is `height` metres tall.

        For cameras whose scale is less certain than the height: fitted without a height, the body is as tall as its
        outlines are in these cameras, and that tells how much too large or too small their world is. Bones alone, by
        which `calibrate` finds the scale, leave some 4 % open, for people of one height differ in their limbs.
        """
        factor = height / self.height
        grown = float(np.log(factor))
        poses = {frame: Pose(pose.root.at[:3, 3].multiply(factor), pose.angles) for frame, pose in self.poses.items()}
        return replace(
            self,
            character=scaled(self.character, BodyShape.of(grown)),
            height=height,
            shape=BodyShape(self.shape.height + grown, self.shape.lengths, self.shape.girths),
            poses=poses,
            offsets={name: factor * offset for name, offset in self.offsets.items()},
            keypoint_error=factor * self.keypoint_error,
            generic_error=factor * self.generic_error,
            surface=None if self.surface is None else factor * self.surface,
            camera_scale=factor * self.camera_scale,
        )
