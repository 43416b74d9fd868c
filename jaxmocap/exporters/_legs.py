"""Legs: how long they are, how low their feet reach, and how they bend to bring an ankle to a place."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from jaxmocap.character import Character
from jaxmocap.geometry import unit_vectors

STANDING = ("heel", "toe")
"""Points of a foot that stand, in contacts."""
_CORNERS = np.array(list(np.ndindex(2, 2, 2)))
_FEW = 8  # vertices of a foot that do not show how large it is
_THIN = 1e-3  # metres
_STILL = 1e-5  # metres by which an ankle moves where its leg stays as it is
_STRAIGHT = np.sin(np.radians(5.0)) ** 2  # bend of a knee below which its own axis hardly counts


class Legs(NamedTuple):
    """The legs of a body at rest, left and right; metres, x left, y up, z forward.

    Attributes:
        middle: between the hips.
        hips: from there to each hip.
        bones: the thighs, from hip to knee, and the shanks, from knee to ankle.
        feet: from the ankles to heel and toe, and to the corners of the boxes around the feet.
        headings: the turns about the vertical, from z to where the feet point.
        corners: of the boxes around the feet, least and greatest, from the ankles along the headings.
    """

    middle: Float[np.ndarray, "3"]
    hips: Float[np.ndarray, "2 3"]
    bones: Float[np.ndarray, "2 2 3"]
    feet: Float[np.ndarray, "2 10 3"]
    headings: Float[np.ndarray, "2 3 3"]
    corners: Float[np.ndarray, "2 2 3"]

    @property
    def soles(self) -> Float[np.ndarray, "2"]:
        """Height of the soles over the ankles, which is negative."""
        return self.feet[..., 1].min(axis=1)

    @property
    def length(self) -> float:
        """Height of the hips over the ground where the legs are straight."""
        return float(np.mean(np.linalg.norm(self.bones, axis=2).sum(axis=0) - self.soles))


def legs_of(character: Character) -> Legs:
    """Measure the legs of a character at rest; its feet are taken to be flat then."""
    at = lambda *names: np.array([character.skeleton.landmark(name) for name in names], np.float64)  # noqa: E731
    hips, knees, ankles = (at(f"l_{name}", f"r_{name}") for name in ("hip", "knee", "ankle"))
    feet = np.stack([at(*(f"{side}_{name}" for name in STANDING)) for side in "lr"]) - ankles[:, None]
    headings, corners = np.tile(np.eye(3), (2, 1, 1)), np.empty((2, 2, 3))
    vertices, weights = np.asarray(character.vertices, np.float64), np.asarray(character.weights)
    for number, side in enumerate("lr"):
        foot = vertices[weights[:, character.skeleton.body_names.index(f"{side}_foot")] > 0.5] - ankles[number]
        foot = feet[number] if len(foot) < _FEW else foot
        headings[number] = _heading(foot)
        along = foot @ headings[number]
        corners[:, number] = along.min(axis=0), along.max(axis=0)
    middle = hips.mean(axis=0)
    bones = np.stack([knees - hips, ankles - knees])
    boxes = corners[_CORNERS, :, np.arange(3)].transpose(2, 0, 1) @ headings.swapaxes(1, 2)
    return Legs(middle, hips - middle, bones, np.concatenate([feet, boxes], axis=1), headings, corners)


def with_feet_of(legs: Legs, other: Legs) -> Legs:
    """Take for the points of the feet those that lie in their boxes as the other's lie in theirs.

    Landmarks of two bodies may have been found in two ways; these are of the same places.
    """
    share = np.einsum("fji,fpj->fpi", other.headings, other.feet) - other.corners[0][:, None]
    share /= np.maximum(np.diff(other.corners, axis=0)[0], _THIN)[:, None]
    places = legs.corners[0][:, None] + share * np.diff(legs.corners, axis=0)[0][:, None]
    return legs._replace(feet=np.einsum("fij,fpj->fpi", legs.headings, places))


def _heading(foot: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "3 3"]:
    """Find the turn about the vertical from z to the long axis of a foot."""
    x, z = np.linalg.svd((foot - foot.mean(axis=0))[:, [0, 2]], full_matrices=False)[2][0]
    return Rotation.from_rotvec([0.0, np.arctan2(x, z) if z > 0 else np.arctan2(-x, -z), 0.0]).as_matrix()


def lowest(
    legs: Legs,
    ankles: Float[np.ndarray, "frame 2 3"],
    turns: Float[np.ndarray, "frame 2 3 3"],
    up: Float[np.ndarray, "3"],
) -> Float[np.ndarray, "frame 2"]:
    """Measure how low feet reach whose ankles are there and which turn so."""
    return ankles @ up + np.einsum("i,tfij,fpj->tfp", up, turns, legs.feet).min(axis=2)


def bent(
    hip: Float[np.ndarray, "frame 3"],
    bones: Float[np.ndarray, "2 frame 3"],
    ankle: Float[np.ndarray, "frame 3"],
    axis: Float[np.ndarray, "frame 3"],
) -> Float[np.ndarray, "2 frame 3 3"]:
    """Find how thigh and shank turn so that the leg ends at an ankle.

    The leg swings there the shortest way, then the knee bends about its own axis; `axis` stands for it where the leg
    is straight.
    """
    thigh, shank = bones
    upper, lower = (np.linalg.norm(bone, axis=1) for bone in bones)
    now, then = thigh + shank, ankle - hip
    reach = np.clip(np.linalg.norm(then, axis=1), np.abs(upper - lower) + _STILL, upper + lower)
    swing = swings(now, then)
    normal = np.cross(thigh / upper[:, None], shank / lower[:, None])
    normal = np.sum(normal * axis, axis=1, keepdims=True) * normal + _STRAIGHT * axis
    normal = np.einsum("tij,tj->ti", swing, normal)
    along = unit_vectors(then)
    ahead = unit_vectors(np.cross(along, normal))
    share = np.clip((upper**2 + reach**2 - lower**2) / (2 * upper * reach), -1.0, 1.0)
    knee = upper[:, None] * (share[:, None] * along + np.sqrt(1 - share**2)[:, None] * ahead)
    found = np.stack(
        [
            swings(np.einsum("tij,tj->ti", swing, thigh), knee) @ swing,
            swings(np.einsum("tij,tj->ti", swing, shank), reach[:, None] * along - knee) @ swing,
        ]
    )
    stays = np.linalg.norm(then - now, axis=1) < _STILL
    return np.where(stays[:, None, None], np.eye(3), found)


def swings(a: Float[np.ndarray, "*n 3"], b: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3 3"]:
    """Find the shortest turns from directions to others that are not opposite."""
    a, b = unit_vectors(a), unit_vectors(b)
    normal = np.cross(a, b)
    sine = np.linalg.norm(normal, axis=-1, keepdims=True)
    angle = np.arctan2(sine, np.sum(a * b, axis=-1, keepdims=True))
    turns = (normal * (angle / np.maximum(sine, 1e-12))).reshape(-1, 3)
    return Rotation.from_rotvec(turns).as_matrix().reshape(*a.shape, 3)
