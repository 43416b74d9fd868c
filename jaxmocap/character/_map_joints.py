"""From a file's joints to our 18 bodies: which joint is which, where our joints are, and whose weights are whose."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ._dof_table import BODIES
from ._gltf import Document
from ._joint_names import ancestors, roles_by_name
from ._read_skin import RawSkin

_NEEDED = (
    "pelvis",
    "neck",
    *(f"{s}_{r}" for s in "lr" for r in ("upper_arm", "forearm", "hand", "thigh", "shank", "foot")),
)
_JOINT_OF_BODY = {body: joint for body, _, joint in BODIES}


class MappedJoints(NamedTuple):
    """Our joints in the file's frame, and the weights (V, 18) by body."""

    places: dict[str, np.ndarray]
    body_weights: np.ndarray


def map_joints(document: Document, raw: RawSkin, mapping: str | Path | Mapping[str, str] | None) -> MappedJoints:
    """Find our bodies among the file's joints; raises `InputError` naming the bodies that could not be found."""
    roles = roles_by_name(raw.joint_names, raw.joint_parents)
    missing = [role for role in _NEEDED if role not in roles]
    if missing:
        document.fail(f"no joint was recognised for {', '.join(missing)}")
    places = {_JOINT_OF_BODY[role]: raw.joint_places[joint] for role, joint in roles.items() if role in _JOINT_OF_BODY}
    places["neck"] = raw.joint_places[roles["neck"]]
    owner = {roles[role]: role for role in roles if role in _JOINT_OF_BODY}
    spine = [roles[f"spine{i}"] for i in range(len(roles)) if f"spine{i}" in roles]
    places["spine"], places["thorax"] = raw.joint_places[spine[0]], raw.joint_places[spine[1]]
    owner[spine[0]], owner[spine[1]], owner[roles["neck"]] = "abdomen", "chest", "head"
    if "head" in roles:
        places["head"] = raw.joint_places[roles["head"]]
    names = [body for body, _, _ in BODIES]
    weights = np.zeros((len(raw.weights), len(names)))
    for joint in range(len(raw.joint_names)):
        chain = [j for j in [joint, *ancestors(joint, raw.joint_parents)] if j in owner]
        weights[:, names.index(owner[chain[0]] if chain else "pelvis")] += raw.weights[:, joint]
    return MappedJoints(places, weights)
