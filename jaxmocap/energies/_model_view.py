"""Model-view consistency, Eq. 6: does a pixel look like the face that covers it, or like the background?"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxmocap._types import knob
from jaxmocap.observation import FrameProblem
from jaxmocap.render import KeyLayout, crop

from ._body import Region, region_mask

TAU = 1.0
"""The barrier of Eq. 3 for colours in [0, 1]."""


def covered_cost(foreground: Array, background: Array, epsilon: float | Array = 1e-3) -> Array:
    """psi_f / (psi_b + psi_f), with `epsilon` in numerator and twice in the denominator against 0/0 (camouflage)."""
    return (foreground + epsilon) / (foreground + background + 2 * epsilon)


def uncovered_cost(background: Array, epsilon: float | Array = 1e-3) -> Array:
    """psi_b / (psi_b + tau): in [0, 0.5] as printed."""
    return (background + epsilon) / (background + TAU + 2 * epsilon)


class _Prepared(NamedTuple):
    labels: tuple[Array, ...]
    background: tuple[Array, ...]
    uncovered: tuple[Array, ...]
    elsewhere: Float[Array, "camera"]


class ModelView(eqx.Module):
    """Eq. 6, summed over the views (the first sum of Eq. 5).

    `uncovered_scale` 1 is the printed equation; 2 makes both sides symmetric; more trusts the background more than the
    surface's colours, which pays where it is a clean plate. `outside` is the cost of a mesh pixel that leaves the
    rectangle: 1 keeps a pose from hiding there, 0 is the printed equation. psi_f is looked up in the table of palette
    colours; `palette_error` says what that costs.
    """

    weight: Float[Array, ""] = knob(1.0)
    epsilon: Float[Array, ""] = knob(1e-3)
    uncovered_scale: Float[Array, ""] = knob(1.0)
    outside: Float[Array, ""] = knob(1.0)

    name = "model_view"

    def _uncovered(self, background: Array) -> Array:
        return self.uncovered_scale * uncovered_cost(background, self.epsilon)

    def _foreground(self, problem: FrameProblem, camera: int, ids: Array, labels: Array) -> Array:
        table = problem.surface.colour_distance[camera]
        flat = jnp.maximum(ids, 0) * table.shape[1] + labels
        return table.reshape(-1)[flat].astype(jnp.float32)

    def pixel_costs(self, keys: Int[Array, "camera height width"], problem: FrameProblem, layout: KeyLayout) -> Array:
        """Cost of every pixel of the rectangle (camera, height, width), before the average."""
        ids = layout.face(keys)
        costs = []
        for camera in range(problem.num_cameras):
            foreground = self._foreground(problem, camera, ids[camera], problem.labels[camera])
            background = problem.background[camera]
            covered = covered_cost(foreground, background, self.epsilon)
            costs.append(jnp.where(ids[camera] >= 0, covered, self._uncovered(background)))
        return jnp.stack(costs)

    def prepare(self, base: Array, region: Region, problem: FrameProblem, layout: KeyLayout) -> _Prepared:
        """What all particles of a group share: the region's pictures, and the cost of the pixels around it."""
        height, width = problem.size
        costs = self.pixel_costs(crop(base), problem, layout)
        views = range(problem.num_cameras)
        elsewhere = [jnp.where(region_mask(region, c, height, width), 0.0, costs[c]).sum() for c in views]
        return _Prepared(
            tuple(region.cut(problem.labels[c], c) for c in views),
            tuple(region.cut(problem.background[c], c) for c in views),
            tuple(self._uncovered(region.cut(problem.background[c], c)) for c in views),
            jnp.stack(elsewhere),
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
        """Sum over views of the mean pixel cost. `outside (camera,)`: mesh pixels beyond the region."""
        total = jnp.zeros(())
        for camera in range(problem.num_cameras):
            keys = crop(buffers[camera])
            ids = keys & layout.id_mask
            covered = ids != layout.id_mask
            foreground = self._foreground(problem, camera, jnp.where(covered, ids, 0), prepared.labels[camera])
            cost = covered_cost(foreground, prepared.background[camera], self.epsilon)
            cost = jnp.where(covered, cost, prepared.uncovered[camera]).sum()
            total += cost + prepared.elsewhere[camera] + self.outside * outside[camera]
        return total / problem.area
