"""Model-view consistency, Eq. 6: does a pixel look like the face that covers it, or like the background?"""

from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxmocap._types import Knob, knob
from jaxmocap.observation import Clusters, FrameProblem
from jaxmocap.render import WINDOW, KeyLayout, covered_marks, crop, look_up, sum_over_tiles, tiles_at

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
    labels: Int[Array, "camera height width"]
    background: Float[Array, "camera height width"]
    uncovered: Float[Array, "camera height width"]
    elsewhere: Float[Array, "camera"]


class ModelView(eqx.Module):
    """Eq. 6, summed over the views (the first sum of Eq. 5).

    `uncovered_scale` 1 is the printed equation; 2 makes both sides symmetric; more trusts the background more than the
    surface's colours, which pays where it is a clean plate. `outside` is the cost of a mesh pixel that leaves the
    rectangle: 1 keeps a pose from hiding there, 0 is the printed equation. With `shading` "palette" psi_f is looked up
    in a table of palette colours (`palette_error` says what that costs), with "exact" every covered pixel is compared
    with the Gaussians of its face, which is much slower.
    """

    weight: Knob = knob(1.0)
    epsilon: Knob = knob(1e-3)
    uncovered_scale: Knob = knob(1.0)
    outside: Knob = knob(1.0)
    shading: Literal["palette", "exact"] = eqx.field(static=True, default="palette")

    name = "model_view"

    def _uncovered(self, background: Array) -> Array:
        return self.uncovered_scale * uncovered_cost(background, self.epsilon)

    def _foreground(self, problem: FrameProblem, ids: Array, labels: Array) -> Array:
        """psi_f of every pixel (camera, height, width), for ids that are not negative."""
        table = problem.surface.colour_distance
        cameras, faces, colours = table.shape
        rows = faces * jnp.arange(cameras, dtype=jnp.int32)[:, None, None] + ids
        return look_up(table.reshape(-1), rows * colours + labels).astype(jnp.float32)

    def pixel_costs(self, keys: Int[Array, "camera height width"], problem: FrameProblem, layout: KeyLayout) -> Array:
        """Cost of every pixel of the rectangle (camera, height, width), before the average."""
        ids = layout.face(keys)
        if self.shading == "exact":
            cameras = jnp.arange(problem.num_cameras)[:, None, None]
            foreground = _clusters(problem).distance(cameras, jnp.maximum(ids, 0), problem.image)
        else:
            foreground = self._foreground(problem, jnp.maximum(ids, 0), problem.labels)
        covered = covered_cost(foreground, problem.background, self.epsilon)
        return jnp.where(ids >= 0, covered, self._uncovered(problem.background))

    def prepare(self, base: Array, region: Region, problem: FrameProblem, layout: KeyLayout) -> _Prepared:
        """What all particles of a group share: the region's pictures, and the cost of the pixels around it."""
        height, width = problem.size
        costs = self.pixel_costs(crop(base), problem, layout)
        views = range(problem.num_cameras)
        elsewhere = [jnp.where(region_mask(region, c, height, width), 0.0, costs[c]).sum() for c in views]
        background = jnp.stack([region.cut(problem.background[c], c) for c in views])
        return _Prepared(
            jnp.stack([region.cut(problem.labels[c], c) for c in views]),
            background,
            self._uncovered(background),
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
        if self.shading == "exact":
            cost = jax.lax.map(
                lambda camera: self._exact(camera, prepared, buffers[camera], region, problem, layout),
                jnp.arange(problem.num_cameras),
            )
            return (cost.sum() + prepared.elsewhere.sum() + self.outside * outside.sum()) / problem.area
        keys = crop(buffers)
        covered = keys > layout.empty
        foreground = self._foreground(problem, jnp.where(covered, keys & layout.id_mask, 0), prepared.labels)
        cost = jnp.where(covered, covered_cost(foreground, prepared.background, self.epsilon), prepared.uncovered)
        return (cost.sum() + prepared.elsewhere.sum() + self.outside * outside.sum()) / problem.area

    def _exact(
        self,
        camera: Array,
        prepared: _Prepared,
        buffer: Array,
        region: Region,
        problem: FrameProblem,
        layout: KeyLayout,
    ) -> Float[Array, ""]:
        """Sum of the pixel costs of one view's region, covered tiles by the Gaussians themselves."""
        clusters, width = _clusters(problem), region.size[1]
        background = prepared.background[camera].reshape(-1)

        def cost(rows: Array, columns: Array) -> Array:
            keys = look_up(buffer.reshape(-1), (rows + WINDOW) * buffer.shape[1] + columns + WINDOW)
            covered = (keys > layout.empty) & (rows < region.size[0]) & (columns < width)
            row, column = jnp.where(covered, rows, 0), jnp.where(covered, columns, 0)
            top, left = region.corners[camera]
            colour = problem.image[camera, top + row, left + column]
            foreground = clusters.distance(camera, jnp.where(covered, keys & layout.id_mask, 0), colour)
            behind = look_up(background, row * width + column)
            return jnp.where(covered, covered_cost(foreground, behind, self.epsilon), -1.0)

        total, _ = sum_over_tiles(tiles_at(covered_marks(buffer, layout)), cost)
        return total + jnp.where(crop(buffer) > layout.empty, 0.0, prepared.uncovered[camera]).sum()


def _clusters(problem: FrameProblem) -> Clusters:
    if problem.surface.clusters is None:
        raise ValueError('shading="exact" needs the colour models; a simplified or uncoloured mesh has none')
    return problem.surface.clusters
