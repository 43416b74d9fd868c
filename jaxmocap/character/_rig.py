"""The joints of a skinned file and the bodies they follow: what it takes to pose the file's own rig."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ._gltf import Document
from ._map_joints import Source, map_joints
from ._read_skin import RawSkin, read_skin
from ._rest_frame import rest_frame


class Rig(NamedTuple):
    """The J joints of a file, in the order of its skin (or of its hierarchy, where it has no skin).

    `bodies` has the body that each joint follows, and `rest_from_joint` takes the space of a joint, as it is bound, to
    our rest frame: `world_from_body[bodies] @ rest_from_joint` are the joints' transforms in a pose. `anchors` has the
    joint at which a body begins, where there is one. `places` are our joints and landmarks in the rest frame, metres,
    and `rest_from_file` turns the file's axes to those of the rest frame.
    """

    bodies: tuple[int, ...]
    rest_from_joint: Float[np.ndarray, "joint 4 4"]
    anchors: dict[str, int]
    places: dict[str, np.ndarray]
    rest_from_file: Float[np.ndarray, "3 3"]


def read_rig(document: Document, mapping: str | Path | Mapping[str, str] | None = None) -> tuple[RawSkin, Rig]:
    """The skin that `Character.load` reads, and its rig. Raises `InputError` as that does."""
    raw = read_skin(document)
    return raw, rig_of(document, raw, raw.place @ np.linalg.inv(raw.inverse_binds), mapping)


def rig_of(
    source: Source,
    raw: RawSkin,
    file_from_joint: Float[np.ndarray, "joint 4 4"],
    mapping: str | Path | Mapping[str, str] | None = None,
) -> Rig:
    """The rig of joints that rest at `file_from_joint`, metres."""
    mapped = map_joints(source, raw, mapping)
    turn = rest_frame(mapped.places)
    rest_from_file = np.eye(4)
    rest_from_file[:3, :3] = turn
    places = {name: turn @ place for name, place in mapped.places.items()}
    return Rig(mapped.bodies, rest_from_file @ file_from_joint, mapped.anchors, places, turn)
