"""What is minimised over a whole clip, and its normal equations, which join no frames farther apart than three."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.linalg import cho_solve_banded, cholesky_banded

from jaxmocap._cache import cached_jit
from jaxmocap.character import Pose, Skeleton, body_transforms, retract

BATCH = 64
"""Frames that are linearised in one call, whatever the length of the clip, so that one program serves all."""

ARM = 0.1
"""Metres from a body's joint of the three points that tell how the body is turned."""


class BodyPoints(NamedTuple):
    """Name the points by which a clip is judged: all landmarks, and three points on the axes of every body, so that a
    turn of a bone about itself counts as well.

    Attributes:
        rest: places at rest, metres.
        body: of each point the body that carries it.
        landmark: of each point the landmark whose confidence it has; the landmarks themselves come first.
    """

    rest: Float[np.ndarray, "point 3"]
    body: np.ndarray
    landmark: np.ndarray


class ClipRows(NamedTuple):
    """Weigh the rows of a clip, each the factor on a square.

    Attributes:
        told: of a point's way from where it was found, 1/m^2, by direction in the world.
        differences: coefficients of the divided difference over four frames in a row, 1/s^3.
        smooth: of a point's jerk over these frames, s^6/m^2.
        steady: of a point's way from each frame to the next, beside what it is known to be, 1/m^2, by direction.
        ways: what it is known to be, metres: nothing where a foot stands, elsewhere what optical flow sees.
        lower: how far each increment may go down, radians (the root's: metres and radians).
        upper: how far it may go up.
        wall: of an increment beyond these, 1/rad^2.
        near: of an increment, 1/rad^2 and 1/m^2: where a joint's axes fall together, turns that move nothing stay out.
    """

    told: Float[np.ndarray, "frame point 3 3"]
    differences: Float[np.ndarray, "window 4"]
    smooth: Float[np.ndarray, "window point"]
    steady: Float[np.ndarray, "interval point 3 3"]
    ways: Float[np.ndarray, "interval point 3"]
    lower: Float[np.ndarray, "frame dof"]
    upper: Float[np.ndarray, "frame dof"]
    wall: float
    near: float


class NormalEquations(NamedTuple):
    """Hold half the energy's gradient, and the blocks of its Gauss-Newton matrix: `bands[k, t]` joins the frames t and
    t + k (the last k blocks of a band are zero)."""

    gradient: Float[np.ndarray, "frame dof"]
    bands: Float[np.ndarray, "band frame dof dof"]

    def step(self, damping: float) -> Float[np.ndarray, "frame dof"]:
        """Compute the step of Levenberg and Marquardt, damped by a share of the matrix's diagonal."""
        diagonal = np.arange(self.gradient.shape[1])
        bands = self.bands.copy()
        bands[0][:, diagonal, diagonal] *= 1 + damping
        return -solve_bands(bands, self.gradient)


def body_points(skeleton: Skeleton) -> BodyPoints:
    """List the points of a skeleton by which its clips are judged."""
    landmarks, bodies = np.asarray(skeleton.landmarks, np.float32), len(skeleton.body_names)
    turned = (skeleton.joints[:, None] + ARM * np.eye(3)).reshape(-1, 3)
    number = np.repeat(np.arange(bodies), 3)
    return BodyPoints(
        np.concatenate([landmarks, turned]).astype(np.float32),
        np.concatenate([np.asarray(skeleton.landmark_bodies), number]),
        np.concatenate([np.arange(len(landmarks)), number]),
    )


def third_differences(timestamps: Float[np.ndarray, " frame"]) -> Float[np.ndarray, "window 4"]:
    """Compute the coefficients of third derivatives over four frames in a row, 1/s^3; they need not be evenly spaced.

    They are 3! times the divided differences: exact for cubic polynomials.
    """
    windows = np.lib.stride_tricks.sliding_window_view(np.asarray(timestamps, np.float64), 4)
    apart = windows[:, :, None] - windows[:, None, :]
    return 6 / np.prod(np.where(np.eye(4, dtype=bool), 1.0, apart), axis=2)


def point_places(skeleton: Skeleton, points: BodyPoints, pose: Pose) -> Float[Array, "point 3"]:
    """Compute the points' places in the world, metres."""
    transforms = body_transforms(skeleton, pose)[points.body]
    return jnp.einsum("pij,pj->pi", transforms[:, :3, :3], points.rest, precision="highest") + transforms[:, :3, 3]


def energy_at(found: Any, places: Any, increments: Any, rows: ClipRows) -> Any:
    """Add up all weighted squares where the points lie at `places`, shape (frame, point, 3), whatever the arrays are,
    NumPy's or JAX's."""
    beyond, apart, way = _outside(increments, rows), places - found, places[1:] - places[:-1] - rows.ways
    return (
        (rows.told * apart[..., None] * apart[..., None, :]).sum()
        + (rows.smooth * (_jerk(places, rows) ** 2).sum(-1)).sum()
        + (rows.steady * way[..., None] * way[..., None, :]).sum()
        + rows.wall * (beyond**2).sum()
        + rows.near * (increments**2).sum()
    )


def _jerk(places: Any, rows: ClipRows) -> Any:
    """Third divided differences over windows of four frames, from their first one: small numbers keep precision."""
    windows, first = len(places) - 3, places[:-3]
    return sum(rows.differences[:, n, None, None] * (places[n : n + windows] - first) for n in range(1, 4))


def _outside(increments: Any, rows: ClipRows) -> Any:
    """How far increments are beyond their limits, signed."""
    below, above = increments - rows.lower, increments - rows.upper
    return below * (below < 0) + above * (above > 0)


