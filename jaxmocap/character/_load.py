"""`Character.load`: from a skinned glTF file or a body model to a clean mesh in the rest frame on our skeleton."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import jax
import numpy as np

from jaxmocap._results import InputError

from ._body_model import BodyModel
from ._build import build_skeleton
from ._dof_table import BODIES, Arm
from ._gltf import Document
from ._map_joints import Source, map_joints, saved_misfit
from ._read_skin import RawSkin, read_skin
from ._rig import rest_frame

if TYPE_CHECKING:
    from ._character import Character
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

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
    """Turn a skinned mesh with whatever joints to the rest frame and bring it to our 18 bodies.

    `document.fail` is told what makes it unusable.
    """
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
        made = character_from_mesh(kind, name, vertices, faces, weights, places, arm)
    except InputError as error:
        document.fail(str(error).rstrip("."))
    return replace(made, misfit=saved_misfit(raw))


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


def clean_mesh(
    vertices: np.ndarray, faces: np.ndarray, weights: np.ndarray, tolerance: float = 1e-6
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weld seams, drop degenerate and repeated faces and unused vertices, and make all faces point outwards.

    `tolerance` is in the units of the vertices. Weights of welded vertices are averaged. Vertex order is kept.
    """
    label = _weld(vertices, tolerance)
    count = np.bincount(label).astype(np.float64)[:, None]
    first = np.full(len(count), len(vertices))
    np.minimum.at(first, label, np.arange(len(vertices)))
    summed = np.zeros((len(count), weights.shape[1]))
    np.add.at(summed, label, weights)
    vertices, weights, faces = vertices[first], summed / count, label[faces]

    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    _, keep = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    faces = faces[np.sort(keep)]
    used = np.unique(faces)
    renumber = np.zeros(len(vertices), dtype=np.int64)
    renumber[used] = np.arange(len(used))
    vertices, weights, faces = vertices[used], weights[used], renumber[faces]
    return vertices, _outwards(vertices, faces), weights


def _weld(vertices: np.ndarray, tolerance: float) -> np.ndarray:
    """For every vertex its welded number; groups are numbered in the order of their first vertex."""
    pairs = KDTree(vertices).query_pairs(tolerance, output_type="ndarray")
    size = len(vertices)
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(size, size))
    _, label = connected_components(graph, directed=False)
    _, first, inverse = np.unique(label, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[inverse]


def _outwards(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Each connected part on its own, since parts of a character often disagree."""
    if len(faces) == 0:
        return faces
    size = len(vertices)
    rows, columns = faces.ravel(), np.roll(faces, 1, axis=1).ravel()
    _, part = connected_components(
        coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(size, size)), directed=False
    )
    of_face = part[faces[:, 0]]
    centre = vertices.mean(axis=0)
    a, b, c = (vertices[faces[:, corner]] - centre for corner in range(3))
    volumes = np.bincount(of_face, np.einsum("ij,ij->i", a, np.cross(b, c)))
    return np.where((volumes[of_face] < 0)[:, None], faces[:, ::-1], faces)


def mesh_landmarks(
    vertices: np.ndarray, body_weights: Mapping[str, np.ndarray], places: Mapping[str, np.ndarray], height: float
) -> dict[str, np.ndarray]:
    """Find the landmarks the mesh shows (metres, rest frame); `body_weights` holds one column per body."""
    found = {}
    if (head := vertices[body_weights["head"] > 0.5]).size:
        found.update(_face(head, places, height))
    for side, sign in (("l", 1.0), ("r", -1.0)):
        foot = vertices[body_weights[f"{side}_foot"] > 0.5]
        if len(foot) >= 8:
            found[f"{side}_toe"] = foot[np.argmax(foot[:, 2])]
            found[f"{side}_big_toe"] = foot[np.argmax(foot @ np.array([-0.5 * sign, 0.0, 1.0]))]
            found[f"{side}_small_toe"] = foot[np.argmax(foot @ np.array([sign, 0.0, 0.8]))]
            low = foot[foot[:, 1] < foot[:, 1].min() + 0.04 * height]
            found[f"{side}_heel"] = low[np.argmin(low[:, 2])]
    return found


def _face(head: np.ndarray, places: Mapping[str, np.ndarray], height: float) -> dict[str, np.ndarray]:
    """Take the foremost point as the nose, and place ears and eyes at ordinary heights above it, on the surface."""
    middle = places["neck"][0]
    centre = np.abs(head[:, 0] - middle) < 0.02 * height
    upper = head[:, 1] > head[:, 1].max() - 0.12 * height
    candidates = head[centre & upper]
    if len(candidates) == 0:
        return {}
    nose = candidates[np.argmax(candidates[:, 2])].copy()
    nose[0] = middle
    found = {"nose": nose}
    for side, sign in (("l", 1.0), ("r", -1.0)):
        eye = nose + height * np.array([0.018 * sign, 0.02, -0.01])
        nearest = head[np.argmin(np.sum((head - eye)[:, :2] ** 2, axis=1) + 1e3 * (head[:, 2] < places["neck"][2]))]
        found[f"{side}_eye"] = np.array([eye[0], eye[1], nearest[2]])
        band = head[np.abs(head[:, 1] - nose[1] - 0.01 * height) < 0.02 * height]
        found[f"{side}_ear"] = band[np.argmax(sign * band[:, 0])]
    return found
