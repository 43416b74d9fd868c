"""Skeleton embedding: where the joints of a standing person are in a bare surface.

The paper's authors rig with Pinocchio (Baran and Popovic 2007), which packs spheres into any creature and searches for
a skeleton among them. We know that it is a person: a procedural body with pose and proportions is laid into the surface
from many starts, bent to it, and its joints are read off. That needs neither a watertight mesh nor a known front.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.spatial import KDTree

from jaxmocap.character import BODIES
from jaxmocap.geometry import uniform_laplacian, vertex_normals

from ._fit_template import Fit, Pin, Points, fit_template
from ._orientation import Guess, guesses
from ._read_mesh import upright
from ._template import Body, landmarks, surface, template

_STARTS = 8
_COARSE, _FINE = (0.3,) * 4 + (0.15,) * 4, (0.12,) * 3 + (0.08,) * 5 + (0.05,) * 6
_ALIKE, _UNLIKE = 0.05, 0.4  # radians between left and right, first and last
_SAMPLES = 700, 1500
_NEAR = 0.06  # metres at the template's height

# Skinned characters turn their hips further back and their necks higher than bones do; metres at the template's height.
_OFFSETS = {"l_hip": (0.006, 0.0, -0.02), "r_hip": (-0.006, 0.0, -0.02), "neck": (0.0, 0.02, 0.0)}


class Embedding(NamedTuple):
    """A person found in a surface.

    Attributes:
        fit_from_file: a similarity to about x = left, y up, z forward and the template's height.
        places: joints and landmarks in that frame.
        laid: the template's skin, bent to the surface, in that frame.
        distance: median distance from the body's skin to the surface, metres at the template's height.
        covered: of every body the share of its skin that lies near the surface.
        front_margin: by how much facing the other way fits worse.
    """

    fit_from_file: Float[np.ndarray, "4 4"]
    places: dict[str, np.ndarray]
    laid: Float[np.ndarray, "skin 3"]
    distance: float
    covered: dict[str, float]
    front_margin: float

    def uncovered(self, least: float) -> list[str]:
        """Name the bodies of whose skin less than this share lies near the surface."""
        return [body for body, share in self.covered.items() if share < least]


def embed(
    points: Points,
    up: Float[np.ndarray, "3"] | None = None,
    front: Float[np.ndarray, "3"] | None = None,
    pins: Mapping[str, Pin] | None = None,
) -> Embedding | None:
    """Find the person in shuffled samples of a surface (any units and axes); None if nothing looks like one at all.

    `up` and `front`, in the file's axes, leave out ways to see it that disagree. `pins` are joints whose places in the
    file are known.
    """
    starts = _different(guesses(points, up, front))[:_STARTS]
    if not starts:
        return None

    def lay(guess: Guess, start: Body, count: int, scales: tuple[float, ...], likeness: float) -> Fit:
        known = {name: pin.seen(guess.rest_from_file) for name, pin in (pins or {}).items()}
        return fit_template(_seen(points, guess, count), start, scales, likeness, known)

    fits = [lay(guess, guess.start, _SAMPLES[0], _COARSE, _ALIKE) for guess in starts]
    best = min(range(len(fits)), key=lambda number: fits[number].energy)
    guess = starts[best]
    fit = lay(guess, fits[best].body, _SAMPLES[1], _FINE, _UNLIKE)
    every = _seen(points, guess, len(points.places))
    places, laid = bent_landmarks(every, fit.body)
    for name, offset in _OFFSETS.items():
        places[name] = places[name] + fit.body.root[:3, :3] @ np.array(offset)
    places |= _more_places(places, laid)
    distance, covered = _apart(fit.body, every)
    return Embedding(
        guess.rest_from_file,
        places,
        laid,
        distance,
        covered,
        _front_margin(starts, fits, best),
    )


def _different(found: list[Guess]) -> list[Guess]:
    """One of those guesses that turn the surface nearly alike and start with the same arms."""
    kept: list[Guess] = []
    for guess in found:
        same = (
            np.trace(_rotation(guess) @ _rotation(other).T) > 1 + 2 * np.cos(np.radians(15.0))
            and np.allclose(guess.start.angles, other.start.angles)
            for other in kept
        )
        if not any(same):
            kept.append(guess)
    return kept


def _rotation(guess: Guess) -> np.ndarray:
    turn = guess.rest_from_file[:3, :3]
    return turn / np.cbrt(np.linalg.det(turn))


def _seen(points: Points, guess: Guess, count: int) -> Points:
    matrix = guess.rest_from_file
    places = points.places[:count] @ matrix[:3, :3].T + matrix[:3, 3]
    return Points(places, points.normals[:count] @ _rotation(guess).T)


def _more_places(places: dict[str, np.ndarray], laid: np.ndarray) -> dict[str, np.ndarray]:
    """Place the ends of bones that the skeleton has no landmark for."""
    weights, names = np.asarray(template().weights), [body for body, _, _ in BODIES]
    more = {}
    for side in "lr":
        hand = laid[weights[:, names.index(f"{side}_hand")] > 0.6]
        tip = hand[np.argmax(np.linalg.norm(hand - places[f"{side}_wrist"], axis=1))]
        more[f"{side}_fingertip"] = places[f"{side}_wrist"] + 0.85 * (tip - places[f"{side}_wrist"])
        chest = 0.5 * (places["thorax"] + places["neck"])
        more[f"{side}_rib"] = chest + 0.55 * (places[f"{side}_shoulder"] - chest) * np.array([1.0, 0.0, 1.0])
    skull = laid[weights[:, names.index("head")] > 0.6]
    top = skull[np.argmax(skull[:, 1])]
    more["head_top"] = places["head"] + 0.7 * (top - places["head"])
    return more


def _apart(body: Body, target: Points) -> tuple[float, dict[str, float]]:
    """Measure how far the body's skin is from the surface.

    Returns the median distance, unlike normals counted in, and the share of each part's skin that lies near the
    surface.
    """
    vertices, _ = surface(body)
    normals = vertex_normals(vertices, np.asarray(template().faces))
    apart, _ = KDTree(target.keys()).query(Points(vertices, normals).keys())
    owner = np.asarray(template().weights).argmax(axis=1)
    near = {name: float(np.mean(apart[owner == number] < _NEAR)) for number, (name, _, _) in enumerate(BODIES)}
    return float(np.median(apart)), near


def _front_margin(starts: list[Guess], fits: list[Fit], best: int) -> float:
    """By what share the energy is larger for the best fit that faces elsewhere; infinite where none was tried."""
    forward = _rotation(starts[best])[2]
    others = [
        fit.energy for guess, fit in zip(starts, fits, strict=True) if _rotation(guess)[2] @ forward < np.cos(0.8)
    ]
    return min(others, default=np.inf) / fits[best].energy - 1.0


_ROUNDS = 6
_STIFFNESS = 40.0
_CUT = 0.04  # metres
_ALONG = 0.05
_REACH = 0.07  # metres around a joint whose surface tells where it is


def bent_landmarks(target: Points, body: Body) -> tuple[dict[str, np.ndarray], Float[np.ndarray, "vertex 3"]]:
    """Bend the body's surface to the target; return the joints and landmarks after that, and the bent surface.

    Displacements are as smooth over the template as the points allow. A joint moves by the mean displacement of the
    skin around it, so that it stays in the middle of its limb.
    """
    vertices, _ = surface(body)
    faces = np.asarray(template().faces)
    smooth = uniform_laplacian(faces, len(vertices))
    energy = smooth.transpose() @ smooth
    tree = KDTree(target.keys())
    offset = np.zeros_like(vertices)
    for _ in range(_ROUNDS):
        now = vertices + offset
        normals = vertex_normals(now, faces)
        _, nearest = tree.query(Points(now, normals).keys())
        there = target.normals[nearest]
        off = target.places[nearest] - now
        across = there * np.sum(there * off, axis=1, keepdims=True)
        goal = offset + across + _ALONG * (off - across)
        weight = np.where(np.sum(normals * there, axis=1) > 0.5, 1.0, 0.0)
        weight /= (1.0 + np.sum(off**2, axis=1) / _CUT**2) ** 2
        system = sparse.diags_array(weight + 1e-3) + _STIFFNESS * energy
        offset = splu(system.tocsc()).solve(weight[:, None] * goal)
    places = landmarks(body)
    moved = {}
    for name, place in places.items():
        near = np.exp(-0.5 * np.sum((vertices - place) ** 2, axis=1) / _REACH**2)
        moved[name] = place + near @ offset / max(near.sum(), 1e-9)
    return moved, vertices + offset


class Placed(NamedTuple):
    """Everything in one frame: the mesh, the joints, the template's skin, and how one gets there from the file."""

    vertices: np.ndarray
    places: dict[str, np.ndarray]
    laid: np.ndarray
    rest_from_file: np.ndarray

    def scaled(self, factor: float) -> "Placed":
        """Scale everything."""
        matrix = np.diag([factor, factor, factor, 1.0]) @ self.rest_from_file
        places = {name: factor * place for name, place in self.places.items()}
        return Placed(factor * self.vertices, places, factor * self.laid, matrix)


def in_rest_frame(vertices: np.ndarray, found: Embedding, pins: Mapping[str, np.ndarray]) -> Placed:
    """Turn a mesh upright, soles at height 0 and the pelvis above the origin; still in the file's units."""
    back = np.linalg.inv(found.fit_from_file)
    to_file = lambda points: points @ back[:3, :3].T + back[:3, 3]  # noqa: E731
    places = {name: to_file(place) for name, place in found.places.items()} | dict(pins)
    turn = upright(places)
    turned = vertices @ turn.T
    pelvis = turn @ places["pelvis"]
    shift = -np.array([pelvis[0], turned[:, 1].min(), pelvis[2]])
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn, shift
    moved = {name: turn @ place + shift for name, place in places.items()}
    return Placed(turned + shift, moved, to_file(found.laid) @ turn.T + shift, matrix)
