"""View-view consistency, Eq. 7: does the other camera see the same colour at this surface point?"""

from functools import partial
from typing import ClassVar, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxmocap._results import InputError
from jaxmocap._types import Knob, knob
from jaxmocap.appearance import TAU
from jaxmocap.render import WINDOW, look_up, sum_over_tiles, tiles_at

from ._body import GroupProblem
from ._soft_view_view import SoftView, soft_view_view
from ._term import AbstractTerm, Drawn, SoftDrawn
from ._view_pair import PixelTransfer, are_near, ordered_pairs, partner_in_rectangle, pixel_transfer


def _pack(image: Float[Array, "*shape 3"]) -> Int[Array, "*shape"]:
    levels = jnp.round(jnp.clip(image, 0, 1) * 255).astype(jnp.int32)
    return (levels[..., 0] << 16) | (levels[..., 1] << 8) | levels[..., 2]


def _channels(packed: Array) -> tuple[Array, Array, Array]:
    return (
        (packed >> 16).astype(jnp.float32),
        ((packed >> 8) & 255).astype(jnp.float32),
        (packed & 255).astype(jnp.float32),
    )


def _counted_up(dirty: Bool[Array, "camera down across"]) -> Float[Array, "camera below right"]:
    """How many dirty tiles are above and left of each corner of the tiles: a summed area table."""
    down, across = (jnp.tril(jnp.ones((extent + 1, extent), jnp.float32), -1) for extent in dirty.shape[1:])
    return jnp.einsum("id,cda,ja->cij", down, dirty.astype(jnp.float32), across, precision="highest")


def _any_within(
    table: Float[Array, "below right"], first: Int[Array, "2 down across"], end: Int[Array, "2 down across"]
) -> Bool[Array, "down across"]:
    """Whether a rectangle of tiles, from `first` to before `end`, holds any dirty one."""
    width, flat = table.shape[1], table.reshape(-1)
    corners = [look_up(flat, row * width + column) for row in (first[0], end[0]) for column in (first[1], end[1])]
    return corners[3] - corners[2] - corners[1] + corners[0] > 0


def _meets(group: GroupProblem, face: Array, key: Array) -> Array:
    """Whether the face and the one with this key are geodesically near; False where the key is empty."""
    other, drawn = key & group.layout.id_mask, key > group.layout.empty
    return drawn & are_near(group.frame.surface.near_faces, face, jnp.where(drawn, other, 0))


class _Known(NamedTuple):
    """Of view m's tiles while the part is not drawn: cost and number of the pixels that count, and the box of view n's
    tiles in which their partners are, from its `first` row and column to before its `end`. Cost and number hold for as
    long as no key changes in the tile or in that box."""

    cost: Float[Array, "*pair down across"]
    count: Float[Array, "*pair down across"]
    first: Int[Array, "*pair 2 down across"]
    end: Int[Array, "*pair 2 down across"]


class _Places(NamedTuple):
    """What a pixel of view m needs of what is stored: its own colour, its `face` (-1: it is not covered), where in the
    key buffers its partner is `drawn`, and the `corner` of the colours about the partner with its fractions."""

    own: Int[Array, "lane"]
    face: Int[Array, "lane"]
    inside: Bool[Array, "lane"]
    drawn: Int[Array, "lane"]
    corner: Int[Array, "lane"]
    across: Float[Array, "lane"]
    along: Float[Array, "lane"]


class _Prepared(NamedTuple):
    pairs: Int[Array, "pair 2"]
    between: PixelTransfer
    packed: Int[Array, "camera pixel"]
    own: Int[Array, "camera padded_height padded_width"]
    known: _Known | None


