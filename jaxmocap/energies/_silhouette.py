"""Silhouette energy: disagreement of the projected mesh with a person mask (registration at the selected frames)."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmocap._types import Knob, knob
from jaxmocap.observation import FrameProblem
from jaxmocap.render import KeyLayout, crop

from ._body import Region, region_mask


class _Prepared(NamedTuple):
    mask: Float[Array, "camera height width"]
    elsewhere_wrong: Float[Array, "camera"]
    elsewhere_model: Float[Array, "camera"]
    mask_area: Float[Array, "camera"]


class Silhouette(eqx.Module):
    """XOR area over the model's area plus over the mask's area, halved, averaged over views (Gall et al. 2009, sec. 4).

    `masks (camera, height, width)`: 1 where the person is, in the rectangle.
    """

    masks: Float[Array, "camera height width"]
    weight: Knob = knob(1.0)

    name = "silhouette"

    def prepare(self, base: Array, region: Region, problem: FrameProblem, layout: KeyLayout) -> _Prepared:
        """What all particles of a group share."""
        height, width = problem.size
        covered = crop(base) & layout.id_mask != layout.id_mask
        wrong, model = [], []
        for camera in range(problem.num_cameras):
            elsewhere = ~region_mask(region, camera, height, width)
            wrong.append(jnp.where(elsewhere, covered[camera] != (self.masks[camera] > 0.5), False).sum())
            model.append((elsewhere & covered[camera]).sum())
        return _Prepared(
            jnp.stack([region.cut(self.masks[c], c) for c in range(problem.num_cameras)]),
            jnp.stack(wrong).astype(jnp.float32),
            jnp.stack(model).astype(jnp.float32),
            self.masks.sum((1, 2)),
        )

    def score(
        self,
        prepared: _Prepared,
        buffers: Array,
        outside: Array,
        region: Region,
        problem: FrameProblem,
        layout: KeyLayout,
    ) -> Float[Array, ""]:
        """Mean over the views of 0.5 (XOR / model area + XOR / mask area)."""
        covered = crop(buffers) > layout.empty
        wrong = (covered != (prepared.mask > 0.5)).sum((1, 2)) + prepared.elsewhere_wrong + outside
        model = covered.sum((1, 2)) + prepared.elsewhere_model + outside
        return 0.5 * (wrong / jnp.maximum(model, 1.0) + wrong / jnp.maximum(prepared.mask_area, 1.0)).mean()
