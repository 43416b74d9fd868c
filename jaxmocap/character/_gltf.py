"""Reading glTF 2.0 files: containers, buffers and accessors, with every size checked against the bytes there are."""

import base64
import binascii
import json
import struct
from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import unquote

import numpy as np
import pygltflib
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from jaxmocap._results import InputError

_COMPONENTS = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_MAGIC, _JSON, _BINARY = 0x46546C67, 0x4E4F534A, 0x004E4942
_SUFFIXES = (".glb", ".gltf", ".vrm")


class Document:
    """A glTF file in memory. `array` decodes an accessor, `buffer` gives a buffer's bytes; `fail` raises an
    `InputError` that names the file. `content` is its JSON as it stands there."""

    content: dict[str, Any]

    def __init__(self, path: Path):
        self.path = path
        if not path.is_file():
            raise InputError(f"{path} does not exist; give the path of a skinned .glb or .gltf file.")
        data = path.read_bytes()
        if data[:4] == struct.pack("<I", _MAGIC):
            text, self._binary = self._chunks(data)
        elif path.suffix.lower() in _SUFFIXES and data.lstrip()[:1] == b"{":
            text, self._binary = data, None
        else:
            self.fail("is not a glTF file; a skinned .glb or .gltf file is needed (export one, or run `jaxmocap rig`)")
        self.gltf = self._parse(text)
        self._buffers: dict[int, bytes] = {}

    def fail(self, message: str) -> NoReturn:
        """Raise the one-sentence error of this file."""
        raise InputError(f"{self.path}: {message}.")

    def item(self, kind: str, index: Any) -> Any:
        """Return `gltf.<kind>[index]`; fail where the file refers to something it does not hold."""
        items = getattr(self.gltf, kind) or []
        if not isinstance(index, int) or isinstance(index, bool) or not 0 <= index < len(items):
            self.fail(f"refers to {kind} number {index} but holds {len(items)}; the file is damaged, export it again")
        return items[index]

    def array(self, index: Any) -> np.ndarray:
        """Read an accessor as (count, width); normalised integers become floats in [0, 1] or [-1, 1]."""
        accessor = self.item("accessors", index)
        if accessor.sparse is not None:
            self.fail(f"accessor {index} is sparse, which is not supported; export the model without sparse accessors")
        dtype, width = _COMPONENTS.get(accessor.componentType), _WIDTHS.get(accessor.type)
        if dtype is None or width is None or accessor.bufferView is None:
            self.fail(f"accessor {index} has no data or an unknown type; export the model again, without compression")
        view = self.item("bufferViews", accessor.bufferView)
        if (view.extensions or {}).get("EXT_meshopt_compression"):
            self.fail("is compressed with meshopt; export the model without compression")
        count, size = accessor.count, np.dtype(dtype).itemsize * width
        stride = view.byteStride or size
        start, offset = view.byteOffset or 0, accessor.byteOffset or 0
        numbers = (count, stride, start, offset, view.byteLength)
        if not all(isinstance(number, int) and number >= 0 for number in numbers) or stride < size:
            self.fail(f"accessor {index} has impossible sizes; the file is damaged, export it again")
        data = self.buffer(view.buffer)
        end = start + offset + stride * (count - 1) + size if count else start
        if end > min(len(data), start + view.byteLength):
            self.fail(f"accessor {index} needs {end} bytes but the buffer holds {len(data)}; the file is cut short")
        if count == 0:
            return np.zeros((0, width), dtype)
        rows = np.lib.stride_tricks.as_strided(
            np.frombuffer(data, np.uint8)[start + offset :], (count, size), (stride, 1), writeable=False
        )
        values = np.ascontiguousarray(rows).view(np.dtype(dtype).newbyteorder("<"))
        if accessor.normalized and dtype is not np.float32:
            return np.maximum(values.astype(np.float64) / np.iinfo(dtype).max, -1.0)
        return values

    def _chunks(self, data: bytes) -> tuple[bytes, bytes | None]:
        if len(data) < 20:
            self.fail(f"holds only {len(data)} bytes; the file is cut short")
        _, version, length = struct.unpack_from("<III", data)
        if version != 2:
            self.fail(f"is glTF version {version}; version 2 is needed")
        if length > len(data):
            self.fail(f"declares {length} bytes but holds {len(data)}; the file is cut short")
        chunks: dict[int, bytes] = {}
        position = 12
        while position + 8 <= length:
            size, kind = struct.unpack_from("<II", data, position)
            if position + 8 + size > length:
                self.fail(f"declares a chunk of {size} bytes where {length - position - 8} are left; it is cut short")
            chunks.setdefault(kind, data[position + 8 : position + 8 + size])
            position += 8 + size
        if _JSON not in chunks:
            self.fail("has no JSON chunk; the file is damaged, export it again")
        return chunks[_JSON], chunks.get(_BINARY)

    def _parse(self, text: bytes) -> pygltflib.GLTF2:
        try:
            content = json.loads(text.decode("utf-8").rstrip("\x00 \n"))
            if not isinstance(content, dict) or "asset" not in content:
                self.fail("is JSON but not glTF; a skinned .glb or .gltf file is needed")
            required = content.get("extensionsRequired") or []
            compressed = [name for name in required if "draco" in name or "meshopt" in name]
            if compressed:
                self.fail(f"is compressed with {compressed[0]}; export the model without compression")
            self.content = content
            return pygltflib.GLTF2.from_json(json.dumps(content), infer_missing=True)
        except (UnicodeDecodeError, json.JSONDecodeError, RecursionError):
            self.fail("has unreadable JSON; the file is damaged, export it again")
        except (TypeError, KeyError, AttributeError, ValueError) as error:
            if isinstance(error, InputError):
                raise
            self.fail(f"is not well-formed glTF ({error}); export it again")

    def buffer(self, index: Any) -> bytes:
        """Read the bytes of a buffer, from wherever they are."""
        if index not in self._buffers:
            buffer = self.item("buffers", index)
            data = self.uri(buffer.uri) if buffer.uri else self._binary
            if data is None:
                self.fail("has no binary chunk; the file is cut short")
            self._buffers[index] = data
        return self._buffers[index]

    def uri(self, uri: str) -> bytes:
        """Read what a URI in the file stands for: data of its own, or a file beside it."""
        if uri.startswith("data:"):
            try:
                return base64.b64decode(uri.partition(",")[2], validate=True)
            except (binascii.Error, ValueError):
                self.fail("has an unreadable embedded buffer; the file is damaged, export it again")
        literal = self.path.parent / uri
        target = (literal if literal.is_file() else self.path.parent / unquote(uri)).resolve()
        if not target.is_relative_to(self.path.parent.resolve()):
            self.fail(f"refers to the buffer {uri} outside its own folder; put both files into one folder")
        if not target.is_file():
            self.fail(f"refers to the buffer {uri}, which is not there; put it beside the file, or export a .glb")
        return target.read_bytes()


