"""A box figure of known proportions, and its GLB written by hand: what the loading tests read."""

import json
import struct
from pathlib import Path

import numpy as np

# name: (parent, place in a T-pose, metres, x = subject's left, y up, z forward; left side only for limbs)
TRUNK = {
    "hips": (None, (0.0, 0.95, 0.0)),
    "spine": ("hips", (0.0, 1.05, -0.02)),
    "spine1": ("spine", (0.0, 1.17, -0.02)),
    "spine2": ("spine1", (0.0, 1.30, -0.02)),
    "neck": ("spine2", (0.0, 1.48, 0.0)),
    "head": ("neck", (0.0, 1.57, 0.02)),
}
LIMB = {
    "shoulder": ("spine2", (0.05, 1.42, 0.02)),
    "arm": ("shoulder", (0.18, 1.42, 0.0)),
    "forearm": ("arm", (0.46, 1.42, 0.0)),
    "hand": ("forearm", (0.71, 1.42, 0.0)),
    "index": ("hand", (0.80, 1.42, 0.03)),
    "middle": ("hand", (0.80, 1.42, 0.0)),
    "thumb": ("hand", (0.75, 1.42, 0.04)),
    "upleg": ("hips", (0.10, 0.90, 0.0)),
    "leg": ("upleg", (0.10, 0.50, 0.01)),
    "foot": ("leg", (0.10, 0.08, 0.0)),
    "toe": ("foot", (0.10, 0.02, 0.14)),
}
TIPS = {
    "head": (0.0, 1.74, 0.02),
    "index": (0.88, 1.42, 0.03),
    "middle": (0.89, 1.42, 0.0),
    "thumb": (0.79, 1.42, 0.07),
}
TIPS |= {"hand": (0.80, 1.42, 0.0), "foot": (0.10, 0.01, 0.12), "toe": (0.10, 0.01, 0.20)}
MIXAMO = {
    **{"hips": "mixamorig:Hips", "spine": "mixamorig:Spine", "spine1": "mixamorig:Spine1"},
    **{"spine2": "mixamorig:Spine2", "neck": "mixamorig:Neck", "head": "mixamorig:Head"},
    **{"shoulder": "mixamorig:{Side}Shoulder", "arm": "mixamorig:{Side}Arm", "forearm": "mixamorig:{Side}ForeArm"},
    **{"hand": "mixamorig:{Side}Hand", "index": "mixamorig:{Side}HandIndex1", "middle": "mixamorig:{Side}HandMiddle1"},
    **{"thumb": "mixamorig:{Side}HandThumb1", "upleg": "mixamorig:{Side}UpLeg", "leg": "mixamorig:{Side}Leg"},
    **{"foot": "mixamorig:{Side}Foot", "toe": "mixamorig:{Side}ToeBase"},
}
VRM = {
    **{"hips": "J_Bip_C_Hips", "spine": "J_Bip_C_Spine", "spine1": "J_Bip_C_Chest", "spine2": "J_Bip_C_UpperChest"},
    **{"neck": "J_Bip_C_Neck", "head": "J_Bip_C_Head", "shoulder": "J_Bip_{S}_Shoulder", "arm": "J_Bip_{S}_UpperArm"},
    **{"forearm": "J_Bip_{S}_LowerArm", "hand": "J_Bip_{S}_Hand", "index": "J_Bip_{S}_Index1"},
    **{"middle": "J_Bip_{S}_Middle1", "thumb": "J_Bip_{S}_Thumb1", "upleg": "J_Bip_{S}_UpperLeg"},
    **{"leg": "J_Bip_{S}_LowerLeg", "foot": "J_Bip_{S}_Foot", "toe": "J_Bip_{S}_ToeBase"},
}
UNREAL = {
    **{"hips": "pelvis", "spine": "spine_01", "spine1": "spine_02", "spine2": "spine_03", "neck": "neck_01"},
    **{"head": "head", "shoulder": "clavicle_{s}", "arm": "upperarm_{s}", "forearm": "lowerarm_{s}"},
    **{"hand": "hand_{s}", "index": "index_01_{s}", "middle": "middle_01_{s}", "thumb": "thumb_01_{s}"},
    **{"upleg": "thigh_{s}", "leg": "calf_{s}", "foot": "foot_{s}", "toe": "ball_{s}"},
}
ROCKETBOX = {
    **{"hips": "Bip01 Pelvis", "spine": "Bip01 Spine", "spine1": "Bip01 Spine1", "spine2": "Bip01 Spine2"},
    **{"neck": "Bip01 Neck", "head": "Bip01 Head", "shoulder": "Bip01 {S} Clavicle", "arm": "Bip01 {S} UpperArm"},
    **{"forearm": "Bip01 {S} Forearm", "hand": "Bip01 {S} Hand", "index": "Bip01 {S} Finger1"},
    **{"middle": "Bip01 {S} Finger2", "thumb": "Bip01 {S} Finger0", "upleg": "Bip01 {S} Thigh"},
    **{"leg": "Bip01 {S} Calf", "foot": "Bip01 {S} Foot", "toe": "Bip01 {S} Toe0"},
}
MAKEHUMAN = {
    **{"hips": "root", "spine": "spine05", "spine1": "spine03", "spine2": "spine01", "neck": "neck01", "head": "head"},
    **{"shoulder": "clavicle.{S}", "arm": "upperarm01.{S}", "forearm": "lowerarm01.{S}", "hand": "wrist.{S}"},
    **{"index": "finger2-1.{S}", "middle": "finger3-1.{S}", "thumb": "finger1-1.{S}", "upleg": "upperleg01.{S}"},
    **{"leg": "lowerleg01.{S}", "foot": "foot.{S}", "toe": "toe1-1.{S}"},
}
SMPL = {
    **{"hips": "Pelvis", "spine": "Spine1", "spine1": "Spine2", "spine2": "Spine3", "neck": "Neck", "head": "Head"},
    **{"shoulder": "{S}_Collar", "arm": "{S}_Shoulder", "forearm": "{S}_Elbow", "hand": "{S}_Wrist"},
    **{"index": "{S}_Index1", "middle": "{S}_Hand", "thumb": "{S}_Thumb1", "upleg": "{S}_Hip", "leg": "{S}_Knee"},
    **{"foot": "{S}_Ankle", "toe": "{S}_Foot"},
}
NAMES = {"mixamo": MIXAMO, "vrm": VRM, "unreal": UNREAL, "rocketbox": ROCKETBOX, "makehuman": MAKEHUMAN, "smpl": SMPL}