class ViewView(AbstractTerm):
    """Eq. 7, summed over ordered camera pairs.

    Attributes:
        weight: lambda of Eq. 5; 0.3, the paper's.
        step: every so many pixels, in both directions, one is scored: 1 (the paper), 2, 4 or 8.
        sampling: of the other image, "bilinear" or "nearest".
        fail: cost of a pixel whose partner is not geodesically near, "tau" (the paper) or "ignore" (left out of the
            mean).
        outside: the same of partners that leave the other rectangle.
    """

    weight: Knob = knob(0.3)
    step: int = eqx.field(static=True, default=1)
    sampling: Literal["bilinear", "nearest"] = eqx.field(static=True, default="bilinear")
    fail: Literal["tau", "ignore"] = eqx.field(static=True, default="tau")
    outside: Literal["tau", "ignore"] = eqx.field(static=True, default="tau")

    name: ClassVar[str] = "view_view"

    def __check_init__(self) -> None:
        if self.step not in (1, 2, 4, 8):
            raise InputError(f"view-view consistency scores every step-th pixel, 1, 2, 4 or 8, not {self.step}.")

    def _corner(self, first: int | Array, x: Array, y: Array, width: int, height: int) -> tuple[Array, Array, Array]:
        """Where in the packed colours the pixel above and left of (x, y) lies, and the fractions across and along; the
        view's colours start at `first`."""
        if self.sampling == "nearest":
            index = first + jnp.round(y).astype(jnp.int32) * width + jnp.round(x).astype(jnp.int32)
            return index, jnp.zeros_like(x), jnp.zeros_like(y)
        x, y = jnp.clip(x, 0.0, width - 1.001), jnp.clip(y, 0.0, height - 1.001)
        left, top = jnp.floor(x), jnp.floor(y)
        return first + top.astype(jnp.int32) * width + left.astype(jnp.int32), x - left, y - top

    def _colour_cost(self, own: Array, packed: Array, corner: Array, fx: Array, fy: Array, width: int) -> Array:
        """min(|I_m - I_n|_2, tau) at a `_corner` of the other view's `packed` colours."""
        red, green, blue = _channels(own)
        if self.sampling == "nearest":
            other = _channels(look_up(packed, corner))
        else:
            corners = [_channels(look_up(packed, corner + shift)) for shift in (0, 1, width, width + 1)]
            other = [
                (a * (1 - fx) + b * fx) * (1 - fy) + (c * (1 - fx) + d * fx) * fy
                for a, b, c, d in zip(*corners, strict=True)
            ]
        square = (red - other[0]) ** 2 + (green - other[1]) ** 2 + (blue - other[2]) ** 2
        return jnp.minimum(jnp.sqrt(square) * (1 / 255), TAU)

    def _pixel_cost(self, colour: Array, near: Array, inside: Array, covered: Array) -> Array:
        """Cost of a pixel; -1 where it does not count."""
        failed = jnp.where(inside, self.fail == "tau", self.outside == "tau")
        return jnp.where(covered, jnp.where(near, colour, jnp.where(failed, TAU, -1.0)), -1.0)

    def prepare(self, base: Array, group: GroupProblem) -> _Prepared:
        frame, packed = group.frame, _pack(group.frame.image)
        own = jnp.pad(packed, ((0, 0), (WINDOW, WINDOW), (WINDOW, WINDOW)))
        pairs = jnp.asarray(ordered_pairs(frame.num_cameras), jnp.int32).reshape(-1, 2)
        between = jax.vmap(lambda pair: pixel_transfer(frame.projection[pair[0]], frame.projection[pair[1]]))(pairs)
        bare = _Prepared(pairs, between, packed.reshape(frame.num_cameras, -1), own, None)
        return bare._replace(
            known=lax.map(lambda way: self._known(way[0], way[1], bare, base, group), (pairs, between))
        )

    def _known(self, pair: Array, between: PixelTransfer, bare: _Prepared, base: Array, group: GroupProblem) -> _Known:
        """For one pair."""
        (m, n), (_, padded_height, padded_width) = pair, base.shape
        down, across = (-(-extent // WINDOW) for extent in group.frame.size)
        side = WINDOW // self.step
        lanes = [
            (WINDOW * jnp.arange(tiles)[:, None] + self.step * jnp.arange(side)).reshape(-1) for tiles in (down, across)
        ]
        rows, columns = (grid.reshape(-1) for grid in jnp.meshgrid(*lanes, indexing="ij"))
        places = self._places(between, base, group, m, n, rows, columns)
        cost = self._tile_cost(bare, base, group, *lax.optimization_barrier(places))
        met = (places.face >= 0) & places.inside
        drawn = jnp.maximum(places.drawn - n * (padded_height * padded_width), 0)
        partner = jnp.stack([drawn // padded_width, drawn % padded_width]) - WINDOW

        def of_tiles(values: Array) -> Array:
            return values.reshape(*values.shape[:-1], down, side, across, side)

        beyond = max(down, across) * WINDOW
        near = of_tiles(jnp.where(met, partner, beyond)).min((-3, -1)) - 1  # another program may round otherwise
        far = of_tiles(jnp.where(met, partner, -2)).max((-3, -1)) + 1
        first, end = jnp.maximum(near, 0) // WINDOW, far // WINDOW + 1
        most = jnp.array([down, across], jnp.int32)[:, None, None]
        first, end = jnp.minimum(first, most), jnp.minimum(end, most)
        counted = cost >= 0
        return _Known(
            of_tiles(jnp.where(counted, cost, 0.0)).sum((-3, -1)),
            of_tiles(counted.astype(jnp.float32)).sum((-3, -1)),
            jnp.where(first < end, first, 0),
            jnp.where(first < end, end, 0),
        )

    def score(self, prepared: _Prepared, drawn: Drawn, group: GroupProblem) -> Float[Array, ""]:
        """Sum over ordered pairs the mean over the covered pixels; tau for a view without any (M2 = 0).

        Only pixels whose key, or whose partner's key, is in a tile that the particle changes are scored anew.
        """
        buffers, dirty = drawn.buffers, drawn.dirty
        changes = _counted_up(dirty)

        def mean(pair: tuple[Array, PixelTransfer, _Known]) -> Array:
            (m, n), between, known = pair
            place = partial(self._places, between, buffers, group, m, n)
            seen = partial(self._tile_cost, prepared, buffers, group)
            anew = dirty[m] | _any_within(changes[n], known.first, known.end)
            cost, count = sum_over_tiles(tiles_at(anew), seen, self.step, place, drawn.driver)
            cost += jnp.where(anew, 0.0, known.cost).sum()
            count += jnp.where(anew, 0.0, known.count).sum()
            return jnp.where(count > 0, cost / jnp.maximum(count, 1.0), TAU)

        return lax.map(mean, (prepared.pairs, prepared.between, prepared.known)).sum()

    def _places(
        self,
        between: PixelTransfer,
        buffers: Array,
        group: GroupProblem,
        m: Array,
        n: Array,
        rows: Array,
        columns: Array,
    ) -> _Places:
        """Where pixels of view m appear in view n."""
        layout, (height, width), (_, padded_height, padded_width) = group.layout, group.frame.size, buffers.shape

        def in_buffers(view: Array, row: Array, column: Array) -> Array:
            return view * (padded_height * padded_width) + (row + WINDOW) * padded_width + column + WINDOW

        own = in_buffers(m, rows, columns)
        keys = look_up(buffers.reshape(-1), own)
        covered = (keys > layout.empty) & (rows < height) & (columns < width)
        inverse = layout.inverse_depth(keys, group.frame.depth_range[m])
        x, y, inside = partner_in_rectangle(group.frame, between, inverse, rows, columns, m, n)
        column, row = jnp.round(x).astype(jnp.int32), jnp.round(y).astype(jnp.int32)
        drawn = in_buffers(n, row, column)
        corner, across, along = self._corner(n * (height * width), x, y, width, height)
        face = jnp.where(covered, keys & layout.id_mask, -1)
        return _Places(own, face, inside, drawn, corner, across, along)

    def _tile_cost(self, prepared: _Prepared, buffers: Array, group: GroupProblem, *places: Array) -> Array:
        """Cost of pixels at their places; negative where a pixel does not count."""
        at = _Places(*places)
        near = at.inside & _meets(group, jnp.maximum(at.face, 0), look_up(buffers.reshape(-1), at.drawn))
        own, (_, width) = look_up(prepared.own.reshape(-1), at.own), group.frame.size
        colour = self._colour_cost(own, prepared.packed.reshape(-1), at.corner, at.across, at.along, width)
        return self._pixel_cost(colour, near, at.inside, at.face >= 0)

    def soft(self, drawn: SoftDrawn) -> Float[Array, ""]:
        """Let each face that shares a pixel look for its own partner.

        Near faces count by their share of the partner's pixel.
        """
        how = SoftView(self.step, self.sampling, self.fail, self.outside)
        return soft_view_view(drawn, how)
