"""Model-view consistency, Eq. 6: does a pixel look like the face that covers it, or like the background?"""

from typing import ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxmocap._types import Knob, knob
from jaxmocap.appearance import TAU
from jaxmocap.observation import Clusters, FrameProblem
from jaxmocap.render import WINDOW, KeyLayout, SoftFaces, block_sums, corner, crop, look_up, sum_over_blocks

from ._body import GroupProblem
from ._term import AbstractTerm, Drawn, SoftDrawn


def covered_cost(foreground: Array, background: Array, epsilon: float | Array = 1e-3) -> Array:
    """Compute psi_f / (psi_b + psi_f), `epsilon` in numerator and twice in the denominator against 0/0 (camouflage)."""
    return (foreground + epsilon) / (foreground + background + 2 * epsilon)


def uncovered_cost(background: Array, epsilon: float | Array = 1e-3) -> Array:
    """Compute psi_b / (psi_b + tau): in [0, 0.5] as printed."""
    return (background + epsilon) / (background + TAU + 2 * epsilon)


class ModelView(AbstractTerm):
    """Eq. 6, summed over the views (the first sum of Eq. 5).

    Attributes:
        weight: of the term; 1, as printed.
        epsilon: what keeps the quotients of Eq. 6 finite, in units of psi; 0.001.
        uncovered_scale: of the cost of uncovered pixels: 1 is the printed equation; 2 makes both sides symmetric; more
            trusts the background more than the surface's colours, which pays where it is a clean plate.
        outside: cost of a mesh pixel that leaves the rectangle but not the picture: 1 keeps a pose from hiding there, 0
            is the printed equation.
        shading: "palette" looks psi_f up in a table of palette colours; "exact"
            compares every covered pixel with the Gaussians of its face, which is much slower.
    """

    weight: Knob = knob(1.0)
    epsilon: Knob = knob(1e-3)
    uncovered_scale: Knob = knob(1.0)
    outside: Knob = knob(1.0)
    shading: Literal["palette", "exact"] = eqx.field(static=True, default="palette")

    name: ClassVar[str] = "model_view"

    def _uncovered(self, background: Array) -> Array:
        return self.uncovered_scale * uncovered_cost(background, self.epsilon)

    def _covered(
        self, problem: FrameProblem, camera: Array, ids: Array, labels: Array, image: Array, behind: Array
    ) -> Array:
        """Compute the cost of pixels that these faces cover; `camera` says of which view."""
        if self.shading == "exact":
            foreground = _clusters(problem).distance(camera, ids, image)
        else:
            table = problem.surface.colour_distance
            index = (camera * table.shape[1] + ids) * table.shape[2] + labels
            foreground = look_up(table.reshape(-1), index).astype(jnp.float32)
        return covered_cost(foreground, behind, self.epsilon)

    def pixel_costs(self, keys: Int[Array, "camera height width"], problem: FrameProblem, layout: KeyLayout) -> Array:
        """Compute the cost of every pixel of the rectangle (camera, height, width), before the average."""
        ids, cameras = layout.face(keys), jnp.arange(problem.num_cameras, dtype=jnp.int32)[:, None, None]
        pictures = problem.labels, problem.image, problem.background
        covered = self._covered(problem, cameras, jnp.maximum(ids, 0), *pictures)
        return jnp.where(ids >= 0, covered, self._uncovered(problem.background))

    def prepare(self, base: Array, group: GroupProblem) -> Float[Array, "camera block_down block_across"]:
        """Sum the costs of all blocks while the part is not drawn."""
        return block_sums(self.pixel_costs(crop(base), group.frame, group.layout))

    def score(self, prepared: Array, drawn: Drawn, group: GroupProblem) -> Float[Array, ""]:
        """Sum over views of the mean pixel cost; only blocks that the particle changes are scored anew."""
        frame, layout = group.frame, group.layout

        def view(camera: Array) -> Array:
            def cost(row: Array, column: Array, block: tuple[int, int]) -> Array:
                def cut(values: Array, border: int = 0) -> Array:
                    start = corner(camera, border + row, border + column, 0)[: values.ndim]
                    return jax.lax.dynamic_slice(values, start, (1, *block, *values.shape[3:]))[0]

                keys, behind = cut(drawn.buffers, WINDOW), cut(frame.background)
                covered = keys > layout.empty
                face = jnp.where(covered, keys & layout.id_mask, 0)
                seen = self._covered(frame, camera, face, cut(frame.labels), cut(frame.image), behind)
                return jnp.where(covered, seen, self._uncovered(behind))

            if drawn.driver == "scatter":  # to list the blocks gains nothing there
                return cost(jnp.int32(0), jnp.int32(0), frame.size).sum()
            return sum_over_blocks(drawn.dirty[camera], frame.size, prepared[camera], cost)

        cost = jax.lax.map(view, jnp.arange(frame.num_cameras, dtype=jnp.int32))
        return (cost.sum() + self.outside * drawn.outside.sum()) / frame.area

    def soft(self, drawn: SoftDrawn) -> Float[Array, ""]:
        """Let each face pay its share of a pixel's covered cost; what is left pays the uncovered cost."""
        frame, faces = drawn.frame, drawn.character.faces.T

        def view(view: tuple[SoftFaces, Array, Array, Array, Array, Array]) -> Array:
            own, screen, table, labels, background, room = view
            flat = jnp.maximum(own.face, 0) * table.shape[1] + labels.reshape(-1)[own.pixel][:, None]
            foreground = table.reshape(-1)[flat].astype(jnp.float32)
            behind = background.reshape(-1)
            uncovered = self._uncovered(behind)
            covered = covered_cost(foreground, behind[own.pixel][:, None], self.epsilon)
            gain = own.share * (covered - uncovered[own.pixel][:, None]) * own.live[:, None]
            beyond = _area_outside(screen, faces, frame.size, room, drawn.settings.width)
            return uncovered.sum() + gain.sum() + self.outside * beyond

        views = (drawn.seen, drawn.screens, frame.surface.colour_distance, frame.labels, frame.background, frame.room)
        return jax.lax.map(view, views).sum() / frame.area


def _clusters(problem: FrameProblem) -> Clusters:
    if problem.surface.clusters is None:
        raise ValueError('shading="exact" needs the colour models; a simplified or uncoloured mesh has none')
    return problem.surface.clusters


def _area_outside(screen: Array, faces: Array, size: tuple[int, int], room: Array, width: Knob) -> Array:
    """Pixels of front faces whose centre lies outside the rectangle but inside the picture, fading in over `width`
    pixels and out again before the picture's border."""
    x, y, inverse = screen[0][faces], screen[1][faces], screen[2][faces]
    area = 0.5 * ((x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0]))
    cx, cy = x.mean(0), y.mean(0)
    beyond = jnp.maximum(jnp.maximum(-0.5 - cx, cx - size[1] + 0.5), jnp.maximum(-0.5 - cy, cy - size[0] + 0.5))
    top, left, bottom, right = room - 0.5
    within = jnp.minimum(jnp.minimum(cx - left, right - cx), jnp.minimum(cy - top, bottom - cy))
    share = jnp.clip(jnp.minimum(beyond, within) / width, 0.0, 1.0)
    return jnp.where((area < 0) & (inverse.min(0) > 0), jnp.minimum(-area, 1e4) * share, 0.0).sum()
