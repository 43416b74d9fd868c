"""Contour correspondences of sec. 4.2: points of the projected contour and the image edges they belong to."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxmocap._cache import cached_jit
from jaxmocap._types import Knob, knob
from jaxmocap.observation import FrameProblem
from jaxmocap.render import listed

from ._lines import SurfaceLines, surface_lines

COLOUR_SCALE = 0.3
"""Distance of colours, of full scale, that counts as the most."""


class ContourSettings(eqx.Module):
    """How contour points look for their edge. The paper says only "close enough" with "best consistent colour and
    orientation"; the numbers are ours.

    Attributes:
        reach: pixels along the normal, either way, in which an edge is looked for; compiled in.
        step: every so many contour pixels one is taken; 2.
        capacity: contour pixels per view at most; of more, as many count, at even distances.
        inside: edge pixels are the outermost ones of a mask, which belong to the outermost ones of the drawn mesh;
            False.
        accept_score: 0.4 distance + 0.3 orientation + 0.3 colour below which an edge is accepted; 0.5.
        accept_cosine: of the angle between the edge's gradient and the normal, at least; 0.85.
        within: pixels beyond which no edge counts: like `reach`, but free to change without compiling.
    """

    reach: int = eqx.field(static=True, default=15)
    step: int = eqx.field(static=True, default=2)
    capacity: int = eqx.field(static=True, default=2048)
    inside: bool = eqx.field(static=True, default=False)
    accept_score: Knob = knob(0.5)
    accept_cosine: Knob = knob(0.85)
    within: Knob = knob(1e3)


class ContourPoints(NamedTuple):
    """Contour pixels of one view: face, row and column in the rectangle, inward unit normal (dx, dy)."""

    face: Int[Array, "slot"]
    row: Int[Array, "slot"]
    column: Int[Array, "slot"]
    normal: Float[Array, "slot 2"]
    live: Bool[Array, "slot"]


def _blur(values: Array) -> Array:
    for axis in (0, 1):
        for _ in range(3):
            padded = jnp.pad(values, [(1, 1) if a == axis else (0, 0) for a in (0, 1)], mode="edge")
            a, b, c = (jax.lax.slice_in_dim(padded, k, k + values.shape[axis], axis=axis) for k in range(3))
            values = 0.25 * a + 0.5 * b + 0.25 * c
    return values


def _shift(values: Array, rows: int, columns: int, fill: float) -> Array:
    padded = jnp.pad(values, 1, constant_values=fill)
    return padded[1 + rows : 1 + rows + values.shape[0], 1 + columns : 1 + columns + values.shape[1]]


def contour_points(
    ids: Int[Array, "height width"], inverse_depth: Float[Array, "height width"], settings: ContourSettings
) -> ContourPoints:
    """Sample boundary pixels of the drawn mesh, with the inward normal from the blurred inverse depth."""
    height, width = ids.shape
    covered = ids >= 0
    boundary = jnp.zeros_like(covered)
    for rows, columns in ((0, 1), (1, 0), (0, -1), (-1, 0)):
        boundary |= covered & ~_shift(covered, rows, columns, True)
    inner = jnp.zeros((height, width), bool).at[2:-2, 2:-2].set(True)
    row, column = jnp.arange(height)[:, None], jnp.arange(width)[None, :]
    chosen = boundary & inner & ((row + column) % settings.step == 0)
    pick, count = listed(chosen.reshape(-1), settings.capacity)
    smooth = _blur(jnp.where(covered, inverse_depth, 0.0))
    gx = 0.5 * (_shift(smooth, 0, 1, 0.0) - _shift(smooth, 0, -1, 0.0)).reshape(-1)[pick]
    gy = 0.5 * (_shift(smooth, 1, 0, 0.0) - _shift(smooth, -1, 0, 0.0)).reshape(-1)[pick]
    normal = jnp.stack([gx, gy], -1)
    normal /= jnp.maximum(jnp.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    live = jnp.arange(settings.capacity) < count
    return ContourPoints(ids.reshape(-1)[pick], pick // width, pick % width, normal, live)


def edge_targets(
    points: ContourPoints,
    edge_mask: Bool[Array, "height width"],
    edge_gradient: Float[Array, "height width 2"],
    image: Float[Array, "height width 3"],
    model_colour: Float[Array, "slot 3"],
    model_known: Bool[Array, "slot"],
    settings: ContourSettings,
) -> tuple[Float[Array, "slot 2"], Bool[Array, "slot"]]:
    """Find the best edge pixel (column, row) in the rectangle for every contour point, and whether one was accepted.

    Candidates lie within `reach` pixels along the normal and within 25 degrees of it. Score = 0.4 distance + 0.3
    orientation + 0.3 colour on the inner side.
    """
    height, width = edge_mask.shape
    turn = jnp.deg2rad(jnp.array([-25.0, 0.0, 25.0]))
    offsets = jnp.arange(-settings.reach, settings.reach + 1, dtype=jnp.float32)
    nx, ny = points.normal[:, 0], points.normal[:, 1]
    dx = nx[:, None] * jnp.cos(turn) - ny[:, None] * jnp.sin(turn)
    dy = nx[:, None] * jnp.sin(turn) + ny[:, None] * jnp.cos(turn)
    x = jnp.round(points.column[:, None, None] + dx[..., None] * offsets).astype(jnp.int32)
    y = jnp.round(points.row[:, None, None] + dy[..., None] * offsets).astype(jnp.int32)
    inside = (x >= 2) & (y >= 2) & (x < width - 2) & (y < height - 2)
    x, y = jnp.clip(x, 0, width - 1), jnp.clip(y, 0, height - 1)
    gradient = edge_gradient[y, x]
    cosine = jnp.abs(gradient[..., 0] * nx[:, None, None] + gradient[..., 1] * ny[:, None, None])
    inner_x = jnp.clip(jnp.round(x + 2 * nx[:, None, None]).astype(jnp.int32), 0, width - 1)
    inner_y = jnp.clip(jnp.round(y + 2 * ny[:, None, None]).astype(jnp.int32), 0, height - 1)
    colour = jnp.linalg.norm(image[inner_y, inner_x] - model_colour[:, None, None, :], axis=-1) / COLOUR_SCALE
    colour = jnp.where(model_known[:, None, None], jnp.minimum(colour, 1.0), 0.5)
    far = jnp.minimum(settings.within, settings.reach)
    score = 0.4 * jnp.abs(offsets) / far + 0.3 * (1 - cosine) + 0.3 * colour
    usable = edge_mask[y, x] & inside & (cosine > settings.accept_cosine) & (jnp.abs(offsets) <= far)
    score = jnp.where(usable, score, jnp.inf).reshape(len(nx), -1)
    best = jnp.argmin(score, axis=1)
    accepted = (jnp.take_along_axis(score, best[:, None], 1)[:, 0] < settings.accept_score) & points.live

    def at_best(values: Array) -> Array:
        return jnp.take_along_axis(values.reshape(len(nx), -1), best[:, None], 1)[:, 0].astype(jnp.float32)

    return jnp.stack([at_best(x), at_best(y)], -1), accepted


@cached_jit
def contour_lines(
    vertices: Float[Array, "vertex 3"],
    faces: Int[Array, "face 3"],
    ids: Int[Array, "camera height width"],
    inverse_depth: Float[Array, "camera height width"],
    problem: FrameProblem,
    settings: ContourSettings,
) -> SurfaceLines:
    """Build rows of Eq. 9 for the current rendering of the pose: contour points of every view tied to their edges."""

    def view(camera: Array) -> SurfaceLines:
        points = contour_points(ids[camera], inverse_depth[camera], settings)
        face = jnp.maximum(points.face, 0)
        targets, accepted = edge_targets(
            points,
            problem.edges.mask[camera],
            problem.edges.gradient[camera],
            problem.image[camera],
            problem.surface.mean_colour[camera, face],
            problem.surface.has_colour[camera, face],
            settings,
        )
        here = jnp.stack([points.column, points.row], -1).astype(jnp.float32)
        if not settings.inside:  # the silhouette's edge lies half a pixel outside the outermost covered pixel's centre
            here = here - 0.5 * points.normal
        corner = problem.origins[camera, ::-1].astype(jnp.float32) + 0.5
        return surface_lines(
            vertices,
            faces,
            jnp.where(points.live, points.face, -1),
            here + corner,
            targets + corner,
            accepted.astype(jnp.float32),
            (problem.intrinsics[camera], problem.cam_from_world[camera]),
        )

    # One view after the other in a loop: it compiles once, however many there are.
    lines = jax.lax.map(view, jnp.arange(problem.num_cameras))
    return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), lines)