@cached_jit
def _linear(
    skeleton: Skeleton, points: BodyPoints, poses: Pose, increments: Float[Array, "frame dof"]
) -> tuple[Float[Array, "frame point 3"], Float[Array, "frame point 3 dof"]]:
    def one(pose: Pose, step: Float[Array, "dof"]) -> tuple[Array, Array]:
        def places(moved: Float[Array, "dof"]) -> Float[Array, "point 3"]:
            return point_places(skeleton, points, retract(skeleton, pose, moved))

        return places(step), jax.jacfwd(places)(step)

    return jax.vmap(one)(poses, increments)


def linearise(
    skeleton: Skeleton, points: BodyPoints, poses: Pose, increments: Float[np.ndarray, "frame dof"]
) -> tuple[Float[np.ndarray, "frame point 3"], Float[np.ndarray, "frame point 3 dof"]]:
    """Compute every frame's points and how they move with each degree of freedom."""
    places, moves = [], []
    points = BodyPoints(*(jax.device_put(leaf) for leaf in points))
    for first in range(0, len(increments), BATCH):
        chosen = np.minimum(np.arange(first, first + BATCH), len(increments) - 1)
        batch = jax.tree.map(lambda leaf, chosen=chosen: jax.device_put(np.asarray(leaf)[chosen]), poses)
        found = _linear(skeleton, points, batch, jax.device_put(increments[chosen].astype(np.float32)))
        for parts, values in zip((places, moves), found, strict=True):
            parts.append(np.asarray(values, np.float64)[: len(increments) - first])
    return np.concatenate(places), np.concatenate(moves)


def point_covariances(
    skeleton: Skeleton, points: BodyPoints, poses: Pose, hessians: Float[np.ndarray, "frame dof dof"]
) -> Float[np.ndarray, "frame point 3 3"]:
    """Compute how far the points may lie from where the poses have them, by the inverse of each J^T J (host), m^2."""
    found = []
    for first in range(0, len(hessians), BATCH):
        batch = jax.tree.map(lambda leaf, first=first: leaf[first : first + BATCH], poses)
        some = hessians[first : first + BATCH, None]
        _, moves = linearise(skeleton, points, batch, np.zeros((len(some), skeleton.num_dofs)))
        found.append(moves @ np.linalg.solve(some, moves.swapaxes(2, 3)))
    return np.concatenate(found)


def normal_equations(
    found: Float[np.ndarray, "frame point 3"],
    places: Float[np.ndarray, "frame point 3"],
    moves: Float[np.ndarray, "frame point 3 dof"],
    increments: Float[np.ndarray, "frame dof"],
    rows: ClipRows,
) -> NormalEquations:
    """Assemble the rows at these increments, at which the points lie at `places` and move by `moves` (host)."""
    frames, _, _, dofs = moves.shape
    gradient, bands = np.zeros((frames, dofs)), np.zeros((4, frames, dofs, dofs))

    def join(first: int, last: int, weighted: Float[np.ndarray, "row point 3 dof"]) -> None:
        here = moves[first : first + len(weighted)].reshape(len(weighted), -1, dofs)
        bands[last - first, first : first + len(weighted)] += here.swapaxes(1, 2) @ weighted.reshape(here.shape)

    def pull(first: int, rest: Float[np.ndarray, "row point 3"]) -> None:
        here = moves[first : first + len(rest)].reshape(len(rest), -1, dofs)
        gradient[first : first + len(rest)] += (rest.reshape(len(rest), 1, -1) @ here)[:, 0]

    join(0, 0, rows.told @ moves)
    pull(0, (rows.told @ (places - found)[..., None])[..., 0])
    jerk = _jerk(places, rows)
    for first in range(4):
        pull(first, (rows.differences[:, first, None] * rows.smooth)[..., None] * jerk)
        for last in range(first, 4):
            weights = (rows.differences[:, first] * rows.differences[:, last])[:, None] * rows.smooth
            join(first, last, weights[..., None, None] * moves[last : last + len(weights)])
    way = (rows.steady @ (places[1:] - places[:-1] - rows.ways)[..., None])[..., 0]
    pull(0, -way)
    pull(1, way)
    for first, last, sign in ((0, 0, 1), (1, 1, 1), (0, 1, -1)):
        join(first, last, sign * rows.steady @ moves[last : last + len(way)])
    outside = _outside(increments, rows)
    gradient += rows.wall * outside + rows.near * increments
    bands[0][:, np.arange(dofs), np.arange(dofs)] += rows.wall * (outside != 0) + rows.near
    return NormalEquations(gradient, bands)


def solve_bands(
    bands: Float[np.ndarray, "band frame dof dof"], right: Float[np.ndarray, "frame dof"]
) -> Float[np.ndarray, "frame dof"]:
    """Solve a block-banded symmetric positive definite system by Cholesky factors, in double precision (host)."""
    width, frames, size, _ = bands.shape
    stored = np.zeros((width * size, frames * size))  # of column c the rows c, c + 1, ...: LAPACK's lower form
    row, column = np.indices((size, size))
    for band in range(width):
        for d, e in zip(row.ravel(), column.ravel(), strict=True):
            below = band * size + e - d  # how far the entry (t, d) x (t + band, e) lies below the diagonal
            if below >= 0:
                stored[below, d : d + (frames - band) * size : size] += bands[band, : frames - band, d, e]
    stored[0] += 1e-9 * stored[0].max()
    return cho_solve_banded((cholesky_banded(stored, lower=True), True), right.ravel()).reshape(frames, size)
