"""View-view consistency, Eq. 7: does the other camera see the same colour at this surface point?"""

from typing import Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxmocap._types import knob
from jaxmocap.observation import FrameProblem
from jaxmocap.render import WINDOW, KeyLayout, crop, expand

from ._body import Region, region_mask
from ._model_view import TAU


def ordered_pairs(num_cameras: int) -> list[tuple[int, int]]:
    """All (m, n) with m != n: E_mn is not symmetric (ambiguity A16 of the equation, read as ordered pairs)."""
    return [(m, n) for m in range(num_cameras) for n in range(num_cameras) if m != n]


def partner_pixels(
    columns: Array, rows: Array, inverse_depth: Array, source: Float[Array, "3 4"], target: Float[Array, "3 4"]
) -> tuple[Array, Array, Array]:
    """Where a surface point seen at pixel (column, row) of the source view with this inverse depth appears in the
    target.

    Exact: inverse depth is affine over a face, so this is the ray cut with the face's plane. Returns column, row and
    the scaled depth (positive in front of the target camera).
    """
    turn = target[:, :3] @ jnp.linalg.inv(source[:, :3])
    shift = target[:, 3] - turn @ source[:, 3]
    x, y, z = (turn[k, 0] * columns + turn[k, 1] * rows + turn[k, 2] + shift[k] * inverse_depth for k in range(3))
    safe = jnp.where(z > 1e-6, z, 1.0)
    return x / safe, y / safe, z


def are_near(near_faces: Array, first: Int[Array, "..."], second: Int[Array, "..."]) -> Bool[Array, "..."]:
    """Geodesic test of Eq. 7 on the bit table; the two broadcast."""
    words = near_faces.reshape(-1)[first * near_faces.shape[1] + (second >> 5)]
    return ((words >> (second & 31).astype(jnp.uint32)) & 1) == 1


def _pack(image: Float[Array, "height width 3"]) -> Int[Array, "height width"]:
    levels = jnp.round(jnp.clip(image, 0, 1) * 255).astype(jnp.int32)
    return (levels[..., 0] << 16) | (levels[..., 1] << 8) | levels[..., 2]


def _channels(packed: Array) -> tuple[Array, Array, Array]:
    return (
        (packed >> 16).astype(jnp.float32),
        ((packed >> 8) & 255).astype(jnp.float32),
        (packed & 255).astype(jnp.float32),
    )


def _in_region(row: Array, column: Array, region: Region, camera: int) -> Array:
    top, left = region.corners[camera, 0], region.corners[camera, 1]
    return (row >= top) & (row < top + region.size[0]) & (column >= left) & (column < left + region.size[1])


def _region_index(row: Array, column: Array, region: Region, camera: int) -> Array:
    """Flat index into the region's bordered key buffer; clipped to it."""
    local_row = jnp.clip(row - region.corners[camera, 0], 0, region.size[0] - 1) + WINDOW
    local_column = jnp.clip(column - region.corners[camera, 1], 0, region.size[1] - 1) + WINDOW
    return local_row * (region.size[1] + 2 * WINDOW) + local_column


class _Far(NamedTuple):
    """Body pixels of view m outside the region whose partner in view n falls inside n's region: their test depends on
    the particle, everything else about them does not."""

    target: Int[Array, "slot"]
    face: Int[Array, "slot"]
    cost: Float[Array, "slot"]
    live: Bool[Array, "slot"]
    fixed_cost: Float[Array, ""]
    fixed_count: Float[Array, ""]
    needed: Int[Array, ""]


class _Prepared(NamedTuple):
    packed: Int[Array, "camera pixel"]
    base: Int[Array, "camera pixel"]
    own: tuple[Array, ...]
    far: tuple[_Far, ...]