class Humanoid:
    """Joints and a mesh of one box per joint, each bound wholly to its joint; left and right are mirror images."""

    def __init__(self, drop: tuple[str, ...] = ()):
        table = {name: row for name, row in TRUNK.items() if name not in drop}
        limbs = {name: row for name, row in LIMB.items() if name not in drop}
        parent_of = {name: parent for name, (parent, _) in {**TRUNK, **LIMB}.items()}

        def kept(parent: str | None) -> str | None:
            while parent in drop:
                parent = parent_of[parent]
            return parent

        self.names, self.parents, self.places, tips = [], [], [], []
        for name, (parent, place) in table.items():
            self._add(name, kept(parent), place)
        for side, sign in (("l", 1.0), ("r", -1.0)):
            for name, (parent, place) in limbs.items():
                above = kept(parent)
                above = above if above in table else f"{side}_{above}"
                self._add(f"{side}_{name}", above, (sign * place[0], *place[1:]))
        self.places = np.array(self.places)
        for number, name in enumerate(self.names):
            sign = -1.0 if name.startswith("r_") else 1.0
            base = name[2:] if name[:2] in ("l_", "r_") else name
            children = [self.places[c] for c, parent in enumerate(self.parents) if parent == number]
            if base in TIPS:
                tips.append(np.array(TIPS[base]) * [sign, 1, 1])
            else:
                tips.append(next((c for c in children if abs(c[0]) < 0.01 or base not in TRUNK), children[0]))
        self.vertices, self.faces, self.bone = boxes(self.places, np.array(tips))
        self.weights = np.eye(len(self.names))[self.bone]

    def _add(self, name: str, parent: str | None, place: tuple[float, ...]) -> None:
        self.names.append(name)
        self.parents.append(-1 if parent is None else self.names.index(parent))
        self.places.append(place)

    def renamed(self, scheme: dict[str, str]) -> list[str]:
        """The joints' names in a naming scheme."""
        out = []
        for name in self.names:
            side, base = (name[0], name[2:]) if name[:2] in ("l_", "r_") else ("", name)
            out.append(scheme[base].format(Side={"l": "Left", "r": "Right", "": ""}[side], S=side.upper(), s=side))
        return out


