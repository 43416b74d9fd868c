"""Writing a character as an ordinary skinned GLB."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ._capsules import capsules
from ._glb_buffer import GlbBuffer, glb_bytes

if TYPE_CHECKING:
    from ._character import Character


def save_glb(character: "Character", path: Path) -> Path:
    """One mesh, one skin of a joint per body standing at rest, as many sets of four weights as the mesh needs.

    Landmarks, the joints' exact places and a capsule per bone go into the skin's `extras`, which other programs ignore.
    """
    skeleton = character.skeleton
    joints = skeleton.joints.astype("<f4")
    inverse_binds = np.tile(np.eye(4, dtype="<f4"), (len(joints), 1, 1))
    inverse_binds[:, 3, :3] = -joints  # glTF matrices are stored by columns
    writer = GlbBuffer()
    attributes = {"POSITION": writer.add(np.asarray(character.vertices, "<f4"), bounds=True)}
    for number, (bones, values) in enumerate(_influences(np.asarray(character.weights, "<f4"))):
        attributes[f"JOINTS_{number}"] = writer.add(bones.astype("u1"))
        attributes[f"WEIGHTS_{number}"] = writer.add(values.astype("<f4"))
    indices = writer.add(np.asarray(character.faces, "<u4").reshape(-1, 1))
    binds = writer.add(inverse_binds.reshape(-1, 16))
    mesh_node = len(joints)
    landmarks = dict(zip(skeleton.landmark_names, np.asarray(skeleton.landmarks).tolist(), strict=True))
    document = {
        "asset": {"version": "2.0", "generator": "jaxmocap"},
        "scene": 0,
        "scenes": [{"nodes": [0, mesh_node]}],
        "nodes": [
            *_nodes(joints, skeleton.body_names, skeleton.parents),
            {"name": character.name, "mesh": 0, "skin": 0},
        ],
        "meshes": [{"name": character.name, "primitives": [{"attributes": attributes, "indices": indices}]}],
        "skins": [
            {
                "joints": list(range(len(joints))),
                "skeleton": 0,
                "inverseBindMatrices": binds,
                "extras": {"jaxmocap_landmarks": landmarks, "jaxmocap_capsules": _capsules(character)},
            }
        ],
        **writer.tables(),
    }
    path.write_bytes(glb_bytes(document, bytes(writer.data)))
    return path


def _capsules(character: "Character") -> dict[str, dict[str, object]]:
    rows = zip(*(part.round(6).tolist() for part in capsules(character)), strict=True)
    return {
        body: {"start": start, "end": end, "radius": radius}
        for body, (start, end, radius) in zip(character.skeleton.body_names, rows, strict=True)
    }


def _nodes(joints: np.ndarray, names: tuple[str, ...], parents: tuple[int, ...]) -> list[dict[str, object]]:
    nodes: list[dict[str, object]] = []
    for number, name in enumerate(names):
        origin = joints[parents[number]] if parents[number] >= 0 else np.zeros(3, "<f4")
        node: dict[str, object] = {"name": name, "translation": (joints[number] - origin).tolist()}
        children = [child for child, parent in enumerate(parents) if parent == number]
        nodes.append({**node, "children": children} if children else node)
    return nodes


def _influences(weights: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Dense weights as sets of four (bones, values), largest first; unused places hold bone 0 with weight 0."""
    order = np.argsort(-weights, axis=1, kind="stable")
    values = np.take_along_axis(weights, order, axis=1)
    most = max(int(np.count_nonzero(values, axis=1).max()), 1)
    sets = []
    for start in range(0, -(-most // 4) * 4, 4):
        part = values[:, start : start + 4]
        bones = np.where(part > 0, order[:, start : start + 4], 0)
        missing = 4 - part.shape[1]
        sets.append((np.pad(bones, ((0, 0), (0, missing))), np.pad(part, ((0, 0), (0, missing)))))
    return sets