def has_skin(path: Path) -> bool:
    """Tell whether a glTF file binds a mesh to joints.

    True also for what cannot be read: loading will say what is wrong with it.
    """
    try:
        return bool(Document(path).content.get("skins"))
    except InputError:
        return path.is_file()


def parents_of(nodes: list[dict[str, Any]]) -> list[int]:
    """List the number of each node's parent, -1 where it has none."""
    parents = [-1] * len(nodes)
    for number, node in enumerate(nodes):
        for child in node.get("children", []):
            parents[child] = number
    return parents


def parents_first(parents: list[int]) -> list[int]:
    """Sort all nodes so that parents precede their children."""
    order = [node for node, parent in enumerate(parents) if parent < 0]
    for node in order:
        order.extend(child for child, parent in enumerate(parents) if parent == node)
    return order


def local_matrix(node: dict[str, Any]) -> Float[np.ndarray, "4 4"]:
    """Compute the transform of a node in its parent."""
    if node.get("matrix"):
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    matrix = np.eye(4)
    rotation = node.get("rotation")
    if rotation is not None and np.any(rotation):
        matrix[:3, :3] = Rotation.from_quat(rotation).as_matrix()
    matrix[:3, :3] *= np.array(node.get("scale") or [1.0, 1.0, 1.0])
    matrix[:3, 3] = node.get("translation") or [0.0, 0.0, 0.0]
    return matrix
