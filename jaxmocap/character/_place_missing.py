"""Joints and landmarks a file does not give, placed by ordinary adult proportions."""

from collections.abc import Mapping

import numpy as np

from jaxmocap._results import InputError

from ._dof_table import LANDMARKS

REQUIRED = (
    "pelvis",
    "neck",
    *(f"{s}_{j}" for s in "lr" for j in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")),
)
_BONES = tuple((f"{s}_{a}", f"{s}_{b}") for s in "lr" for a, b in (("shoulder", "elbow"), ("elbow", "wrist"))) + tuple(
    (f"{s}_{a}", f"{s}_{b}") for s in "lr" for a, b in (("hip", "knee"), ("knee", "ankle"))
)
_STATURE = 1.75  # the height in metres that the offsets below are for


def stature(joints: Mapping[str, np.ndarray]) -> float:
    """Standing height in metres, estimated from the bones, in whatever rest pose."""
    legs = sum(np.linalg.norm(joints[a] - joints[b]) for a, b in _BONES[4:]) / 2
    trunk = np.linalg.norm(joints["neck"] - 0.5 * (joints["l_hip"] + joints["r_hip"]))
    return float(1.22 * (legs + trunk))


def complete_joints(joints: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """All landmarks of the skeleton, those given and those placed; metres, rest frame."""
    places = {name: np.asarray(place, dtype=np.float64) for name, place in joints.items()}
    missing = [name for name in REQUIRED if name not in places]
    if missing:
        raise InputError(f"the skeleton lacks the joints {', '.join(missing)}; give their rest positions in metres.")
    for name, place in places.items():
        if place.shape != (3,) or not np.all(np.isfinite(place)):
            raise InputError(f"joint {name} has the position {place}; three finite numbers in metres are needed.")
    for a, b in _BONES:
        if np.linalg.norm(places[a] - places[b]) < 1e-3:
            raise InputError(f"joints {a} and {b} are closer than 1 mm; they must be the two ends of a bone.")
    for name, place in _proposals(places).items():
        places.setdefault(name, place)
    return {name: places[name] for name, _ in LANDMARKS}


def _proposals(at: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    scale = stature(at) / _STATURE
    offset = lambda x, y, z: scale * np.array([x, y, z])  # noqa: E731
    hips = 0.5 * (at["l_hip"] + at["r_hip"])
    shoulders = 0.5 * (at["l_shoulder"] + at["r_shoulder"])
    neck = at["neck"]
    trunk_low = at.get("spine", hips + 0.18 * (neck - hips))
    head = at.get("head", neck + offset(0, 0.09, 0.02))
    places = {
        "spine": trunk_low,
        "thorax": trunk_low + 0.35 * (neck - trunk_low),
        "head": head,
        "mid_hip": hips,
        "mid_shoulder": shoulders,
    }
    nose = at.get("nose", head + offset(0, 0.03, 0.11))
    places["nose"] = nose
    for side, sign in (("l", 1.0), ("r", -1.0)):
        shoulder, ankle = at[f"{side}_shoulder"], at[f"{side}_ankle"]
        middle = hips[0]  # the plane of symmetry
        notch = np.array([middle, min(shoulder[1] + 0.02 * scale, neck[1] - 0.02 * scale), shoulder[2] + 0.04 * scale])
        places[f"{side}_clavicle"] = notch + offset(0.025 * sign, 0, 0)
        places[f"{side}_eye"] = nose + offset(0.032 * sign, 0.035, -0.02)
        places[f"{side}_ear"] = nose + offset(0.075 * sign, 0.02, -0.11)
        ground = ankle + offset(0, -0.07, 0)
        places[f"{side}_toe"] = at.get(f"{side}_toe", ground + offset(0.02 * sign, 0.01, 0.17))
        places[f"{side}_heel"] = at.get(f"{side}_heel", ground + offset(0, 0.01, -0.06))
        places[f"{side}_big_toe"] = places[f"{side}_toe"] + offset(-0.01 * sign, 0, 0)
        places[f"{side}_small_toe"] = places[f"{side}_toe"] + offset(0.06 * sign, 0, -0.05)
    return places
