"""Silhouette energy: disagreement of the projected mesh with a person mask (registration at the selected frames)."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmocap._types import Knob, knob
from jaxmocap.render import crop

from ._body import GroupProblem
from ._term import AbstractTerm, Drawn


class Silhouette(AbstractTerm):
    """XOR area over the model's area plus over the mask's area, halved, averaged over views (Gall et al. 2009, sec. 4).

    `masks (camera, height, width)`: 1 where the person is, in the rectangle.
    """

    masks: Float[Array, "camera height width"]
    weight: Knob = knob(1.0)

    name: ClassVar[str] = "silhouette"

    def prepare(self, base: Array, group: GroupProblem) -> Float[Array, "camera"]:
        """Measure the masks."""
        return self.masks.sum((1, 2))

    def score(self, prepared: Array, drawn: Drawn, group: GroupProblem) -> Float[Array, ""]:
        """Average 0.5 (XOR / model area + XOR / mask area) over the views."""
        covered = crop(drawn.buffers) > group.layout.empty
        wrong = (covered != (self.masks > 0.5)).sum((1, 2)) + drawn.outside
        model = covered.sum((1, 2)) + drawn.outside
        return 0.5 * (wrong / jnp.maximum(model, 1.0) + wrong / jnp.maximum(prepared, 1.0)).mean()
