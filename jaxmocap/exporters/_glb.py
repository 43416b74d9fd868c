"""GLB: the skinned actor, its clip, and the cameras as they moved."""

import copy
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from jaxmocap.character import Document, GlbBuffer, glb_bytes
from jaxmocap.motion import Motion

from ._actor_rig import actor_rig
from ._exporter import ExportForm

GL_FROM_CV = np.diag([1.0, -1.0, -1.0])
"""A glTF or USD camera looks along -z with y up; ours along z with y down."""
_NEAR, _FAR = 0.01, 1000.0  # clipping planes, metres
_STILL = 1e-6  # metres that a joint moves at most where it is not written


def write_glb(motion: Motion, path: Path, form: ExportForm) -> None:
    """Write one animation of the actor's joints and of all cameras, at the motion's own timestamps.

    The actor's file, or that of another rig which the user named, is taken over whole: names, hierarchy, bind matrices,
    materials and whatever else it holds; only its own animations give way. Joints that do not stand where a rigid bone
    would put them (a shoulder whose collar bone the file does not have) are moved too.
    """
    rig = actor_rig(motion, form)
    content = copy.deepcopy(rig.document.content)
    buffer = GlbBuffer(content, _merged(rig.document, content))
    clip = _Clip(buffer, motion.timestamps)
    for joint, node in enumerate(rig.joints):
        _bare(content["nodes"][node], rig.scales[joint])
        clip.rotate(node, rig.rotations[:, joint])
        clip.move(node, content["nodes"][node], rig.translations[:, joint])
    _add_cameras(content, clip, motion)
    contacts = motion.contacts
    note = {
        "units": "m",
        "up": "+y",
        "frame_rate": form.frame_rate,
        "start": float(motion.timestamps[0]),
        "frames": motion.frames.tolist(),
        "status": motion.status.tolist(),
        "contacts": None if contacts is None else [contact._asdict() for contact in contacts],
        "rig": rig.whose,
        "mesh_off_by": rig.off,
    }
    name = str(motion.provenance.get("capture_name") or motion.character.name)
    content["animations"] = [{"name": name, **clip.tables(), "extras": {"jaxmocap": note}}]
    content["asset"] = {**content["asset"], "generator": "jaxmocap"}
    content |= buffer.tables()
    path.write_bytes(glb_bytes(content, bytes(buffer.data)))


class _Clip:
    """The channels and samplers of one animation."""

    def __init__(self, buffer: GlbBuffer, timestamps: Float[np.ndarray, " frame"]):
        self._buffer, self._channels, self._samplers = buffer, [], []
        self._times = buffer.add(timestamps.astype("<f4")[:, None], bounds=True)

    def rotate(self, node: int, matrices: Float[np.ndarray, "frame 3 3"]) -> None:
        self._add(node, "rotation", quaternions(matrices))

    def move(self, node: int, content: dict[str, Any], places: Float[np.ndarray, "frame 3"]) -> None:
        """Write places where the node does not stay where it stands at rest."""
        if np.abs(places - np.array(content.get("translation", [0.0, 0.0, 0.0]))).max() > _STILL:
            self._add(node, "translation", places)

    def _add(self, node: int, path: str, values: np.ndarray) -> None:
        output = self._buffer.add(np.ascontiguousarray(values, "<f4"))
        self._channels.append({"sampler": len(self._samplers), "target": {"node": node, "path": path}})
        self._samplers.append({"input": self._times, "output": output, "interpolation": "LINEAR"})

    def tables(self) -> dict[str, Any]:
        return {"channels": self._channels, "samplers": self._samplers}


def quaternions(matrices: Float[np.ndarray, "frame 3 3"]) -> Float[np.ndarray, "frame 4"]:
    """Convert to x y z w, each on the side of the one before, so that nothing in between turns the long way round."""
    found = Rotation.from_matrix(matrices).as_quat()
    turns = np.sum(found[1:] * found[:-1], axis=1) < 0
    return found * np.concatenate([[1.0], np.cumprod(np.where(turns, -1.0, 1.0))])[:, None]


