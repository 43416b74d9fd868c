"""GLB files read by pygltflib and posed by plain NumPy: what any other program would see."""

from pathlib import Path

import numpy as np
import pygltflib

_TYPES = {5121: "<u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class PosedGlb:
    """`at(seconds)` poses the only animation; `vertices` and `camera` are of that moment."""

    def __init__(self, path: Path):
        self.gltf = pygltflib.GLTF2().load(str(path))
        self.blob = self.gltf.binary_blob()
        self.names = [node.name for node in self.gltf.nodes]
        self.parents = [-1] * len(self.gltf.nodes)
        for number, node in enumerate(self.gltf.nodes):
            for child in node.children or []:
                self.parents[child] = number
        (self.animation,) = self.gltf.animations
        self.times = self.array(self.animation.samplers[0].input)[:, 0]
        self.at(self.times[0])

    def array(self, index: int) -> np.ndarray:
        accessor = self.gltf.accessors[index]
        view = self.gltf.bufferViews[accessor.bufferView]
        start, width = (view.byteOffset or 0) + (accessor.byteOffset or 0), _WIDTHS[accessor.type]
        flat = np.frombuffer(self.blob, _TYPES[accessor.componentType], accessor.count * width, start)
        return flat.reshape(-1, width)

    def keys(self, node: int, path: str) -> np.ndarray | None:
        for channel in self.animation.channels:
            if (channel.target.node, channel.target.path) == (node, path):
                return self.array(self.animation.samplers[channel.sampler].output).astype(float)
        return None

    def at(self, seconds: float) -> "PosedGlb":
        """Interpolated straight between keys, as for LINEAR samplers and small turns."""
        self.worlds = [np.eye(4)] * len(self.names)
        for node in range(len(self.names)):
            line, above = [node], self.parents[node]
            while above >= 0:
                line.append(above)
                above = self.parents[above]
            for one in reversed(line):
                self.worlds[node] = self.worlds[node] @ self.local(one, seconds)
        return self

    def local(self, number: int, seconds: float) -> np.ndarray:
        node = self.gltf.nodes[number]
        if node.matrix:
            return np.array(node.matrix).reshape(4, 4).T
        values = {"translation": node.translation or [0, 0, 0], "rotation": node.rotation or [0, 0, 0, 1]}
        values["scale"] = node.scale or [1, 1, 1]
        for path in values:
            keys = self.keys(number, path)
            if keys is not None:
                values[path] = [np.interp(seconds, self.times, column) for column in keys.T]
        x, y, z, w = np.array(values["rotation"]) / np.linalg.norm(values["rotation"])
        matrix = np.eye(4)
        matrix[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        matrix[:3, :3] *= values["scale"]
        matrix[:3, 3] = values["translation"]
        return matrix

    @property
    def vertices(self) -> np.ndarray:
        """The skinned mesh in the world, as the file's own vertices are numbered."""
        skin = self.gltf.skins[0]
        binds = self.array(skin.inverseBindMatrices).reshape(-1, 4, 4).swapaxes(1, 2)
        moved = np.stack([self.worlds[node] for node in skin.joints]) @ binds
        attributes = self.gltf.meshes[0].primitives[0].attributes
        points = self.array(attributes.POSITION).astype(float)
        posed = np.zeros_like(points)
        for number in range(8):
            joints = getattr(attributes, f"JOINTS_{number}", None)
            if joints is not None:
                weights = self.array(getattr(attributes, f"WEIGHTS_{number}"))
                blend = np.einsum("vk,vkij->vij", weights, moved[self.array(joints)])
                posed += np.einsum("vij,vj->vi", blend[:, :3, :3], points) + blend[:, :3, 3]
        return posed

    def place(self, name: str) -> np.ndarray:
        return self.worlds[self.names.index(name)][:3, 3]

    def pixels(self, name: str, points: np.ndarray) -> tuple[np.ndarray, dict]:
        """Where a camera of the file sees points, 0 to 1 across and down its frame; and its extras."""
        node = next(n for n, each in enumerate(self.gltf.nodes) if each.camera is not None and each.name == name)
        camera = self.gltf.cameras[self.gltf.nodes[node].camera]
        seen = (points - self.worlds[node][:3, 3]) @ self.worlds[node][:3, :3]  # x right, y up, looking along -z
        half = np.tan(camera.perspective.yfov / 2)
        across = 0.5 + 0.5 * seen[:, 0] / -seen[:, 2] / (half * camera.perspective.aspectRatio)
        return np.stack([across, 0.5 - 0.5 * seen[:, 1] / -seen[:, 2] / half], axis=1), camera.extras["jaxmocap"]
