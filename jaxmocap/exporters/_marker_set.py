"""Virtual markers: the joints and landmarks, and points of the skin where laboratories stick theirs."""

import re
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxmocap.character import Character, capsules, dominant_bodies, stature
from jaxmocap.motion import Motion

from ._neutral_body import NeutralBody, neutral_body

_UP, _DOWN, _FORWARD, _BACK = (0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)
_LATERAL, _MEDIAL = (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)
_NOWHERE = (0.0, 0.0, 0.0)
_STATURE = 1.75
"""The height in metres that the offsets are for."""
_FARTHEST = 0.25
"""Metres, at that height, from inside a body to its skin."""


class _Point(NamedTuple):
    """Where a marker sticks on the left side, or in the middle: on the skin of a body, as seen from inside.

    Attributes:
        body: that carries it.
        start: a landmark.
        end: another one.
        share: of the way from one to the other at which we look.
        way: in which we look, in the neutral body: x left, y up, z forward.
        offset: of where we stand, metres.
    """

    body: str
    start: str
    end: str
    share: float
    way: tuple[float, float, float]
    offset: tuple[float, float, float] = _NOWHERE


_CENTRE = {
    "C7": _Point("chest", "neck", "neck", 0, _BACK),
    "T10": _Point("chest", "thorax", "neck", 0.25, _BACK),
    "CLAV": _Point("chest", "l_clavicle", "r_clavicle", 0.5, _FORWARD),
    "STRN": _Point("chest", "thorax", "neck", 0.35, _FORWARD),
    "RBAK": _Point("chest", "thorax", "r_shoulder", 0.6, _BACK),
}
_SIDE = {
    "FHD": _Point("head", "head", "head", 0, (0.55, 0.0, 0.84), (0.0, 0.1, 0.0)),
    "BHD": _Point("head", "head", "head", 0, (0.55, 0.0, -0.84), (0.0, 0.1, 0.0)),
    "SHO": _Point("clavicle", "shoulder", "shoulder", 0, _UP, (-0.01, 0.0, 0.0)),
    "UPA": _Point("upper_arm", "shoulder", "elbow", 0.5, _UP),
    "ELB": _Point("upper_arm", "elbow", "elbow", 0, _UP),
    "ELM": _Point("upper_arm", "elbow", "elbow", 0, _DOWN),
    "FRM": _Point("forearm", "elbow", "wrist", 0.5, _UP),
    "WRA": _Point("hand", "wrist", "wrist", 0, _FORWARD),
    "WRB": _Point("hand", "wrist", "wrist", 0, _BACK),
    "FIN": _Point("hand", "wrist", "wrist", 0, _UP, (0.07, 0.0, 0.0)),
    "ASI": _Point("pelvis", "hip", "hip", 0, _FORWARD, (0.035, 0.075, 0.0)),
    "PSI": _Point("pelvis", "mid_hip", "mid_hip", 0, _BACK, (0.045, 0.085, 0.0)),
    "THI": _Point("thigh", "hip", "knee", 0.5, _LATERAL),
    "KNE": _Point("thigh", "knee", "knee", 0, _LATERAL),
    "KNM": _Point("thigh", "knee", "knee", 0, _MEDIAL),
    "TIB": _Point("shank", "knee", "ankle", 0.5, _LATERAL),
    "ANK": _Point("shank", "ankle", "ankle", 0, _LATERAL),
    "MED": _Point("shank", "ankle", "ankle", 0, _MEDIAL),
    "HEE": _Point("foot", "heel", "heel", 0, _BACK, (0.0, 0.02, 0.03)),
    "TOE": _Point("foot", "big_toe", "small_toe", 0.4, _UP, (0.0, 0.0, -0.05)),
}
"""Names of Plug-in Gait, with L or R before them: KNM and MED are the inner knee and ankle, ELM the inner elbow. The
hips lie from the iliac spines as in Bell et al. (1990)."""


