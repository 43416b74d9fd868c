"""From joint positions to a `Skeleton`: what is not given is placed, the table's axes are carried to the rest pose."""

from collections.abc import Iterable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxmocap._results import InputError

from ._dof_table import ARMS, LANDMARKS, ROOT, ROOT_SPREAD, Arm, Dof, SkeletonTable, human_table
from ._rest_angles import rest_angles
from ._skeleton import ROOT_DOFS, Skeleton

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
    """Estimate the standing height in metres from the bones, in whatever rest pose."""
    legs = sum(np.linalg.norm(joints[a] - joints[b]) for a, b in _BONES[4:]) / 2
    trunk = np.linalg.norm(joints["neck"] - 0.5 * (joints["l_hip"] + joints["r_hip"]))
    return float(1.22 * (legs + trunk))


def complete_joints(joints: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Place the landmarks that are not given, and return all of the skeleton's; metres, rest frame."""
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


Vector = Float[np.ndarray, "3"]
_SLACK = np.radians(5.0)


def build_skeleton(joints: Mapping[str, Vector], arm: Arm = "cmu7") -> Skeleton:
    """Build a skeleton for any rest pose (T, A, bent elbows) from its joint positions.

    `joints` holds positions in metres in the rest frame (x = subject's left, y up, z forward): `pelvis`, `neck`, and
    per side `l_` / `r_` `shoulder elbow wrist hip knee ankle`; `spine`, `thorax`, `l_clavicle`, `r_clavicle` and the
    other names of `Skeleton.landmark_names` are placed anatomically where absent. Each axis of the table is turned by
    the rest pose's own joint angles, read off the bone directions, and the limits shift by the same angles, so they
    stay anatomical; they always contain the rest pose with 5 degrees of slack. Raises `InputError` for a missing or
    misplaced joint or an unknown `arm`.
    """
    if arm not in ARMS:
        raise InputError(f"arm={arm!r} is not a known arm layout; choose one of {', '.join(ARMS)}.")
    return skeleton_of(human_table(arm), complete_joints(joints))


def skeleton_of(table: SkeletonTable, places: Mapping[str, Vector]) -> Skeleton:
    """Build the skeleton of a table whose landmarks rest at `places`, metres in the rest frame."""
    angles, segments = rest_angles({name: places[name] for name, _ in table.landmarks})
    dofs, names = table.dofs, [body for body, _, _ in table.bodies]
    at_rest = np.array([angles.get(dof.name, 0.0) for dof in dofs])
    lower = np.minimum(np.radians([dof.lower for dof in dofs]) - at_rest, -_SLACK)
    upper = np.maximum(np.radians([dof.upper for dof in dofs]) - at_rest, _SLACK)
    return Skeleton(
        body_names=tuple(names),
        parents=tuple(names.index(parent) if parent else -1 for _, parent, _ in table.bodies),
        dof_names=ROOT + tuple(dof.name for dof in dofs),
        dof_body=tuple(names.index(dof.body) for dof in dofs),
        groups=table.groups,
        **search_hints(dofs),
        landmark_names=tuple(name for name, _ in table.landmarks),
        landmark_bodies=tuple(names.index(body) for _, body in table.landmarks),
        axes=_array([_axis(dof, segments) for dof in dofs]),
        origins=_array([places[dof.joint] for dof in dofs]),
        lower=_array(lower),
        upper=_array(upper),
        landmarks=_array([places[name] for name, _ in table.landmarks]),
    )


def search_hints(dofs: Iterable[Dof]) -> dict[str, Any]:
    """Fill the fields of a `Skeleton` that tell a search how to treat these joint degrees of freedom."""
    numbered = list(enumerate(dofs, start=ROOT_DOFS))
    return {
        "dof_spread": ROOT_SPREAD + tuple(float(np.deg2rad(dof.spread)) for _, dof in numbered),
        "distal": tuple(number for number, dof in numbered if dof.distal),
        "posture": tuple(number for number, dof in numbered if dof.posture),
    }


def angles_at_rest(skeleton: Skeleton) -> Float[np.ndarray, " angle"]:
    """Measure the joint angles of the rest pose itself, radians, from the neutral body of the table.

    In the neutral body the arms are straight out to the sides, the palms down and the legs straight. To compare two
    actors, add these angles to those of each one's pose.
    """
    places = dict(zip(skeleton.landmark_names, np.asarray(skeleton.landmarks, np.float64), strict=True))
    angles, _ = rest_angles(places)
    return np.array([angles.get(name, 0.0) for name in skeleton.angle_names])


def _axis(dof: Dof, segments: Mapping[str, np.ndarray]) -> np.ndarray:
    axis = segments.get(dof.name, np.eye(3)) @ np.array(dof.axis)
    return axis / np.linalg.norm(axis)


def _array(values: object) -> jnp.ndarray:
    return jax.device_put(np.asarray(values, dtype=jnp.result_type(float)))
