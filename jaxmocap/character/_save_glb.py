"""Writing GLB files: buffers, and a character as an ordinary skinned GLB."""

import json
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, UInt8

from ._capsules import capsules

if TYPE_CHECKING:
    from ._character import Character


_TYPES = {np.dtype("<f4"): 5126, np.dtype("<u4"): 5125, np.dtype("u1"): 5121}
_WIDTHS = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class GlbBuffer:
    """Collects arrays into the one buffer of a GLB, each with its own view and accessor.

    `content` is a document to go on with: its views and accessors are kept, and `data` is its buffer so far.
    """

    def __init__(self, content: Mapping[str, Any] | None = None, data: bytes = b"") -> None:
        content = content or {}
        self.data = bytearray(data + b"\x00" * (-len(data) % 4))
        self.views: list[dict[str, Any]] = list(content.get("bufferViews", []))
        self.accessors: list[dict[str, Any]] = list(content.get("accessors", []))

    def add(self, array: np.ndarray, bounds: bool = False) -> int:
        """Add an accessor for `array (count, width)`, with least and greatest values if `bounds`; return its number."""
        accessor: dict[str, Any] = {
            "bufferView": len(self.views),
            "componentType": _TYPES[array.dtype],
            "count": len(array),
            "type": _WIDTHS[array.shape[1]],
        }
        if bounds:
            accessor |= {"min": array.min(axis=0).tolist(), "max": array.max(axis=0).tolist()}
        self.views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": array.nbytes})
        self.accessors.append(accessor)
        self.data += array.tobytes()
        self.data += b"\x00" * (-len(self.data) % 4)
        return len(self.accessors) - 1

    def tables(self) -> dict[str, Any]:
        """Return `accessors`, `bufferViews` and `buffers` of the document."""
        return {"accessors": self.accessors, "bufferViews": self.views, "buffers": [{"byteLength": len(self.data)}]}


def glb_bytes(document: Mapping[str, Any], binary: bytes) -> bytes:
    """Pack a document and its buffer into the bytes of one file."""
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    length = 12 + 8 + len(text) + 8 + len(binary)
    header = struct.pack("<III", 0x46546C67, 2, length)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942) + binary
    return header + chunks


def save_glb(character: "Character", path: Path, colours: UInt8[np.ndarray, "vertex 3"] | None = None) -> Path:
    """Write one mesh and one skin, a joint per body standing at rest, as many sets of four weights as the mesh needs.

    Landmarks, the joints' exact places, their misfit and a capsule per bone go into the skin's `extras`, which other
    programs ignore. `colours` of the vertices, sRGB, are written as glTF has them, linear, with a material that does
    not shine.
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
    primitive: dict[str, Any] = {"attributes": attributes}
    if colours is not None:
        attributes["COLOR_0"] = writer.add(_linear(colours).astype("<f4"))
        primitive["material"] = 0
    primitive["indices"] = writer.add(np.asarray(character.faces, "<u4").reshape(-1, 1))
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
        "meshes": [{"name": character.name, "primitives": [primitive]}],
        "skins": [
            {
                "joints": list(range(len(joints))),
                "skeleton": 0,
                "inverseBindMatrices": binds,
                "extras": {
                    "jaxmocap_landmarks": landmarks,
                    "jaxmocap_capsules": _capsules(character),
                    "jaxmocap_misfit": round(float(character.misfit), 6),
                },
            }
        ],
        **writer.tables(),
    }
    if colours is not None:
        document["materials"] = [{"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0}}]
    path.write_bytes(glb_bytes(document, bytes(writer.data)))
    return path


def _linear(colours: UInt8[np.ndarray, "vertex 3"]) -> Float[np.ndarray, "vertex 3"]:
    """Take sRGB's transfer function off (IEC 61966-2-1)."""
    shares = colours / 255.0
    return np.where(shares <= 0.04045, shares / 12.92, ((shares + 0.055) / 1.055) ** 2.4)


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
