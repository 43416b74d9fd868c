"""Which way a standing person in a mesh faces: rotations to try, and how like a person each looks."""

import itertools
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from jaxmocap.geometry import vertex_normals

from ._fit_template import Points
from ._template import Body, body_at_rest, rest_angles_of, surface, template

ARMS = tuple(np.radians((45.0, 10.0, -25.0)))  # added to the template's arms, which hang 45 degrees: T, A, relaxed
HEIGHT = 1.75  # of the template; surfaces are scaled to it for fitting
_SAMPLES = 700


class Guess(NamedTuple):
    """A way to see a person in the surface: `rest_from_file` (4, 4), with the scale to the template's height, a body to
    start fitting from, and how far surface and body are apart, metres."""

    rest_from_file: Float[np.ndarray, "4 4"]
    start: Body
    distance: float


def guesses(
    points: Points, up: Float[np.ndarray, "3"] | None = None, front: Float[np.ndarray, "3"] | None = None
) -> list[Guess]:
    """Guess rotations that make a person of a surface (in any units), the likeliest first.

    Tried are the right-handed frames along the surface's principal axes and those along the file's axes; `up` and
    `front` (unit vectors in the file's axes) leave only those that agree with them within 45 degrees, and if both are
    given, add their own.
    """
    few = Points(points.places[:_SAMPLES], points.normals[:_SAMPLES])
    bodies = [body_at_rest(np.eye(4))._replace(angles=rest_angles_of(arms)) for arms in ARMS]
    stances = [_stance(body) for body in bodies]
    found = []
    for turn in (*_given_frame(up, front), *_frames(points.places)):
        if any(given is not None and turn[row] @ given < 0.7 for row, given in ((1, up), (2, front))):
            continue
        turned = Points(few.places @ turn.T, few.normals @ turn.T)
        low, high = turned.places.min(axis=0), turned.places.max(axis=0)
        scale = HEIGHT / max(high[1] - low[1], 1e-12)
        if scale * (high - low)[[0, 2]].max() > 1.4 * HEIGHT:
            continue  # lying on its side
        middle = np.median(turned.places, axis=0)
        shift = -scale * np.array([middle[0], low[1], middle[2]])
        placed = Points(scale * turned.places + shift, turned.normals)
        for body, stance in zip(bodies, stances, strict=True):
            off = 0.5 * (_distance(placed, stance) + _distance(stance, placed))
            matrix = np.eye(4)
            matrix[:3, :3], matrix[:3, 3] = scale * turn, shift
            found.append(Guess(matrix, body, off))
    return sorted(found, key=lambda guess: guess.distance)


def _stance(body: Body) -> Points:
    vertices, _ = surface(body)
    normals = vertex_normals(vertices, np.asarray(template().faces))
    middle = np.median(vertices, axis=0)
    return Points((vertices - [middle[0], vertices[:, 1].min(), middle[2]])[::4], normals[::4])


def _distance(a: Points, b: Points) -> float:
    """How far points of `a` are from `b` in the mean, each at most 30 cm."""
    apart, _ = KDTree(b.keys()).query(a.keys())
    return float(np.minimum(apart, 0.3).mean())


def _given_frame(up: np.ndarray | None, front: np.ndarray | None) -> list[np.ndarray]:
    """Build the rotation whose rows are left, up and front, if both are given and not along one line."""
    if up is None or front is None or abs(up @ front) > 0.7:
        return []
    forward = front - (front @ up) * up
    forward /= np.linalg.norm(forward)
    return [np.stack([np.cross(up, forward), up, forward])]


def _frames(places: np.ndarray) -> list[np.ndarray]:
    """Rotations whose rows are left, up and front along principal axes, and along the file's axes."""
    centred = places - places.mean(axis=0)
    _, principal = np.linalg.eigh(centred.T @ centred)
    frames = []
    for axes in (np.eye(3), principal.T):
        for order in itertools.permutations(range(3)):
            for signs in itertools.product((1.0, -1.0), repeat=3):
                turn = np.diag(signs) @ axes[list(order)]
                if np.linalg.det(turn) > 0:
                    frames.append(turn)
    return frames
