"""`Character.load`: from a skinned glTF file or a body model to the rest frame, our 18 bodies and the skeleton."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import jax
import numpy as np

from jaxmocap._results import InputError

from ._body_model import BodyModel
from ._build import build_skeleton
from ._clean_mesh import clean_mesh
from ._dof_table import BODIES, Arm
from ._gltf import Document
from ._map_joints import Source, map_joints
from ._mesh_landmarks import mesh_landmarks
from ._read_skin import RawSkin, read_skin
from ._rest_frame import rest_frame

if TYPE_CHECKING:
    from ._character import Character

_HEIGHTS = (0.3, 3.0)
_UNITS = (("millimetres", 1e-3), ("centimetres", 1e-2), ("inches", 0.0254), ("kilometres", 1e3), ("decimetres", 0.1))


def load_character(
    kind: "type[Character]", path: Path, mapping: str | Path | Mapping[str, str] | None, arm: Arm
) -> "Character":
    """See `Character.load`."""
    document: Document | BodyModel
    if path.suffix.lower() == ".npz":
        document = BodyModel(path)
        raw = document.raw
    else:
        document = Document(path)
        raw = _read(document)
    return character_from_skin(kind, path.stem, document, raw, mapping, arm)


def character_from_skin(
    kind: "type[Character]",
    name: str,
    document: Source,
    raw: RawSkin,
    mapping: str | Path | Mapping[str, str] | None,
    arm: Arm,
) -> "Character":
    """A skinned mesh with whatever joints, turned to the rest frame and brought to our 18 bodies; `document.fail` is
    told what makes it unusable."""
    _check_numbers(document, raw.vertices, raw.weights, raw.faces)
    mapped = map_joints(document, raw, mapping)
    turn = rest_frame(mapped.places)
    places = {name: turn @ place for name, place in mapped.places.items()}
    _check_facing(document, raw.vertices @ turn.T, mapped.body_weights, places)
    vertices, faces, weights = clean_mesh(raw.vertices @ turn.T, raw.faces, mapped.body_weights)
    if len(faces) == 0:
        document.fail("has no triangle of any area; a closed surface of a person is needed")
    height = float(np.ptp(vertices[:, 1]))
    _check_height(document, height)
    try:
        return character_from_mesh(kind, name, vertices, faces, weights, places, arm)
    except InputError as error:
        document.fail(str(error).rstrip("."))


def character_from_mesh(
    kind: "type[Character]",
    name: str,
    vertices: np.ndarray,
    faces: np.ndarray,
    weights: np.ndarray,
    joints: Mapping[str, np.ndarray],
    arm: Arm,
) -> "Character":
    """See `Character.from_mesh`."""
    weights = weights / weights.sum(axis=1, keepdims=True)
    columns = {body: weights[:, number] for number, (body, _, _) in enumerate(BODIES)}
    seen = mesh_landmarks(vertices, columns, joints, float(np.ptp(vertices[:, 1])))
    return kind(
        name=name,
        skeleton=build_skeleton({**seen, **joints}, arm),
        vertices=jax.device_put(np.asarray(vertices, np.float32)),
        faces=jax.device_put(np.asarray(faces, np.int32)),
        weights=jax.device_put(np.asarray(weights, np.float32)),
    )


def _read(document: Document) -> RawSkin:
    try:
        return read_skin(document)
    except InputError:
        raise
    except (TypeError, ValueError, AttributeError, IndexError, KeyError, OverflowError) as error:
        document.fail(f"is not well-formed glTF ({type(error).__name__}: {error}); export it again")


def _check_numbers(document: Source, vertices: np.ndarray, weights: np.ndarray, faces: np.ndarray) -> None:
    for name, values in (("vertex positions", vertices), ("skinning weights", weights)):
        bad = np.flatnonzero(~np.all(np.isfinite(values), axis=1))
        if len(bad):
            document.fail(f"has {len(bad)} {name} that are not finite (first at vertex {bad[0]}); repair the mesh")
    if np.any(weights < -1e-6):
        document.fail("has negative skinning weights; normalise them and export again")
    loose = np.flatnonzero(weights.sum(axis=1) < 1e-6)
    loose = np.intersect1d(loose, faces)
    if len(loose):
        document.fail(f"has {len(loose)} vertices without skinning weights (first is {loose[0]}); weight-paint them")


def _check_height(document: Source, height: float) -> None:
    low, high = _HEIGHTS
    if low <= height <= high:
        return
    likely = next(((name, factor) for name, factor in _UNITS if 1.2 <= height * factor <= 2.2), None)
    hint = f"; it looks like {likely[0]}, scale it by {likely[1]:g}" if likely else ""
    document.fail(f"is {height:.4g} m tall, expected {low} to {high} m{hint}")


def _check_facing(
    document: Source, vertices: np.ndarray, body_weights: np.ndarray, places: Mapping[str, np.ndarray]
) -> None:
    """Left and right named the wrong way round make the feet point backwards."""
    reach = []
    for number, (body, _, joint) in enumerate(BODIES):
        foot = vertices[body_weights[:, number] > 0.5]
        if body.endswith("foot") and len(foot) >= 8:
            size = np.ptp(foot[:, 2])
            reach.append(((foot[:, 2].max() + foot[:, 2].min()) / 2 - places[joint][2]) / max(size, 1e-9))
    if len(reach) == 2 and max(reach) < -0.1:
        document.fail("has its left and right joints exchanged: the feet point backwards; swap the names or map them")
