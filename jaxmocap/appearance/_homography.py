"""A robust global homography in plain NumPy: the pre-warp of the grid."""

import numpy as np
from jaxtyping import Float

TRIALS = 150
"""Four-point hypotheses tried; at 40 % outliers one is clean with probability 1 - 1e-9."""
JUDGES = 300
"""Matches that score a hypothesis, evenly spread."""
MARGIN = 20.0
"""Scale of the score in pixels. Wide: parallax against one plane is expected, and a compromise warps better."""


def apply_homography(
    homography: Float[np.ndarray, "3 3"], points: Float[np.ndarray, "point 2"]
) -> Float[np.ndarray, "point 2"]:
    """Map pixels (x, y) by a homography."""
    mapped = points @ homography[..., :2].T + homography[..., 2]
    return mapped[..., :2] / mapped[..., 2:]


def fit_homography(
    points_from: Float[np.ndarray, "point 2"],
    points_to: Float[np.ndarray, "point 2"],
    weights: Float[np.ndarray, " point"] | None = None,
) -> Float[np.ndarray, "3 3"]:
    """Fit a homography by weighted least squares (normalised direct linear transform) to four points or more."""
    weights = np.ones(len(points_from)) if weights is None else weights
    to_unit_from, to_unit_to = _normaliser(points_from), _normaliser(points_to)
    rows = linear_equations(apply_homography(to_unit_from, points_from), apply_homography(to_unit_to, points_to))
    rows = rows * np.repeat(np.sqrt(weights), 2)[:, None]
    vector = np.linalg.eigh(rows.T @ rows)[1][:, 0]
    homography = np.linalg.inv(to_unit_to) @ vector.reshape(3, 3) @ to_unit_from
    return homography / homography[2, 2]


def robust_homography(
    points_from: Float[np.ndarray, "point 2"], points_to: Float[np.ndarray, "point 2"], seed: int = 0
) -> Float[np.ndarray, "3 3"]:
    """Fit the homography that most matches follow: random four-point trials, then five reweighted least squares rounds.

    Falls back to the mean translation below four points, and to the identity with none. Deterministic for a seed.
    """
    count = len(points_from)
    if count < 4:
        shift = np.eye(3)
        if count:
            shift[:2, 2] = (points_to - points_from).mean(axis=0)
        return shift
    unit_from, unit_to = _normaliser(points_from), _normaliser(points_to)
    source, target = apply_homography(unit_from, points_from), apply_homography(unit_to, points_to)
    choice = np.random.default_rng(seed).integers(0, count, (TRIALS, 4))
    rows = linear_equations(source[choice].reshape(-1, 2), target[choice].reshape(-1, 2)).reshape(TRIALS, 8, 9)
    solvable = np.linalg.cond(rows[:, :, :8]) < 1e7
    if not solvable.any():
        return fit_homography(points_from, points_to)
    solutions = np.linalg.solve(rows[solvable][:, :, :8], -rows[solvable][:, :, 8:])[..., 0]
    trials = np.concatenate([solutions, np.ones((len(solutions), 1))], axis=1).reshape(-1, 3, 3)
    judges = np.arange(min(JUDGES, count)) * count // min(JUDGES, count)
    mapped = np.concatenate([source[judges], np.ones((len(judges), 1))], axis=1) @ trials.transpose(0, 2, 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        squared = np.sum((mapped[..., :2] / mapped[..., 2:] - target[judges]) ** 2, axis=-1) / unit_to[0, 0] ** 2
    score = (1 - MARGIN**2 / (MARGIN**2 + np.nan_to_num(squared, nan=np.inf))).sum(axis=1)
    homography = np.linalg.inv(unit_to) @ trials[np.argmin(score)] @ unit_from
    for _ in range(5):
        squared = np.sum((apply_homography(homography, points_from) - points_to) ** 2, axis=1)
        homography = fit_homography(points_from, points_to, (MARGIN**2 / (MARGIN**2 + squared)) ** 2)
    return homography / homography[2, 2]


def _normaliser(points: np.ndarray) -> Float[np.ndarray, "3 3"]:
    """Similarity that moves the points to mean zero and mean distance sqrt 2."""
    centre = points.mean(axis=0)
    scale = np.sqrt(2) / max(np.linalg.norm(points - centre, axis=1).mean(), 1e-9)
    return np.array([[scale, 0, -scale * centre[0]], [0, scale, -scale * centre[1]], [0, 0, 1.0]])


def linear_equations(source: np.ndarray, target: np.ndarray) -> Float[np.ndarray, "row 9"]:
    """Write two linear equations per match in the nine elements of the homography."""
    one, zero = np.ones((len(source), 1)), np.zeros((len(source), 3))
    homogeneous = np.concatenate([source, one], axis=1)
    horizontal = np.concatenate([homogeneous, zero, -target[:, :1] * homogeneous], axis=1)
    vertical = np.concatenate([zero, homogeneous, -target[:, 1:] * homogeneous], axis=1)
    return np.stack([horizontal, vertical], axis=1).reshape(-1, 9)