def _bare(node: dict[str, Any], scales: Float[np.ndarray, "3"]) -> None:
    """Split a joint into translation, rotation and scale, as animated nodes must be; the pose it rests in stays."""
    if "matrix" in node:
        matrix = np.array(node.pop("matrix"), np.float64).reshape(4, 4).T
        scale = np.linalg.norm(matrix[:3, :3], axis=0)
        node["translation"] = matrix[:3, 3].tolist()
        node["rotation"] = Rotation.from_matrix(matrix[:3, :3] / scale).as_quat().tolist()
        node["scale"] = scale.tolist()
    if np.abs(scales / np.array(node.get("scale", [1.0, 1.0, 1.0])) - 1).max() > 1e-5:
        node["scale"] = scales.tolist()


def _add_cameras(content: dict[str, Any], clip: _Clip, motion: Motion) -> None:
    """Add a perspective camera per view.

    What glTF has no place for (the principal point, the distortion of the videos as recorded) is in its extras.
    """
    if motion.cameras is None:
        return
    cameras = motion.cameras
    world_from_cam = np.linalg.inv(np.asarray(cameras.cam_from_world, np.float64))
    listed, nodes = content.setdefault("cameras", []), content["nodes"]
    scene = content.setdefault("scenes", [{"nodes": []}])[content.get("scene", 0)]
    for index, (name, (width, height)) in enumerate(zip(cameras.names, cameras.sizes, strict=True)):
        k = np.asarray(cameras.intrinsics[index], np.float64)
        distortion = np.asarray(cameras.distortion[index], np.float64)
        lens = {
            "yfov": 2 * float(np.arctan2(height, 2 * k[1, 1])),
            "aspectRatio": float(width * k[1, 1] / (height * k[0, 0])),
            "znear": _NEAR,
            "zfar": _FAR,
        }
        extras = {
            "size": [width, height],
            "intrinsics": k.tolist(),
            "principal_point_off_centre": [float(k[0, 2] - width / 2), float(k[1, 2] - height / 2)],
            "distortion_of_recording": distortion.tolist(),
        }
        rotations = world_from_cam[index, :, :3, :3] @ GL_FROM_CV
        places = world_from_cam[index, :, :3, 3]
        node = {"name": name, "translation": places[0].tolist(), "rotation": quaternions(rotations[:1])[0].tolist()}
        scene.setdefault("nodes", []).append(len(nodes))
        nodes.append({**node, "camera": len(listed)})
        listed.append({"name": name, "type": "perspective", "perspective": lens, "extras": {"jaxmocap": extras}})
        clip.rotate(len(nodes) - 1, rotations)
        clip.move(len(nodes) - 1, node, places)


def _merged(document: Document, content: dict[str, Any]) -> bytes:
    """Merge all buffers into one, and take in images that lie beside the file; `content` is changed to match."""
    data = b""
    starts = []
    for number in range(len(content.get("buffers", []))):
        starts.append(len(data))
        data += document.buffer(number)
        data += b"\0" * (-len(data) % 4)
    for view in content.get("bufferViews", []):
        view["byteOffset"] = view.get("byteOffset", 0) + starts[view["buffer"]]
        view["buffer"] = 0
    for image in content.get("images", []):
        uri = image.get("uri", "")
        if not uri or uri.startswith("data:"):
            continue
        pixels = document.uri(uri)
        del image["uri"]
        image["mimeType"] = "image/png" if pixels[:4] == b"\x89PNG" else "image/jpeg"
        image["bufferView"] = len(content["bufferViews"])
        content["bufferViews"].append({"buffer": 0, "byteOffset": len(data), "byteLength": len(pixels)})
        data += pixels + b"\0" * (-len(pixels) % 4)
    return data
