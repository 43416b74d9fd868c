"""The joints of a skinned file, the bodies they follow and the file's axes: what it takes to pose its own rig."""

import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxmocap.geometry import unit

from ._gltf import Document
from ._map_joints import Source, map_joints
from ._read_skin import RawSkin, read_skin


class Rig(NamedTuple):
    """The joints of a file, in the order of its skin (or of its hierarchy, where it has no skin).

    In a pose, `world_from_body[bodies] @ rest_from_joint` are the joints' transforms.

    Attributes:
        bodies: the body that each joint follows.
        rest_from_joint: takes the space of each joint, as it is bound, to our rest frame.
        anchors: the joint at which a body begins, where there is one.
        places: our joints and landmarks in the rest frame, metres.
        rest_from_file: turns the file's axes to those of the rest frame.
    """

    bodies: tuple[int, ...]
    rest_from_joint: Float[np.ndarray, "joint 4 4"]
    anchors: dict[str, int]
    places: dict[str, np.ndarray]
    rest_from_file: Float[np.ndarray, "3 3"]


def read_rig(document: Document, mapping: str | Path | Mapping[str, str] | None = None) -> tuple[RawSkin, Rig]:
    """Read the skin that `Character.load` reads, and its rig. Raises `InputError` as that does."""
    raw = read_skin(document)
    return raw, rig_of(document, raw, raw.place @ np.linalg.inv(raw.inverse_binds), mapping)


def rig_of(
    source: Source,
    raw: RawSkin,
    file_from_joint: Float[np.ndarray, "joint 4 4"],
    mapping: str | Path | Mapping[str, str] | None = None,
) -> Rig:
    """Build the rig of joints that rest at `file_from_joint`, metres."""
    mapped = map_joints(source, raw, mapping)
    turn = rest_frame(mapped.places)
    rest_from_file = np.eye(4)
    rest_from_file[:3, :3] = turn
    places = {name: turn @ place for name, place in mapped.places.items()}
    return Rig(mapped.bodies, rest_from_file @ file_from_joint, mapped.anchors, places, turn)


def rest_frame(places: dict[str, np.ndarray], near: float = 20.0) -> np.ndarray:
    """Find the rotation (3, 3) from the file's frame to the rest frame by the joint positions.

    It is an exact quarter turn where one is within `near` degrees.

    Up is from the ankles to the neck, left from the right hip and shoulder to the left ones.
    """
    ankles = 0.5 * (places["l_ankle"] + places["r_ankle"])
    up = unit(places["neck"] - ankles)
    left = sum(unit(places[f"l_{name}"] - places[f"r_{name}"]) for name in ("hip", "shoulder"))
    left = unit(left - (left @ up) * up)
    estimate = np.stack([left, up, np.cross(left, up)])
    for turn in _quarter_turns():
        if np.all(np.sum(turn * estimate, axis=1) > np.cos(np.radians(near))):
            return turn
    return estimate


def _quarter_turns() -> list[np.ndarray]:
    turns = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            turn = np.diag(signs)[:, list(order)]
            if np.linalg.det(turn) > 0:
                turns.append(turn)
    return turns