class ViewView(eqx.Module):
    """Eq. 7, summed over ordered camera pairs; `weight` is lambda = 0.3 of Eq. 5.

    `step` scores every step-th pixel in both directions (1 is the paper). `sampling` of the other image: "bilinear" or
    "nearest". `fail` is the cost of a pixel whose partner is not geodesically near: "tau" (the paper) or "ignore" (left
    out of the mean). `outside` says the same of partners that leave the other rectangle. `colour_scale` divides the
    colour distance before the cap (1 is the paper). `capacity` bounds the list of body pixels outside a limb's region
    that must be scored again.
    """

    weight: Float[Array, ""] = knob(0.3)
    colour_scale: Float[Array, ""] = knob(1.0)
    step: int = eqx.field(static=True, default=1)
    sampling: Literal["bilinear", "nearest"] = eqx.field(static=True, default="bilinear")
    fail: Literal["tau", "ignore"] = eqx.field(static=True, default="tau")
    outside: Literal["tau", "ignore"] = eqx.field(static=True, default="tau")
    capacity: int = eqx.field(static=True, default=4096)

    name = "view_view"

    def _partner(
        self, keys: Array, rows: Array, columns: Array, m: int, n: int, problem: FrameProblem, layout: KeyLayout
    ):
        """Local float column and row in n's rectangle, and whether the nearest pixel lies inside it."""
        inverse = layout.inverse_depth(keys, problem.depth_range[m])
        origin, target = problem.origins[m], problem.origins[n]
        u = columns + (origin[1].astype(jnp.float32) + 0.5)
        v = rows + (origin[0].astype(jnp.float32) + 0.5)
        x, y, z = partner_pixels(u, v, inverse, problem.projection[m], problem.projection[n])
        x, y = x - (target[1].astype(jnp.float32) + 0.5), y - (target[0].astype(jnp.float32) + 0.5)
        height, width = problem.size
        inside = (z > 1e-6) & (x >= -0.5) & (y >= -0.5) & (x < width - 0.5) & (y < height - 0.5)
        return jnp.where(inside, x, 0.0), jnp.where(inside, y, 0.0), inside

    def _colour_cost(self, own: Array, packed: Array, x: Array, y: Array, width: int, height: int) -> Array:
        """min(|I_m - I_n|_2 / colour_scale, tau)."""
        red, green, blue = _channels(own)
        if self.sampling == "nearest":
            index = jnp.round(y).astype(jnp.int32) * width + jnp.round(x).astype(jnp.int32)
            other = _channels(packed[index])
        else:
            x, y = jnp.clip(x, 0.0, width - 1.001), jnp.clip(y, 0.0, height - 1.001)
            left, top = jnp.floor(x), jnp.floor(y)
            fx, fy = x - left, y - top
            index = top.astype(jnp.int32) * width + left.astype(jnp.int32)
            corners = [_channels(packed[index + shift]) for shift in (0, 1, width, width + 1)]
            other = [
                (a * (1 - fx) + b * fx) * (1 - fy) + (c * (1 - fx) + d * fx) * fy
                for a, b, c, d in zip(*corners, strict=True)
            ]
        square = (red - other[0]) ** 2 + (green - other[1]) ** 2 + (blue - other[2]) ** 2
        return jnp.minimum(jnp.sqrt(square) * (1 / 255) / self.colour_scale, TAU)

    def _pixel_cost(self, colour: Array, near: Array, inside: Array) -> tuple[Array, Array]:
        """Cost and count of one covered pixel."""
        failed = jnp.where(inside, self.fail == "tau", self.outside == "tau")
        counted = near | failed
        return jnp.where(near, colour, jnp.where(failed, TAU, 0.0)), counted.astype(jnp.float32)

    def _far(
        self, base: Array, region: Region, m: int, n: int, packed: Array, problem: FrameProblem, layout: KeyLayout
    ) -> _Far:
        height, width = problem.size
        if region.size == problem.size:
            nothing = jnp.zeros(1, jnp.int32)
            return _Far(
                nothing,
                nothing,
                jnp.zeros(1),
                jnp.zeros(1, bool),
                jnp.zeros(()),
                jnp.zeros(()),
                jnp.zeros((), jnp.int32),
            )
        keys = crop(base[m])[:: self.step, :: self.step]
        ids = layout.face(keys)
        rows, columns = jnp.meshgrid(
            jnp.arange(0, height, self.step, dtype=jnp.float32),
            jnp.arange(0, width, self.step, dtype=jnp.float32),
            indexing="ij",
        )
        x, y, inside = self._partner(keys, rows, columns, m, n, problem, layout)
        column, row = jnp.round(x).astype(jnp.int32), jnp.round(y).astype(jnp.int32)
        here = ~region_mask(region, m, height, width)[:: self.step, :: self.step] & (ids >= 0)
        there = region_mask(region, n, height, width)[row, column] & inside & here
        own = packed[m].reshape(height, width)[:: self.step, :: self.step]
        colour = self._colour_cost(own, packed[n], x, y, width, height)
        other = layout.face(crop(base[n]))[row, column]
        near = inside & (other >= 0) & are_near(problem.surface.near_faces, jnp.maximum(ids, 0), jnp.maximum(other, 0))
        cost, count = self._pixel_cost(colour, near, inside)
        fixed = here & ~there
        pick, _, needed = expand(there.reshape(-1).astype(jnp.int32), self.capacity)
        live = jnp.arange(self.capacity) < needed
        target = _region_index(row, column, region, n)
        return _Far(
            target.reshape(-1)[pick],
            jnp.maximum(ids, 0).reshape(-1)[pick],
            colour.reshape(-1)[pick],
            live,
            jnp.where(fixed, cost, 0.0).sum(),
            jnp.where(fixed, count, 0.0).sum(),
            needed,
        )

    def prepare(self, base: Array, region: Region, problem: FrameProblem, layout: KeyLayout) -> _Prepared:
        """What all particles of a group share."""
        packed = jnp.stack([_pack(problem.image[c]).reshape(-1) for c in range(problem.num_cameras)])
        shaped = packed.reshape(problem.image.shape[:3])
        own = tuple(region.cut(shaped[c], c, step=self.step) for c in range(problem.num_cameras))
        pairs = ordered_pairs(problem.num_cameras)
        flat = crop(base).reshape(problem.num_cameras, -1)
        return _Prepared(
            packed, flat, own, tuple(self._far(base, region, m, n, packed, problem, layout) for m, n in pairs)
        )

    def needed(self, prepared: _Prepared) -> Array:
        """Largest number of far pixels, to be compared with `capacity`."""
        return jnp.stack([far.needed for far in prepared.far]).max() if prepared.far else jnp.zeros((), jnp.int32)

    def score(
        self,
        prepared: _Prepared,
        buffers: Array,
        outside: Array,
        region: Region,
        problem: FrameProblem,
        layout: KeyLayout,
    ) -> Float[Array, ""]:
        """Sum over ordered pairs of the mean over the covered pixels; tau for a view without any (M2 = 0)."""
        height, width = problem.size
        near_faces = problem.surface.near_faces
        total = jnp.zeros(())
        rows = jnp.arange(0, region.size[0], self.step, dtype=jnp.float32)[:, None]
        columns = jnp.arange(0, region.size[1], self.step, dtype=jnp.float32)[None, :]
        for (m, n), far in zip(ordered_pairs(problem.num_cameras), prepared.far, strict=True):
            keys = crop(buffers[m])[:: self.step, :: self.step]
            ids = keys & layout.id_mask
            covered = ids != layout.id_mask
            corner = region.corners[m].astype(jnp.float32)
            x, y, inside = self._partner(keys, rows + corner[0], columns + corner[1], m, n, problem, layout)
            column, row = jnp.round(x).astype(jnp.int32), jnp.round(y).astype(jnp.int32)
            flat = buffers[n].reshape(-1)
            drawn = flat[_region_index(row, column, region, n)]
            if region.size != problem.size:
                elsewhere = prepared.base[n][row * width + column]
                drawn = jnp.where(_in_region(row, column, region, n), drawn, elsewhere)
            other = drawn & layout.id_mask
            first, second = jnp.where(covered, ids, 0), jnp.where(other != layout.id_mask, other, 0)
            near = inside & (other != layout.id_mask) & are_near(near_faces, first, second)
            colour = self._colour_cost(prepared.own[m], prepared.packed[n], x, y, width, height)
            cost, count = self._pixel_cost(colour, near, inside)
            cost_sum = jnp.where(covered, cost, 0.0).sum() + far.fixed_cost
            count_sum = jnp.where(covered, count, 0.0).sum() + far.fixed_count
            if region.size != problem.size:
                other = flat[far.target] & layout.id_mask
                second = jnp.where(other != layout.id_mask, other, 0)
                near = (other != layout.id_mask) & are_near(near_faces, far.face, second)
                cost, count = self._pixel_cost(far.cost, near, jnp.ones_like(near))
                cost_sum += jnp.where(far.live, cost, 0.0).sum()
                count_sum += jnp.where(far.live, count, 0.0).sum()
            total += jnp.where(count_sum > 0, cost_sum / jnp.maximum(count_sum, 1.0), TAU)
        return total
