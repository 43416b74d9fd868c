"""Model-view consistency, Eq. 6: does a pixel look like the face that covers it, or like the background?"""

from typing import ClassVar, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxmocap._types import Knob, knob
from jaxmocap.observation import Clusters, FrameProblem
from jaxmocap.render import WINDOW, KeyLayout, SoftFaces, covered_tiles, crop, look_up, sum_over_tiles, tiles_at

from ._body import GroupProblem, region_mask
from ._term import AbstractTerm, Drawn, SoftDrawn

TAU = 1.0
"""The barrier of Eq. 3 for colours in [0, 1]."""


def covered_cost(foreground: Array, background: Array, epsilon: float | Array = 1e-3) -> Array:
    """Compute psi_f / (psi_b + psi_f), `epsilon` in numerator and twice in the denominator against 0/0 (camouflage)."""
    return (foreground + epsilon) / (foreground + background + 2 * epsilon)


def uncovered_cost(background: Array, epsilon: float | Array = 1e-3) -> Array:
    """Compute psi_b / (psi_b + tau): in [0, 0.5] as printed."""
    return (background + epsilon) / (background + TAU + 2 * epsilon)


class _Prepared(NamedTuple):
    labels: Int[Array, "camera height width"]
    background: Float[Array, "camera height width"]
    uncovered: Float[Array, "camera height width"]
    elsewhere: Float[Array, "camera"]


class ModelView(AbstractTerm):
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

    name: ClassVar[str] = "model_view"

    def _uncovered(self, background: Array) -> Array:
        return self.uncovered_scale * uncovered_cost(background, self.epsilon)

    def _foreground(self, problem: FrameProblem, ids: Array, labels: Array) -> Array:
        """psi_f of every pixel (camera, height, width), for ids that are not negative."""
        table = problem.surface.colour_distance
        cameras, faces, colours = table.shape
        rows = faces * jnp.arange(cameras, dtype=jnp.int32)[:, None, None] + ids
        return look_up(table.reshape(-1), rows * colours + labels).astype(jnp.float32)

    def pixel_costs(self, keys: Int[Array, "camera height width"], problem: FrameProblem, layout: KeyLayout) -> Array:
        """Compute the cost of every pixel of the rectangle (camera, height, width), before the average."""
        ids = layout.face(keys)
        if self.shading == "exact":
            cameras = jnp.arange(problem.num_cameras)[:, None, None]
            foreground = _clusters(problem).distance(cameras, jnp.maximum(ids, 0), problem.image)
        else:
            foreground = self._foreground(problem, jnp.maximum(ids, 0), problem.labels)
        covered = covered_cost(foreground, problem.background, self.epsilon)
        return jnp.where(ids >= 0, covered, self._uncovered(problem.background))

    def prepare(self, base: Array, group: GroupProblem) -> _Prepared:
        """Cut out the region's pictures, and sum the cost of the pixels around it."""
        frame, region = group.frame, group.region
        costs = self.pixel_costs(crop(base), frame, group.layout)
        views = range(frame.num_cameras)
        elsewhere = [jnp.where(region_mask(region, c, *frame.size), 0.0, costs[c]).sum() for c in views]
        background = jnp.stack([region.cut(frame.background[c], c) for c in views])
        return _Prepared(
            jnp.stack([region.cut(frame.labels[c], c) for c in views]),
            background,
            self._uncovered(background),
            jnp.stack(elsewhere),
        )

    def score(self, prepared: _Prepared, drawn: Drawn, group: GroupProblem) -> Float[Array, ""]:
        """Sum over views of the mean pixel cost."""
        frame, layout, buffers = group.frame, group.layout, drawn.buffers
        if self.shading == "exact":
            cost = jax.lax.map(
                lambda camera: self._exact(camera, prepared, buffers[camera], group), jnp.arange(frame.num_cameras)
            )
        else:
            keys = crop(buffers)
            covered = keys > layout.empty
            foreground = self._foreground(frame, jnp.where(covered, keys & layout.id_mask, 0), prepared.labels)
            cost = jnp.where(covered, covered_cost(foreground, prepared.background, self.epsilon), prepared.uncovered)
        return (cost.sum() + prepared.elsewhere.sum() + self.outside * drawn.outside.sum()) / frame.area

    def _exact(self, camera: Array, prepared: _Prepared, buffer: Array, group: GroupProblem) -> Float[Array, ""]:
        """Sum the pixel costs of one view's region, covered tiles by the Gaussians themselves."""
        frame, region, layout = group.frame, group.region, group.layout
        clusters, width = _clusters(frame), region.size[1]
        background = prepared.background[camera].reshape(-1)

        def cost(rows: Array, columns: Array) -> Array:
            keys = look_up(buffer.reshape(-1), (rows + WINDOW) * buffer.shape[1] + columns + WINDOW)
            covered = (keys > layout.empty) & (rows < region.size[0]) & (columns < width)
            row, column = jnp.where(covered, rows, 0), jnp.where(covered, columns, 0)
            top, left = region.corners[camera]
            colour = frame.image[camera, top + row, left + column]
            foreground = clusters.distance(camera, jnp.where(covered, keys & layout.id_mask, 0), colour)
            behind = look_up(background, row * width + column)
            return jnp.where(covered, covered_cost(foreground, behind, self.epsilon), -1.0)

        total, _ = sum_over_tiles(tiles_at(covered_tiles(buffer, layout)), cost)
        return total + jnp.where(crop(buffer) > layout.empty, 0.0, prepared.uncovered[camera]).sum()

    def soft(self, drawn: SoftDrawn) -> Float[Array, ""]:
        """Let each face pay its share of a pixel's covered cost; what is left pays the uncovered cost."""
        frame, faces = drawn.frame, drawn.character.faces.T

        def view(view: tuple[SoftFaces, Array, Array, Array, Array]) -> Array:
            own, screen, table, labels, background = view
            flat = jnp.maximum(own.face, 0) * table.shape[1] + labels.reshape(-1)[own.pixel][:, None]
            foreground = table.reshape(-1)[flat].astype(jnp.float32)
            behind = background.reshape(-1)
            uncovered = self._uncovered(behind)
            covered = covered_cost(foreground, behind[own.pixel][:, None], self.epsilon)
            gain = own.share * (covered - uncovered[own.pixel][:, None]) * own.live[:, None]
            beyond = _area_outside(screen, faces, frame.size, drawn.settings.width)
            return uncovered.sum() + gain.sum() + self.outside * beyond

        views = (drawn.seen, drawn.screens, frame.surface.colour_distance, frame.labels, frame.background)
        return jax.lax.map(view, views).sum() / frame.area


def _clusters(problem: FrameProblem) -> Clusters:
    if problem.surface.clusters is None:
        raise ValueError('shading="exact" needs the colour models; a simplified or uncoloured mesh has none')
    return problem.surface.clusters


def _area_outside(screen: Array, faces: Array, size: tuple[int, int], width: Knob) -> Array:
    """Pixels of front faces whose centre lies outside the rectangle, fading in over `width` pixels."""
    x, y, inverse = screen[0][faces], screen[1][faces], screen[2][faces]
    area = 0.5 * ((x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0]))
    cx, cy = x.mean(0), y.mean(0)
    beyond = jnp.maximum(jnp.maximum(-0.5 - cx, cx - size[1] + 0.5), jnp.maximum(-0.5 - cy, cy - size[0] + 0.5))
    share = jnp.clip(beyond / width, 0.0, 1.0)
    return jnp.where((area < 0) & (inverse.min(0) > 0), jnp.minimum(-area, 1e4) * share, 0.0).sum()