class Markers(NamedTuple):
    """Points that move with one body each.

    Attributes:
        names: of the points.
        bodies: of each point the body that carries it.
        places: at rest, metres.
    """

    names: tuple[str, ...]
    bodies: tuple[int, ...]
    places: Float[np.ndarray, "marker 3"]

    def along(self, motion: Motion) -> Float[np.ndarray, "frame marker 3"]:
        """Move the markers through a motion, metres."""
        moved = motion.body_transforms.astype(np.float64)[:, list(self.bodies)]
        return np.einsum("tmij,mj->tmi", moved[..., :3, :3], self.places) + moved[..., :3, 3]


def marker_set(character: Character) -> Markers:
    """Mark the joints and landmarks, named as in OpenPose (`LHip`, `MidHip`), and the skin, named as in Plug-in Gait.

    Each marker moves with one body as if it were screwed to the bone. A point of the skin is missing where the
    skeleton lacks a landmark it is found by.
    """
    skeleton = character.skeleton
    names = [_camel(name) for name in skeleton.landmark_names]
    bodies, places = list(skeleton.landmark_bodies), list(np.asarray(skeleton.landmarks, np.float64))
    body, radii = neutral_body(skeleton), capsules(character).radii
    corners = np.asarray(character.vertices, np.float64)[np.asarray(character.faces)]
    owners, scale = dominant_bodies(character), float(stature(character)) / _STATURE
    landmarks = {
        name: body.placed(skeleton, carrier, place)
        for name, carrier, place in zip(skeleton.landmark_names, bodies, places, strict=True)
    }
    for name, point in _points().items():
        if point.body not in skeleton.body_names or not {point.start, point.end} <= landmarks.keys():
            continue
        number = skeleton.body_names.index(point.body)
        start = (1 - point.share) * landmarks[point.start] + point.share * landmarks[point.end]
        start = _rest(body, character, number, start + scale * np.array(point.offset))
        way = body.turns[number].T @ np.array(point.way) / np.linalg.norm(point.way)
        near = [number, skeleton.parents[number], *np.flatnonzero(np.array(skeleton.parents) == number)]
        reach = _skin(corners[np.isin(owners, near)], start, way, scale * _FARTHEST)
        names.append(name)
        bodies.append(number)
        places.append(start + (max(float(radii[number]), 0.01) if reach is None else reach) * way)
    return Markers(tuple(names), tuple(bodies), np.stack(places))


def _points() -> dict[str, _Point]:
    sided = {}
    for side, sign in (("l", 1.0), ("r", -1.0)):
        for name, point in _SIDE.items():
            body, start, end = (
                part if part in ("head", "pelvis", "mid_hip") else f"{side}_{part}"
                for part in (point.body, point.start, point.end)
            )
            mirrored = [(sign * x, y, z) for x, y, z in (point.way, point.offset)]
            sided[side.upper() + name] = _Point(body, start, end, point.share, *mirrored)
    return _CENTRE | sided


def _camel(name: str) -> str:
    """Join the words of a name, without the blanks and signs that OpenSim refuses."""
    words = re.findall(r"[^\W_]+", name)
    return "".join(map(str.capitalize, words)) if name[2:] != "toe" else f"{name[0].upper()}ToeTip"


def _rest(body: NeutralBody, character: Character, number: int, place: np.ndarray) -> np.ndarray:
    """Carry a place from the neutral body to rest."""
    return character.skeleton.joints[number].astype(np.float64) + body.turns[number].T @ (place - body.joints[number])


def _skin(corners: Float[np.ndarray, "face 3 3"], start: np.ndarray, way: np.ndarray, farthest: float) -> float | None:
    """Find how far a ray travels to the last triangle it crosses, metres (Moller and Trumbore 1997)."""
    a, edges = corners[:, 0], corners[:, 1:] - corners[:, :1]
    across = np.cross(way, edges[:, 1])
    size = np.einsum("fi,fi->f", edges[:, 0], across)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.einsum("fi,fi->f", start - a, across) / size
        other = np.cross(start - a, edges[:, 0])
        v = other @ way / size
        reach = np.einsum("fi,fi->f", other, edges[:, 1]) / size
        inside = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9)
    hit = (np.abs(size) > 1e-15) & inside & (reach > 0) & (reach < farthest)
    return float(reach[hit].max()) if hit.any() else None
