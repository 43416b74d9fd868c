"""Eq. 5 on the soft rasteriser: the same terms, differentiable in poses, vertices, cameras, weights and colours."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from jaxmocap._types import Knob
from jaxmocap.character import Character, Pose, skin
from jaxmocap.observation import FrameProblem
from jaxmocap.render import SoftFaces, SoftSettings, expand, soft_faces, to_screen

from ._model_view import TAU, ModelView, covered_cost, uncovered_cost
from ._search_energy import PoseTerm, SearchEnergy
from ._view_view import ViewView, are_near, carry, ordered_pairs, partner_pixels


class SoftScore(NamedTuple):
    """`total`, `terms (term,)` unweighted, and the `needed` windows, pixels and shares of the busiest view, to be held
    against `SoftSettings`: what does not fit is left out."""

    total: Float[Array, ""]
    terms: Float[Array, "term"]
    needed: Int[Array, "3"]


def soft_score(
    energy: SearchEnergy, character: Character, pose: Pose, problem: FrameProblem, settings: SoftSettings | None = None
) -> SoftScore:
    """Eq. 5 of one pose with soft visibility, for `jax.grad` and `vmap`: the energy of the search in the limit of zero
    `settings.width`.

    Every pixel is shared by the faces that cover parts of it (`soft_faces`): in Eq. 6 each pays its share of the
    covered cost and what is left pays the uncovered cost; in Eq. 7 each looks for its own partner, and near faces count
    by their share of the partner's pixel. Raises `ValueError` for a term that only knows key buffers.
    """
    settings = SoftSettings() if settings is None else settings
    vertices = skin(character, pose)
    faces = character.faces.T
    height, width = problem.size

    def look(view: tuple[Array, Array, Array]) -> tuple[Array, SoftFaces]:
        projection, origin, depths = view
        screen = to_screen(vertices, projection, origin)
        return screen, soft_faces(screen, faces, height, width, depths, settings)

    screens, seen = lax.map(look, (problem.projection, problem.origins, problem.depth_range))
    values = []
    for term in energy.terms:
        if isinstance(term, PoseTerm):
            values.append(term.score_pose(character.skeleton, pose, problem))
        elif isinstance(term, ModelView):
            values.append(_model_view(term, seen, screens, faces, problem, settings))
        elif isinstance(term, ViewView):
            values.append(_view_view(term, seen, problem, settings))
        else:
            raise ValueError(f"the term '{term.name}' has no soft form; leave it out of the energy")
    terms = jnp.stack(values)
    weights = jnp.stack([term.weight for term in energy.terms])
    return SoftScore(terms @ weights, terms, seen.needed.max(0))


def _model_view(
    term: ModelView, seen: SoftFaces, screens: Array, faces: Array, problem: FrameProblem, settings: SoftSettings
) -> Array:
    def one(view: tuple[SoftFaces, Array, Array, Array, Array]) -> Array:
        own, screen, table, labels, background = view
        flat = jnp.maximum(own.face, 0) * table.shape[1] + labels.reshape(-1)[own.pixel][:, None]
        foreground = table.reshape(-1)[flat].astype(jnp.float32)
        behind = background.reshape(-1)
        uncovered = term.uncovered_scale * uncovered_cost(behind, term.epsilon)
        covered = covered_cost(foreground, behind[own.pixel][:, None], term.epsilon)
        gain = own.share * (covered - uncovered[own.pixel][:, None]) * own.live[:, None]
        beyond = _area_outside(screen, faces, problem.size, settings.width)
        return uncovered.sum() + gain.sum() + term.outside * beyond

    views = (seen, screens, problem.surface.colour_distance, problem.labels, problem.background)
    return lax.map(one, views).sum() / problem.area


def _area_outside(screen: Array, faces: Array, size: tuple[int, int], width: Knob) -> Array:
    """Pixels of front faces whose centre lies outside the rectangle, fading in over `width` pixels."""
    x, y, inverse = screen[0][faces], screen[1][faces], screen[2][faces]
    area = 0.5 * ((x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0]))
    cx, cy = x.mean(0), y.mean(0)
    beyond = jnp.maximum(jnp.maximum(-0.5 - cx, cx - size[1] + 0.5), jnp.maximum(-0.5 - cy, cy - size[0] + 0.5))
    share = jnp.clip(beyond / width, 0.0, 1.0)
    return jnp.where((area < 0) & (inverse.min(0) > 0), jnp.minimum(-area, 1e4) * share, 0.0).sum()


def _view_view(term: ViewView, seen: SoftFaces, problem: FrameProblem, settings: SoftSettings) -> Array:
    pairs = np.array(ordered_pairs(problem.num_cameras), np.int32).reshape(-1, 2)

    def one(pair: Array) -> Array:
        views = (seen, problem.projection, problem.origins, problem.image)
        own, other = (jax.tree.map(lambda leaf, c=camera: leaf[c], views) for camera in pair)
        return _pair(term, own, other, problem, settings)

    return lax.map(one, jnp.asarray(pairs)).sum() if len(pairs) else jnp.zeros(())


_View = tuple[SoftFaces, Float[Array, "3 4"], Int[Array, "2"], Float[Array, "height width 3"]]


def _pair(term: ViewView, own_view: _View, other_view: _View, problem: FrameProblem, settings: SoftSettings) -> Array:
    """Eq. 7 from one view to another: the mean over what is covered in the first of the colour difference."""
    own, own_projection, own_origin, own_image = own_view
    other, other_projection, other_origin, other_image = other_view
    height, width = problem.size
    on_grid = (own.pixel // width % term.step == 0) & (own.pixel % width % term.step == 0)
    use = (lax.stop_gradient(own.share) > 0) & on_grid[:, None] & (own.live > 0)[:, None]
    capacity = -(-settings.shares // term.step**2)
    pick, _, count = expand(use.reshape(-1).astype(jnp.int32), capacity)
    live = jnp.arange(capacity) < count
    entry, layer = pick // settings.layers, pick % settings.layers
    share = jnp.where(live, own.share[entry, layer], 0.0)
    pixel, face, inverse = own.pixel[entry], jnp.maximum(own.face[entry, layer], 0), own.inverse_depth[entry, layer]
    source, target = own_origin.astype(jnp.float32) + 0.5, other_origin.astype(jnp.float32) + 0.5
    u, v = (pixel % width).astype(jnp.float32) + source[1], (pixel // width).astype(jnp.float32) + source[0]
    x, y, z = partner_pixels(u, v, inverse, carry(own_projection, other_projection))
    x, y = x - target[1], y - target[0]
    inside = (z > 1e-6) & (x >= -0.5) & (y >= -0.5) & (x < width - 0.5) & (y < height - 0.5)
    x, y = jnp.where(inside, x, 0.0), jnp.where(inside, y, 0.0)

    near, colour = jnp.zeros_like(share), jnp.zeros((*share.shape, 3))
    smooth = 1.0 if term.sampling == "bilinear" else settings.width
    for row, column, part, part_of_colour in _around(x, y, settings.width, smooth):
        fits = inside & (row >= 0) & (column >= 0) & (row < height) & (column < width)
        place = jnp.clip(row, 0, height - 1) * width + jnp.clip(column, 0, width - 1)
        slot = other.slot[place]
        there = jnp.minimum(slot, settings.pixels - 1)
        faces = jnp.where((slot < settings.pixels)[:, None], other.face[there], -1)
        agree = (faces >= 0) & are_near(problem.surface.near_faces, face[:, None], jnp.maximum(faces, 0))
        near += part * jnp.where(fits, jnp.where(agree, other.share[there], 0.0).sum(1), 0.0)
        colour += part_of_colour[:, None] * other_image.reshape(-1, 3)[place]
    difference = ((own_image.reshape(-1, 3)[pixel] - colour) ** 2).sum(-1)
    distance = jnp.where(difference > 0, jnp.sqrt(jnp.where(difference > 0, difference, 1.0)), 0.0)
    cost = jnp.minimum(distance / term.colour_scale, TAU)
    failed = jnp.where(inside, float(term.fail == "tau"), float(term.outside == "tau"))
    paid = (share * (near * cost + (1.0 - near) * failed * TAU)).sum()
    counted = (share * (near + (1.0 - near) * failed)).sum()
    return jnp.where(counted > 0, paid / jnp.where(counted > 0, counted, 1.0), TAU)


def _around(x: Array, y: Array, width: Knob, width_of_colour: Knob):
    """The four pixels around a point: row, column, and weights that blend over `width` pixels (1 is bilinear, 0 the
    nearest pixel), once for what is seen and once for its colour."""
    left, top = jnp.floor(lax.stop_gradient(x)), jnp.floor(lax.stop_gradient(y))

    def blend(fraction: Array, over: float | Array) -> Array:
        return jnp.clip((fraction - 0.5) / jnp.minimum(over, 1.0) + 0.5, 0.0, 1.0)

    for down in (0, 1):
        for right in (0, 1):
            weights = []
            for over in (width, width_of_colour):
                fx, fy = blend(x - left, over), blend(y - top, over)
                weights.append((fx if right else 1 - fx) * (fy if down else 1 - fy))
            yield (top + down).astype(jnp.int32), (left + right).astype(jnp.int32), *weights
