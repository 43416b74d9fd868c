"""From a glTF document to one raw skinned mesh: vertices, faces, weights per file joint, and the joints themselves."""

from typing import Any, NamedTuple

import numpy as np

from ._gltf import Document, local_matrix

_MOST_JOINTS = 1000


class RawSkin(NamedTuple):
    """A skinned mesh as the file has it, in metres: orientation and joints are still the file's own."""

    vertices: np.ndarray  # (V, 3)
    faces: np.ndarray  # (F, 3)
    weights: np.ndarray  # (V, J)
    joint_names: tuple[str, ...]
    joint_parents: tuple[int, ...]  # nearest ancestor that is a joint, or -1
    joint_places: np.ndarray  # (J, 3) in the rest pose of the mesh
    extras: dict[str, Any]
    joint_nodes: tuple[int, ...]  # numbers of the joints among the file's nodes
    place: np.ndarray  # (4, 4) metres from the mesh's space
    inverse_binds: np.ndarray  # (J, 4, 4) a joint's space from the mesh's, in the rest pose


def read_skin(document: Document) -> RawSkin:
    """Read the skin with the most vertices and all others that share joints with it, as exporters write one for hair,
    face and every piece of clothing; raise `InputError` where there is none."""
    gltf = document.gltf
    if not gltf.meshes:
        document.fail("holds no mesh; a skinned mesh of a person is needed")
    if not gltf.skins:
        document.fail("holds a mesh but no skin; rig it first with `jaxmocap rig MESH --out FILE.glb`")
    users: dict[int, list[int]] = {}
    for node in gltf.nodes or []:
        if node.mesh is not None and node.skin is not None:
            users.setdefault(node.skin, []).append(node.mesh)
    if not users:
        document.fail("has a skin that no mesh uses; rig the mesh first with `jaxmocap rig MESH --out FILE.glb`")
    merged = {skin: _merge(document, skin, meshes) for skin, meshes in users.items()}
    skin_index = max(merged, key=lambda skin: len(merged[skin][0]))
    skin = document.item("skins", skin_index)
    parents, worlds = _hierarchy(document)
    joints, inverse_binds, (vertices, faces, weights) = _joined(document, merged, skin_index)
    joint_worlds = worlds[joints]
    if not np.all(np.isfinite(joint_worlds)) or np.abs(joint_worlds).max() > 1e9:
        document.fail("has node transforms that are not finite; the file is damaged, export it again")
    place = _displayed(joint_worlds, inverse_binds)
    with np.errstate(all="ignore"):
        binds = np.linalg.inv(inverse_binds)
    joint_places = _carry(place, binds[:, :3, 3])
    if not np.all(np.isfinite(joint_places)):
        document.fail("has inverse bind matrices that are not finite; the file is damaged, export it again")
    order = {node: number for number, node in enumerate(joints)}
    return RawSkin(
        vertices=_carry(place, vertices),
        faces=faces,
        weights=weights,
        joint_names=tuple(gltf.nodes[node].name or f"joint_{node}" for node in joints),
        joint_parents=tuple(_joint_parent(node, parents, order) for node in joints),
        joint_places=joint_places,
        extras=skin.extras or {},
        joint_nodes=tuple(joints),
        place=place,
        inverse_binds=inverse_binds,
    )


_Parts = tuple[np.ndarray, np.ndarray, np.ndarray]  # vertices, faces, weights


def _joined(document: Document, parts: dict[int, _Parts], main: int) -> tuple[list[int], np.ndarray, _Parts]:
    """Join to the skin `main` those that share a joint with it, or with one that does.

    Returns joint nodes, inverse bind matrices from the main mesh's space, and the mesh. Where a shared joint stands in
    the rest pose of both meshes tells how their spaces lie to each other.
    """
    joints, inverse_binds = _joints(document, main)
    vertices, faces, weights = parts[main]
    left = sorted((skin for skin in parts if skin != main), key=lambda skin: -len(parts[skin][0]))
    while True:
        skin = next((skin for skin in left if set(document.item("skins", skin).joints) & set(joints)), None)
        if skin is None:
            return joints, inverse_binds, (vertices, faces, weights)
        left.remove(skin)
        own, own_binds = _joints(document, skin)
        shared = next(node for node in own if node in joints)
        from_main = np.linalg.inv(own_binds[own.index(shared)]) @ inverse_binds[joints.index(shared)]
        new = [node for node in own if node not in joints]
        inverse_binds = np.concatenate([inverse_binds, *[own_binds[[own.index(node)]] @ from_main for node in new]])
        joints = [*joints, *new]
        columns = [joints.index(node) for node in own]
        more_vertices, more_faces, more_weights = parts[skin]
        wide = np.zeros((len(vertices) + len(more_vertices), len(joints)))
        wide[: len(vertices), : weights.shape[1]] = weights
        wide[len(vertices) :, columns] = more_weights
        faces = np.concatenate([faces, more_faces + len(vertices)])
        vertices = np.concatenate([vertices, _carry(np.linalg.inv(from_main), more_vertices)])
        weights = wide


def _joints(document: Document, skin_index: int) -> tuple[list[int], np.ndarray]:
    """Read the nodes of a skin's joints and their inverse bind matrices."""
    skin = document.item("skins", skin_index)
    for node in skin.joints:
        document.item("nodes", node)
    return list(skin.joints), _inverse_binds(document, skin)


