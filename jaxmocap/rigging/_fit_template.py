"""Laying the template into a surface: Gauss-Newton on pose and proportions, nearest points with like normals.

Points of the template go to the nearest points of the surface and the other way round, where nearness counts normals
too, so that a finger is not drawn to the far side of a hand. Robust weights leave out what has no counterpart (hair, a
bag, a hole) and narrow as the fit gets better.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import trimesh
from jaxtyping import Array, Float, Int
from scipy.spatial import KDTree

from jaxmocap.character import GIRTHS, LENGTHS, ROOT_DOFS
from jaxmocap.geometry import unit_vectors, vertex_normals

from ._template import Body, joint_slopes, moved, probes, squares, surface, template

_EXACT = 0.01  # metres, standard deviation of a joint that somebody has placed
_REACH = 2.0  # of the scale of the fit: a doubted joint that is farther off counts for less


class Pin(NamedTuple):
    """Where a joint is. `information` (3, 3) is the inverse covariance of `place`, in the same units; of a `doubted`
    pin, which some detector has placed, large distances count for less and less."""

    place: Float[np.ndarray, "3"]
    information: Float[np.ndarray, "3 3"]
    doubted: bool = False

    def seen(self, matrix: Float[np.ndarray, "4 4"]) -> "Pin":
        """Move the pin by a similarity; one that is not doubted has its centimetre there."""
        linear = matrix[:3, :3]
        place = linear @ self.place + matrix[:3, 3]
        if not self.doubted:
            return exact(place)
        back = np.linalg.inv(linear)
        return Pin(place, back.T @ self.information @ back, doubted=True)


class Missed(NamedTuple):
    """How far a body's joints are from their pins: half the squares, and a quadratic in a step of the body."""

    energy: float
    hessian: Float[np.ndarray, "parameter parameter"]
    gradient: Float[np.ndarray, " parameter"]


def exact(place: Float[np.ndarray, "3"]) -> Pin:
    """Pin a joint that was placed by hand."""
    return Pin(place, np.eye(3) / _EXACT**2)


def missed(
    pins: Mapping[str, Pin],
    places: Mapping[str, Float[np.ndarray, "3"]],
    slopes: Mapping[str, Float[np.ndarray, "3 parameter"]],
    scale: float,
    size: int,
) -> Missed:
    """Sum up how far joints at `places` miss their pins, with derivatives `slopes` by a step of `size` numbers.

    `scale` is the distance in metres beyond which a pair of points is left out in the same step (Geman and McClure).
    """
    energy, hessian, gradient = 0.0, np.zeros((size, size)), np.zeros(size)
    for name, pin in pins.items():
        off, slope = places[name] - pin.place, slopes[name]
        square = float(off @ pin.information @ off)
        falling = 1.0 / (1.0 + float(off @ off) / (_REACH * scale) ** 2) if pin.doubted else 1.0
        energy += 0.5 * square * falling
        pulled = falling**2 * slope.T @ pin.information
        hessian += pulled @ slope
        gradient += pulled @ off
    return Missed(energy, hessian, gradient)


_NORMALS = 0.08  # metres that a right angle between two normals counts for, in the search of the nearest point
_ALONG = 0.3  # weight of a point's distance along the surface, beside that across it
_POINTS = 400.0  # independent measurements that all points together count for
_NOISE = 0.015  # metres
_HEIGHT, _LENGTH, _GIRTH = 0.2, 0.07, 0.15  # standard deviations of the shape's logarithms
_DAMPING = 1.0
_STIFF = 0.12  # radians, for joints that a standing person hardly bends
_LOOSE = {"shoulder_flex": 0.5, "shoulder_abd": 0.5, "shoulder_axial": 0.5, "elbow_flex": 0.5, "forearm_pron": 0.6}
_LEGS = {"hip_flex": 0.2, "hip_abd": 0.25, "hip_int": 0.25, "knee_flex": 0.2, "ankle_dorsi": 0.2, "ankle_inv": 0.15}


class Points(NamedTuple):
    """Samples of a surface: places (N, 3) in metres and outward normals (N, 3)."""

    places: Float[np.ndarray, "point 3"]
    normals: Float[np.ndarray, "point 3"]

    def keys(self) -> np.ndarray:
        """Stack places and scaled normals side by side; distances between rows tell which points belong together."""
        return np.hstack([self.places, _NORMALS * self.normals])


class Fit(NamedTuple):
    """A body laid into a surface, and its `energy` to compare fits of the same surface by."""

    body: Body
    energy: float


def fit_template(
    target: Points,
    start: Body,
    scales: Sequence[float],
    likeness: float,
    pins: Mapping[str, Pin] | None = None,
) -> Fit:
    """Lay the template into a surface of metres in the rest frame's axes, from a start that is roughly right.

    One step per entry of `scales`, the distance in metres beyond which a pair of points is left out. `likeness` is the
    standard deviation of the difference between left and right joint angles, radians. `pins` are joints whose places
    are known.
    """
    tree, centre, deviation = KDTree(target.keys()), _numbers(start), _deviations()
    alike = _symmetry() / likeness**2
    body = start
    for number, scale in enumerate([*scales, scales[-1]]):
        vertices, jacobian = surface(body)
        pairs = _pairs(vertices, target, tree, scale)
        prior = (_numbers(body) - centre) / deviation
        numbers = _numbers(body)
        apart = _apart_from(pins or {}, body, scale)
        if number == len(scales):
            energy = pairs.energy + apart.energy + 0.5 * float(prior @ prior + numbers @ alike @ numbers)
            return Fit(body, energy)
        hessian, gradient = pairs.normal_equations(jacobian)
        hessian += np.diag(1.0 / deviation**2 + _DAMPING) + alike + apart.hessian
        gradient += prior / deviation + alike @ numbers + apart.gradient
        body = moved(body, _bounded(hessian, -gradient, *_room(body)))
    raise ValueError("no scales")


