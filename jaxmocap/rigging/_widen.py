"""Wider blends of weights in those folds that would turn inside out at the limits of a joint."""

from collections.abc import Callable, Mapping

import numpy as np
import robust_laplacian
from jaxtyping import Float, Int
from scipy import sparse
from scipy.sparse.linalg import splu

from jaxmocap.character import Skeleton

from ._turned_out import RangeOfMotion
from ._weights import fewest, unwrung

_ROUNDS = 10
_WIDTH = 0.04  # metres by which a round blurs the weights, and at least by the length of an edge
_AROUND = 0.02  # metres around a triangle that turned out, in which it does
_FINE = 0.01
_ENOUGH = 0.001  # share of triangles that may turn out without more ado


def widened(
    vertices: Float[np.ndarray, "vertex 3"],
    faces: Int[np.ndarray, "face 3"],
    weights: Float[np.ndarray, "vertex bone"],
    places: Mapping[str, np.ndarray],
    skeleton: Skeleton,
) -> Float[np.ndarray, "vertex bone"]:
    """Skinning weights blurred around the triangles that turn inside out at a joint's limits; metres, rest frame.

    Bone heat blends two bones over a width that depends on how near they are, not on how far they may turn. Each round
    blurs more where it is still needed; the round is taken in which the worst limit turns the fewest triangles, and of
    equals the one that turns the fewest over all limits. Elsewhere the weights stay as they are.
    """
    limits = RangeOfMotion.of(skeleton)
    edge = float(np.linalg.norm(vertices[faces[:, 1]] - vertices[faces[:, 0]], axis=1).mean())
    wide, near = (_blur(vertices, faces, width) for width in (max(_WIDTH, edge), _AROUND))
    best, least = weights, (np.inf, np.inf)
    for number in range(_ROUNDS + 1):
        turned = limits.turned(vertices, faces, weights)
        score = (float(turned.mean(axis=1).max()), float(turned.mean()))
        if score < least:
            best, least = weights, score
        if least[0] <= _ENOUGH or number == _ROUNDS:
            break
        folded = np.zeros((len(vertices), 1))
        folded[faces[turned.any(axis=0)]] = 1.0
        share = np.clip(2.0 * near(folded), 0.0, 1.0)
        weights = fewest(unwrung(weights + share * (wide(weights) - weights), vertices, places))
    return best


def evened(
    vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"], weights: Float[np.ndarray, "vertex bone"]
) -> Float[np.ndarray, "vertex bone"]:
    """Weights that were carried over from another mesh, without the steps between what came from here and there."""
    return fewest(_blur(vertices, faces, _FINE)(weights))


def _blur(vertices: np.ndarray, faces: np.ndarray, width: float) -> Callable[[np.ndarray], np.ndarray]:
    """Spreading of values over the surface as heat spreads, by a Gaussian of this width in metres whatever the size of
    the triangles: one implicit step, `(M + width^2 / 2 L) x = M x_0`."""
    stiffness, mass = robust_laplacian.mesh_laplacian(vertices, faces.astype(np.int64))
    solve = splu((mass + 0.5 * width**2 * stiffness).tocsc()).solve
    area = sparse.diags(mass.diagonal())
    return lambda values: np.clip(solve(area @ values), 0.0, 1.0)