def boxes(starts: np.ndarray, ends: np.ndarray, half: float = 0.035) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A closed box around every segment; its cross axes are world axes, so mirrored segments give mirrored boxes."""
    corners = np.array([(a, b, c) for a in (0, 1) for b in (-1, 1) for c in (-1, 1)], dtype=float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    vertices, faces, bone = [], [], []
    for number, (start, end) in enumerate(zip(starts, ends, strict=True)):
        main = int(np.argmax(np.abs(end - start)))
        across = np.eye(3)[[axis for axis in range(3) if axis != main]]
        points = start + corners[:, :1] * (end - start) + half * corners[:, 1:] @ across
        flip = np.linalg.det(np.stack([end - start, *across])) < 0
        vertices.append(points)
        faces.append((triangles[:, ::-1] if flip else triangles) + 8 * number)
        bone += [number] * 8
    return np.concatenate(vertices), np.concatenate(faces), np.array(bone)


def write_glb(
    path: Path,
    names: list[str],
    parents: list[int],
    places: np.ndarray,
    vertices: np.ndarray,
    faces: np.ndarray,
    weights: np.ndarray,
    armature: np.ndarray | None = None,
    weight_type: str = "f4",
) -> Path:
    """A skinned GLB. `armature` is the transform of a node above the skeleton, as exporters add for units and axes."""
    order = np.argsort(-weights, axis=1)[:, :4]
    values = np.take_along_axis(weights, order, axis=1)
    if weight_type != "f4":
        values = np.round(values * np.iinfo(weight_type).max)
    binds = np.tile(np.eye(4), (len(places), 1, 1))
    binds[:, :3, 3] = -places
    arrays = [
        (vertices.astype("<f4"), "VEC3", 5126, False),
        (faces.reshape(-1).astype("<u2"), "SCALAR", 5123, False),
        (order.astype("<u2"), "VEC4", 5123, False),
        (
            values.astype(f"<{weight_type}"),
            "VEC4",
            {"f4": 5126, "u1": 5121, "u2": 5123}[weight_type],
            weight_type != "f4",
        ),
        (binds.transpose(0, 2, 1).reshape(-1, 16).astype("<f4"), "MAT4", 5126, False),
    ]
    binary, views, accessors = b"", [], []
    for array, kind, component, normalized in arrays:
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": array.nbytes})
        accessor = {"bufferView": len(views) - 1, "componentType": component, "count": len(array), "type": kind}
        accessors.append({**accessor, "normalized": True} if normalized else accessor)
        binary += array.tobytes() + b"\0" * (-array.nbytes % 4)
    nodes = []
    for number, name in enumerate(names):
        origin = places[parents[number]] if parents[number] >= 0 else np.zeros(3)
        node = {"name": name, "translation": (places[number] - origin).tolist()}
        children = [child for child, parent in enumerate(parents) if parent == number]
        nodes.append({**node, "children": children} if children else node)
    roots = [number for number, parent in enumerate(parents) if parent < 0]
    above = np.eye(4) if armature is None else armature
    nodes.append({"name": "armature", "children": roots, "matrix": above.T.ravel().tolist()})
    nodes.append({"name": "body", "mesh": 0, "skin": 0})
    attributes = {"POSITION": 0, "JOINTS_0": 2, "WEIGHTS_0": 3}
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [len(names), len(names) + 1]}],
        "nodes": nodes,
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 1}]}],
        "skins": [{"joints": list(range(len(names))), "inverseBindMatrices": 4}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(binary)}],
    }
    return pack(path, document, binary)


def pack(path: Path, document: dict, binary: bytes) -> Path:
    """The GLB container of a JSON document and its buffer."""
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942) + binary
    path.write_bytes(struct.pack("<III", 0x46546C67, 2, 12 + len(body)) + body)
    return path


def unpack(path: Path) -> tuple[dict, bytes]:
    """The JSON document and the buffer of a GLB."""
    data = path.read_bytes()
    size = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + size]), data[20 + size + 8 :]
