"""Rigs of other people, made of our own bodies: other names, proportions, units and axes of the joints."""

from pathlib import Path

import numpy as np
from humanoid_glb import MIXAMO, UNREAL, Humanoid, boxes, pack, unpack, write_glb
from scipy.spatial.transform import Rotation

from jaxmocap.character import Character

BODIES = {"pelvis": "hips", "abdomen": "spine", "chest": "spine1", "head": "neck"}
BODIES |= {"clavicle": "shoulder", "upper_arm": "arm", "forearm": "forearm", "hand": "hand"}
BODIES |= {"thigh": "upleg", "shank": "leg", "foot": "foot"}
ARMATURE = np.array([[0.01, 0, 0, 0], [0, 0, 0.01, 0], [0, -0.01, 0, 0], [0, 0, 0, 1]])
"""Above joints in centimetres that lie along z."""


def named(body: str, scheme: dict[str, str] = MIXAMO) -> str:
    """What a scheme calls one of our bodies."""
    side, base = (body[0], body[2:]) if body[:2] in ("l_", "r_") else ("", body)
    return scheme[BODIES[base]].format(Side={"l": "Left", "r": "Right", "": ""}[side], S=side.upper(), s=side)


def renamed(character: Character, path: Path, scheme: dict[str, str] = MIXAMO) -> Path:
    """A character's own file under the names of a scheme."""
    document, binary = unpack(character.save_glb(path))
    for node in document["nodes"][: len(character.skeleton.body_names)]:
        node["name"] = named(node["name"], scheme)
    return pack(path, document, binary)


def stranger(path: Path, scheme: dict[str, str] = MIXAMO, thigh: float = 0.08, arm: float = -0.04) -> Path:
    """A box figure in a T-pose, its thighs longer, its arms shorter: in centimetres, lying, joints turned anyhow."""
    body = Humanoid()
    bases = [name[2:] if name[:2] in ("l_", "r_") else name for name in body.names]
    shift = np.zeros_like(body.places)
    for number, (name, base) in enumerate(zip(body.names, bases, strict=True)):
        out = {"forearm": 1.0}.get(base, 2.0 if base in ("hand", "index", "middle", "thumb") else 0.0)
        shift[number] = [(-1 if name[0] == "r" else 1) * arm * out, 0 if base in ("leg", "foot", "toe") else thigh, 0]
    ends = body.vertices.reshape(-1, 8, 3)[:, 4:].mean(axis=1)
    for number, end in enumerate(ends.copy()):
        children = [c for c, parent in enumerate(body.parents) if parent == number]
        child = next((c for c in children if np.allclose(body.places[c], end, atol=1e-6)), number)
        ends[number] = end + shift[child]
    places = body.places + shift
    vertices, faces, _ = boxes(places, ends)
    stand = lambda points: 100 * points @ np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # noqa: E731
    names = body.renamed(scheme)
    write_glb(path, names, body.parents, stand(places), stand(vertices), faces, body.weights, ARMATURE)
    return with_axes_anywhere(path)


def with_axes_anywhere(path: Path) -> Path:
    """The same skin whose joints' own axes point anywhere."""
    document, binary = unpack(path)
    joints = document["skins"][0]["joints"]
    turns = Rotation.random(len(joints), random_state=3).as_matrix()
    accessor = document["accessors"][document["skins"][0]["inverseBindMatrices"]]
    start = document["bufferViews"][accessor["bufferView"]]["byteOffset"]
    data = bytearray(binary)
    binds = np.frombuffer(data, "<f4", 16 * len(joints), start).reshape(-1, 4, 4)
    binds[:, :, :3] = binds[:, :, :3] @ turns.astype("<f4")  # glTF matrices are stored by columns
    for number, node in enumerate(joints):
        matrix = np.eye(4)
        parent = next((k for k, n in enumerate(joints) if node in document["nodes"][n].get("children", [])), None)
        above = np.eye(3) if parent is None else turns[parent]
        matrix[:3, :3] = above.T @ turns[number]
        matrix[:3, 3] = above.T @ document["nodes"][node].pop("translation")
        document["nodes"][node]["matrix"] = matrix.T.ravel().tolist()
    return pack(path, document, bytes(data))


__all__ = ["MIXAMO", "UNREAL", "named", "renamed", "stranger"]