def _merge(document: Document, skin_index: int, meshes: list[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    num_joints = len(document.item("skins", skin_index).joints or [])
    if num_joints == 0:
        document.fail("has a skin without joints; export the model again with its armature")
    if num_joints > _MOST_JOINTS:
        document.fail(f"has a skin of {num_joints} joints, at most {_MOST_JOINTS} are supported; simplify the armature")
    parts, start = [], 0
    for mesh in meshes:
        for primitive in document.item("meshes", mesh).primitives:
            if primitive.mode not in (None, 4):
                continue
            if (primitive.extensions or {}).get("KHR_draco_mesh_compression"):
                document.fail("is compressed with Draco; export the model without compression")
            part = _primitive(document, primitive, num_joints)
            parts.append((part[0], part[1] + start, part[2]))
            start += len(part[0])
    if not parts or start == 0:
        document.fail("holds a skinned mesh without triangles; a triangle mesh is needed")
    vertices, faces, weights = (np.concatenate(group) for group in zip(*parts, strict=True))
    return vertices, faces, weights


def _doubles(values: np.ndarray) -> np.ndarray:
    """In double precision; damaged ones become what they become without a warning, for they are refused later."""
    with np.errstate(invalid="ignore"):
        return values.astype(np.float64)


def _primitive(document: Document, primitive: Any, num_joints: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    attributes = vars(primitive.attributes)
    if any(attributes.get(name) is None for name in ("POSITION", "JOINTS_0", "WEIGHTS_0")):
        document.fail("has a skinned mesh without positions, joint indices or weights; export it again with its skin")
    vertices = _doubles(document.array(attributes["POSITION"]))
    weights = np.zeros((len(vertices), num_joints))
    rows = np.arange(len(vertices))
    for number in range(8):
        if attributes.get(f"JOINTS_{number}") is None:
            break
        joints = document.array(attributes[f"JOINTS_{number}"]).astype(np.int64)
        influences = _doubles(document.array(attributes.get(f"WEIGHTS_{number}")))
        if not len(joints) == len(influences) == len(vertices):
            document.fail("has joint indices, weights and positions of different lengths; export it again")
        used = np.where(influences != 0, joints, 0)
        if used.max(initial=0) >= num_joints:
            document.fail(f"has weights for joint {used.max()} but the skin has {num_joints} joints; export it again")
        for column in range(joints.shape[1]):
            np.add.at(weights, (rows, used[:, column]), influences[:, column])
    if primitive.indices is None:
        indices = np.arange(len(vertices) // 3 * 3)
    else:
        indices = document.array(primitive.indices)[:, 0].astype(np.int64)
    if len(indices) % 3 or (len(indices) and indices.max() >= len(vertices)):
        document.fail(f"has triangles that point past its {len(vertices)} vertices; the file is damaged")
    return vertices, indices.reshape(-1, 3), weights


def _inverse_binds(document: Document, skin: Any) -> np.ndarray:
    if skin.inverseBindMatrices is None:
        document.fail("has a skin without inverse bind matrices, so its rest pose is unknown; export it again")
    matrices = document.array(skin.inverseBindMatrices)
    if matrices.shape[1] != 16 or len(matrices) < len(skin.joints):
        document.fail(f"has {len(matrices)} inverse bind matrices for {len(skin.joints)} joints; export it again")
    matrices = matrices[: len(skin.joints)].reshape(-1, 4, 4).transpose(0, 2, 1).astype(np.float64)
    if not np.all(np.isfinite(matrices)) or np.any(np.abs(np.linalg.det(matrices)) < 1e-18):
        document.fail("has inverse bind matrices that cannot be inverted; the file is damaged, export it again")
    return matrices


def _hierarchy(document: Document) -> tuple[list[int], np.ndarray]:
    nodes = document.gltf.nodes or []
    parents = [-1] * len(nodes)
    for number, node in enumerate(nodes):
        for child in node.children or []:
            document.item("nodes", child)
            if parents[child] >= 0:
                document.fail(f"has a node with more than one parent (number {child}); it is damaged, export it again")
            parents[child] = number
    worlds = np.zeros((len(nodes), 4, 4))
    for number in range(len(nodes)):
        path, node = [], number
        while node >= 0:
            if node in path:
                document.fail("has nodes that are their own ancestors; the file is damaged, export it again")
            path.append(node)
            node = parents[node]
        world = np.eye(4)
        for node in reversed(path):
            world = world @ local_matrix(document.content["nodes"][node])
        worlds[number] = world
    return parents, worlds


def _displayed(joint_worlds: np.ndarray, inverse_binds: np.ndarray) -> np.ndarray:
    """Find the transform from mesh space to metres.

    When the nodes stand in the bind pose, `joint @ inverse_bind` is the same for all joints and is that transform.
    When they stand in another pose, only its scale is taken: the mesh stays in its bind pose.
    """
    products = joint_worlds @ inverse_binds
    middle = products[0]
    reach = np.abs(np.linalg.inv(inverse_binds)[:, :3, 3]).max() + 1e-9
    spread = (
        np.abs(products[:, :3, :3] - middle[:3, :3]).max() * reach + np.abs(products[:, :3, 3] - middle[:3, 3]).max()
    )
    scale = np.cbrt(abs(np.linalg.det(middle[:3, :3])))
    if spread < 1e-3 * scale * reach:
        return middle
    scales = np.cbrt(np.abs(np.linalg.det(products[:, :3, :3])))
    return np.diag([*np.full(3, np.median(scales)), 1.0])


def _carry(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def _joint_parent(node: int, parents: list[int], order: dict[int, int]) -> int:
    node = parents[node]
    while node >= 0 and node not in order:
        node = parents[node]
    return order.get(node, -1)
