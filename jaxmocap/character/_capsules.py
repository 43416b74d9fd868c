"""The body as capsules: one per bone, for whoever asks what touches what."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxmocap.geometry import face_areas

from ._character import Character

_CENTRE = {"pelvis": ("l_hip", "r_hip"), "abdomen": ("spine", "thorax"), "chest": ("thorax", "neck")}
_SIDE = {
    "clavicle": ("clavicle", "shoulder"),
    "upper_arm": ("shoulder", "elbow"),
    "forearm": ("elbow", "wrist"),
    "thigh": ("hip", "knee"),
    "shank": ("knee", "ankle"),
}
_ALONG = {"head": ("neck", "head"), "hand": ("elbow", "wrist"), "foot": ("heel", "toe")}
"""Bodies at whose end is no joint: which way they point."""
_INNER = 0.1  # of the bone's length that is left out at both ends, where the skin belongs to the joint


class Capsules(NamedTuple):
    """A segment and a radius around it per body, in the order of `skeleton.body_names`; rest frame, metres."""

    starts: Float[np.ndarray, "bone 3"]
    ends: Float[np.ndarray, "bone 3"]
    radii: Float[np.ndarray, " bone"]


def capsules(character: Character) -> Capsules:
    """Measure collision radii (host): per body the median distance, over the area of skin it dominates, to its bone.

    Half of a limb's skin lies within its radius, whatever folds a sleeve has. The bone goes from joint to joint; head,
    hands and feet, which end without one, have theirs in the middle of their skin, as long as it is. A body that
    dominates no skin has radius 0; one whose ends the skeleton does not name is a sphere about its joint. Nothing is
    stored: whatever changes the mesh or the proportions changes the radii.
    """
    vertices = np.asarray(character.vertices, np.float64)
    owner, area = np.asarray(character.weights).argmax(axis=1), _areas(vertices, np.asarray(character.faces))
    skeleton = character.skeleton
    joints = skeleton.joints.astype(np.float64)
    starts, ends, radii = joints.copy(), joints.copy(), np.zeros(len(joints))
    for number, body in enumerate(skeleton.body_names):
        side, part = (body[:2], body[2:]) if body[:2] in ("l_", "r_") else ("", body)
        pair = _ALONG.get(part) or (_SIDE if side else _CENTRE).get(part, ())
        pair = [_sided(name, side) for name in pair if _sided(name, side) in skeleton.landmark_names]
        skin, size = vertices[owner == number], area[owner == number]
        if len(skin) and len(pair) < 2:
            radii[number] = _radius(skin, size, joints[number], joints[number])
        elif len(skin):
            a, b = (np.asarray(skeleton.landmark(name), np.float64) for name in pair)
            capsule = _around(skin, size, b - a) if part in _ALONG else (a, b, _radius(skin, size, a, b))
            starts[number], ends[number], radii[number] = capsule
    return Capsules(starts, ends, radii)


def _sided(name: str, side: str) -> str:
    return name if name in ("neck", "head") else side + name


def _areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Assign to each vertex a third of the area of the faces around it, square metres."""
    return np.bincount(faces.ravel(), np.repeat(face_areas(vertices, faces) / 3, 3), len(vertices))


def _radius(skin: np.ndarray, size: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    length = float(np.linalg.norm(b - a))
    along = (skin - a) @ (b - a) / max(length, 1e-9) ** 2
    beside = (along > _INNER) & (along < 1 - _INNER)
    if not beside.any():
        beside[:] = True
    off = skin[beside] - a - np.clip(along[beside], 0, 1)[:, None] * (b - a)
    return _median(np.linalg.norm(off, axis=1), size[beside])


def _around(skin: np.ndarray, size: np.ndarray, way: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Fit the capsule along a direction that reaches from one end of the skin to the other."""
    way = way / max(float(np.linalg.norm(way)), 1e-9)
    centre = (size / max(size.sum(), 1e-12)) @ skin
    along = (skin - centre) @ way
    low, high = float(along.min()), float(along.max())
    radius = _radius(skin, size, centre + low * way, centre + high * way)
    inset = min(radius, 0.5 * (high - low))
    return centre + (low + inset) * way, centre + (high - inset) * way, radius


def _median(values: np.ndarray, size: np.ndarray) -> float:
    order = np.argsort(values)
    total = np.cumsum(size[order])
    return float(values[order][np.searchsorted(total, 0.5 * total[-1])])
