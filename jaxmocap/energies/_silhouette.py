"""Silhouette energy: disagreement of the projected mesh with a person mask (registration at the selected frames)."""

from typing import ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmocap._types import Knob, knob
from jaxmocap.render import crop

from ._body import GroupProblem, region_mask
from ._term import AbstractTerm, Drawn


class _Prepared(NamedTuple):
    mask: Float[Array, "camera height width"]
    elsewhere_wrong: Float[Array, "camera"]
    elsewhere_model: Float[Array, "camera"]
    mask_area: Float[Array, "camera"]


class Silhouette(AbstractTerm):
    """XOR area over the model's area plus over the mask's area, halved, averaged over views (Gall et al. 2009, sec. 4).

    `masks (camera, height, width)`: 1 where the person is, in the rectangle.
    """

    masks: Float[Array, "camera height width"]
    weight: Knob = knob(1.0)

    name: ClassVar[str] = "silhouette"

    def prepare(self, base: Array, group: GroupProblem) -> _Prepared:
        region, cameras = group.region, range(group.frame.num_cameras)
        covered = crop(base) & group.layout.id_mask != group.layout.id_mask
        wrong, model = [], []
        for camera in cameras:
            elsewhere = ~region_mask(region, camera, *group.frame.size)
            wrong.append(jnp.where(elsewhere, covered[camera] != (self.masks[camera] > 0.5), False).sum())
            model.append((elsewhere & covered[camera]).sum())
        return _Prepared(
            jnp.stack([region.cut(self.masks[c], c) for c in cameras]),
            jnp.stack(wrong).astype(jnp.float32),
            jnp.stack(model).astype(jnp.float32),
            self.masks.sum((1, 2)),
        )

    def score(self, prepared: _Prepared, drawn: Drawn, group: GroupProblem) -> Float[Array, ""]:
        """Average 0.5 (XOR / model area + XOR / mask area) over the views."""
        covered = crop(drawn.buffers) > group.layout.empty
        wrong = (covered != (prepared.mask > 0.5)).sum((1, 2)) + prepared.elsewhere_wrong + drawn.outside
        model = covered.sum((1, 2)) + prepared.elsewhere_model + drawn.outside
        return 0.5 * (wrong / jnp.maximum(model, 1.0) + wrong / jnp.maximum(prepared.mask_area, 1.0)).mean()
