"""From joint positions to a `Skeleton`: the neutral body's axes carried to the rest pose the mesh was made in."""

from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxmocap._results import InputError

from ._dof_table import ARMS, BODIES, LANDMARKS, ROOT, Arm, Dof, joint_dofs
from ._place_missing import complete_joints
from ._rest_angles import rest_angles
from ._skeleton import Skeleton

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
    places = complete_joints(joints)
    dofs = joint_dofs(arm)
    angles, segments = rest_angles(places)
    at_rest = np.array([angles.get(dof.name, 0.0) for dof in dofs])
    lower = np.minimum(np.radians([dof.lower for dof in dofs]) - at_rest, -_SLACK)
    upper = np.maximum(np.radians([dof.upper for dof in dofs]) - at_rest, _SLACK)
    names = [body for body, _, _ in BODIES]
    parents = tuple(names.index(parent) if parent else -1 for _, parent, _ in BODIES)
    return Skeleton(
        body_names=tuple(names),
        parents=parents,
        dof_names=ROOT + tuple(dof.name for dof in dofs),
        dof_body=tuple(names.index(dof.body) for dof in dofs),
        groups=_groups(dofs),
        landmark_names=tuple(name for name, _ in LANDMARKS),
        landmark_bodies=tuple(names.index(body) for _, body in LANDMARKS),
        axes=_array([_axis(dof, segments) for dof in dofs]),
        origins=_array([places[dof.joint] for dof in dofs]),
        lower=_array(lower),
        upper=_array(upper),
        landmarks=_array([places[name] for name, _ in LANDMARKS]),
    )


def angles_at_rest(skeleton: Skeleton) -> Float[np.ndarray, " dof"]:
    """The joint angles of the rest pose itself, measured from the neutral body of the table (arms straight out to the
    sides, palms down, legs straight), radians: what is to be added to a pose's angles to compare two actors."""
    places = dict(zip(skeleton.landmark_names, np.asarray(skeleton.landmarks, np.float64), strict=True))
    angles, _ = rest_angles(places)
    return np.array([angles.get(name, 0.0) for name in skeleton.dof_names[len(ROOT) :]])


def _axis(dof: Dof, segments: Mapping[str, np.ndarray]) -> np.ndarray:
    axis = segments.get(dof.name, np.eye(3)) @ np.array(dof.axis)
    return axis / np.linalg.norm(axis)


def _array(values: object) -> jnp.ndarray:
    return jax.device_put(np.asarray(values, dtype=jnp.result_type(float)))


def _groups(dofs: tuple[Dof, ...]) -> tuple[tuple[str, tuple[int, ...]], ...]:
    members: dict[str, tuple[int, ...]] = {"root": tuple(range(len(ROOT)))}
    for index, dof in enumerate(dofs, start=len(ROOT)):
        members[dof.group] = (*members.get(dof.group, ()), index)
    return tuple(members.items())