def _apart_from(pins: Mapping[str, Pin], body: Body, scale: float) -> Missed:
    places, slopes = joint_slopes(body) if pins else ({}, {})
    return missed(pins, places, slopes, scale, 6 + len(body.angles) + len(body.shape))


class _Pairs(NamedTuple):
    probe: np.ndarray
    residual: np.ndarray  # (N, 3)
    normal: np.ndarray
    weight: np.ndarray
    energy: float

    def normal_equations(self, jacobian: Array) -> tuple[np.ndarray, np.ndarray]:
        """Build Hessian (58, 58) and gradient of the weighted squares, across and along the surface."""
        metric = self.weight[:, None, None] * (
            self.normal[:, :, None] * self.normal[:, None, :] + _ALONG**2 * np.eye(3)
        )
        of_probe = np.zeros((len(jacobian), 3, 3))
        np.add.at(of_probe, self.probe, metric)
        pull = np.zeros((len(jacobian), 3))
        np.add.at(pull, self.probe, np.einsum("nij,nj->ni", metric, self.residual))
        return squares(jacobian, of_probe, pull)


def _pairs(vertices: np.ndarray, target: Points, tree: KDTree, scale: float) -> _Pairs:
    normals = vertex_normals(vertices, np.asarray(template().faces))[probes()]
    own = Points(vertices[probes()], normals)
    there = np.asarray(tree.query(own.keys())[1])
    here = np.asarray(KDTree(own.keys()).query(target.keys())[1])
    probe = np.concatenate([np.arange(len(own.places)), here])
    goal = np.concatenate([target.places[there], target.places])
    normal = np.concatenate([target.normals[there], normals[here]])
    residual = own.places[probe] - goal
    like = np.concatenate([np.sum(target.normals[there] * normals, 1), np.sum(target.normals * normals[here], 1)])
    square = np.sum(residual**2, axis=1) + (_NORMALS * (1 - like)) ** 2
    share = np.concatenate([np.full(len(there), 1 / len(there)), np.full(len(here), 1 / len(here))])
    size = 0.5 * _POINTS * share / _NOISE**2
    falling = 1.0 / (1.0 + square / scale**2)
    energy = 0.5 * float(np.sum(size * square * falling))  # Geman and McClure
    return _Pairs(probe, residual, normal, size * falling**2, energy)


def _numbers(body: Body) -> np.ndarray:
    return np.concatenate([np.zeros(ROOT_DOFS), body.angles, body.shape])


@lru_cache(maxsize=1)
def _deviations() -> np.ndarray:
    """List the standard deviation of each of the 58 numbers; those of the root are free."""
    known = {f"{side}_{name}": value for side in "lr" for name, value in (_LOOSE | _LEGS).items()}
    angles = [known.get(name, _STIFF) for name in template().skeleton.angle_names]
    shape = [_HEIGHT, *(_LENGTH for _ in LENGTHS), *(_GIRTH for _ in GIRTHS)]
    return np.concatenate([np.full(ROOT_DOFS, 1e3), angles, shape])


@lru_cache(maxsize=1)
def _symmetry() -> np.ndarray:
    """Build the quadratic form that adds up squared differences between the joint angles of left and right."""
    skeleton = template().skeleton
    rows = np.zeros((skeleton.num_dofs, len(_deviations())))
    for kind in ("arm", "leg"):
        for left, right in zip(skeleton.group(f"l_{kind}"), skeleton.group(f"r_{kind}"), strict=True):
            rows[left, left], rows[left, right] = 1.0, -1.0
    return rows.T @ rows


def _room(body: Body) -> tuple[np.ndarray, np.ndarray]:
    """How far each number may go in one step: to the joint limits, and not too far at once."""
    skeleton = template().skeleton
    size = np.concatenate([np.full(3, 0.2), np.full(skeleton.num_dofs - 3, 0.35), np.full(len(body.shape), 0.15)])
    low, high = -size, size.copy()
    angles = slice(ROOT_DOFS, skeleton.num_dofs)
    low[angles] = np.maximum(low[angles], np.asarray(skeleton.lower) - body.angles)
    high[angles] = np.minimum(high[angles], np.asarray(skeleton.upper) - body.angles)
    return np.minimum(low, 0.0), np.maximum(high, 0.0)


def _bounded(hessian: np.ndarray, gradient: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Minimise a quadratic in a box, nearly: what leaves the box is set to its edge and the rest solved again."""
    step, free = np.zeros(len(gradient)), np.ones(len(gradient), bool)
    for _ in range(8):
        rest = gradient - hessian @ np.where(free, 0.0, step)
        step[free] = np.linalg.solve(hessian[np.ix_(free, free)], rest[free])
        out = free & ((step < low) | (step > high))
        step = np.clip(step, low, high)
        if not out.any():
            break
        free &= ~out
    return step


_COUNT = 4000


def samples(vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"]) -> Points:
    """Spread points evenly over the surface, in random order but always the same."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    places, face = trimesh.sample.sample_surface(mesh, _COUNT, seed=0)[:2]
    corners = vertices[faces[face]]
    share = trimesh.triangles.points_to_barycentric(corners, places)
    normals = unit_vectors(np.einsum("nc,nci->ni", share, vertex_normals(vertices, faces)[faces[face]]))
    order = np.random.default_rng(0).permutation(len(places))
    return Points(np.asarray(places, np.float64)[order], normals[order])
