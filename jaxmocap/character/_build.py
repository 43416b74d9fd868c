"""From joint positions to a `Skeleton`: the neutral body's axes carried to the rest pose the mesh was made in."""

from collections.abc import Iterable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxmocap._results import InputError

from ._dof_table import ARMS, ROOT, ROOT_SPREAD, Arm, Dof, SkeletonTable, human_table
from ._place_missing import complete_joints
from ._rest_angles import rest_angles
from ._skeleton import ROOT_DOFS, Skeleton

Vector = Float[np.ndarray, "3"]
_SLACK = np.radians(5.0)


def build_skeleton(joints: Mapping[str, Vector], arm: Arm = "cmu7") -> Skeleton:
    """A skeleton for any rest pose (T, A, bent elbows) from its joint positions.

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
    """The skeleton of a table whose landmarks rest at `places`, metres in the rest frame."""
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
    """The fields of a `Skeleton` that tell a search how to treat these joint degrees of freedom."""
    numbered = list(enumerate(dofs, start=ROOT_DOFS))
    return {
        "dof_spread": ROOT_SPREAD + tuple(float(np.deg2rad(dof.spread)) for _, dof in numbered),
        "distal": tuple(number for number, dof in numbered if dof.distal),
        "posture": tuple(number for number, dof in numbered if dof.posture),
    }


def angles_at_rest(skeleton: Skeleton) -> Float[np.ndarray, " angle"]:
    """The joint angles of the rest pose itself, measured from the neutral body of the table (arms straight out to the
    sides, palms down, legs straight), radians: what is to be added to a pose's angles to compare two actors."""
    places = dict(zip(skeleton.landmark_names, np.asarray(skeleton.landmarks, np.float64), strict=True))
    angles, _ = rest_angles(places)
    return np.array([angles.get(name, 0.0) for name in skeleton.angle_names])


def _axis(dof: Dof, segments: Mapping[str, np.ndarray]) -> np.ndarray:
    axis = segments.get(dof.name, np.eye(3)) @ np.array(dof.axis)
    return axis / np.linalg.norm(axis)


def _array(values: object) -> jnp.ndarray:
    return jax.device_put(np.asarray(values, dtype=jnp.result_type(float)))
