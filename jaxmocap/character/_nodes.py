"""The nodes of a glTF document: who is whose parent, and where each stands in it."""

from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation


def parents_of(nodes: list[dict[str, Any]]) -> list[int]:
    """The number of each node's parent, or -1."""
    parents = [-1] * len(nodes)
    for number, node in enumerate(nodes):
        for child in node.get("children", []):
            parents[child] = number
    return parents


def parents_first(parents: list[int]) -> list[int]:
    """All nodes, in an order in which parents precede children."""
    order = [node for node, parent in enumerate(parents) if parent < 0]
    for node in order:
        order.extend(child for child, parent in enumerate(parents) if parent == node)
    return order


def local_matrix(node: dict[str, Any]) -> Float[np.ndarray, "4 4"]:
    """The transform of a node in its parent."""
    if node.get("matrix"):
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    matrix = np.eye(4)
    rotation = node.get("rotation")
    if rotation is not None and np.any(rotation):
        matrix[:3, :3] = Rotation.from_quat(rotation).as_matrix()
    matrix[:3, :3] *= np.array(node.get("scale") or [1.0, 1.0, 1.0])
    matrix[:3, 3] = node.get("translation") or [0.0, 0.0, 0.0]
    return matrix
