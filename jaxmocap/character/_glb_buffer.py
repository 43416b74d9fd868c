"""Writing GLB files: the container, and the buffer that its arrays share."""

import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np

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
        """The number of a new accessor for `array (count, width)`; `bounds` gives its least and greatest values."""
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
        """`accessors`, `bufferViews` and `buffers` of the document."""
        return {"accessors": self.accessors, "bufferViews": self.views, "buffers": [{"byteLength": len(self.data)}]}


def glb_bytes(document: Mapping[str, Any], binary: bytes) -> bytes:
    """The file of a document and its buffer."""
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    length = 12 + 8 + len(text) + 8 + len(binary)
    header = struct.pack("<III", 0x46546C67, 2, length)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942) + binary
    return header + chunks
