"""Reading the clip of a glTF file: of its skin, or of its nodes where there is no mesh."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation, Slerp

from jaxmocap._results import InputError
from jaxmocap.character import Document, local_matrix, parents_first, parents_of, read_rig, rig_of

from ._clip import JointClip, meshless


def read_glb(path: Path, mapping: str | Path | Mapping[str, str] | None, animation: str | None) -> JointClip:
    """Read the animation of this name, or the first one, at the times of all its keys."""
    document = Document(path)
    try:
        return _read(document, mapping, animation)
    except InputError:
        raise
    except (TypeError, ValueError, AttributeError, IndexError, KeyError, OverflowError, np.linalg.LinAlgError) as error:
        document.fail(f"is not well-formed glTF ({type(error).__name__}: {error}); export it again")


def _read(document: Document, mapping: str | Path | Mapping[str, str] | None, animation: str | None) -> JointClip:
    nodes = document.content.get("nodes", [])
    parents = parents_of(nodes)
    if document.content.get("skins"):
        raw, rig = read_rig(document, mapping)
    else:
        still = _worlds([local_matrix(node)[None] for node in nodes], parents)[0]
        names = [str(node.get("name", f"joint_{number}")) for number, node in enumerate(nodes)]
        raw = meshless(names, parents, still)
        rig = rig_of(document, raw, still, mapping)
    chosen = _chosen(document, animation)
    samplers = chosen["samplers"]
    channels = [c for c in chosen["channels"] if c["target"].get("path") in ("translation", "rotation", "scale")]
    channels = [c for c in channels if c["target"].get("node") is not None]
    inputs = {c["sampler"]: document.array(samplers[c["sampler"]]["input"])[:, 0].astype(float) for c in channels}
    if not inputs:
        document.fail("has an animation that moves no node; export it again with its joints")
    times = np.unique(np.concatenate(list(inputs.values())))
    if not (np.isfinite(times).all() and all((np.diff(keys) > 0).all() for keys in inputs.values())):
        document.fail("has an animation whose times do not increase; the file is damaged")
    moved: dict[int, dict[str, np.ndarray]] = {}
    for channel in channels:
        document.item("nodes", channel["target"]["node"])
        target, sampler = channel["target"], samplers[channel["sampler"]]
        keys, values = inputs[channel["sampler"]], document.array(sampler["output"]).astype(float)
        kind = sampler.get("interpolation", "LINEAR")
        if kind == "CUBICSPLINE":
            values = values.reshape(len(keys), 3, -1)[:, 1]  # in-tangent, value, out-tangent
        values = _at(times, keys, values, target["path"] == "rotation", kind == "STEP")
        moved.setdefault(target["node"], {})[target["path"]] = values
    local = [_local(node, moved.get(number, {}), len(times)) for number, node in enumerate(nodes)]
    worlds = _worlds(local, parents)[:, list(raw.joint_nodes)]
    return JointClip(rig, worlds, times, "y")


def _chosen(document: Document, name: str | None) -> dict[str, Any]:
    animations = document.content.get("animations", [])
    if not animations:
        document.fail("holds no animation; export it again with its clip")
    names = [str(animation.get("name", "")) for animation in animations]
    if name is not None and name not in names:
        document.fail(f"has no animation named {name!r}; it has {', '.join(names)}")
    return animations[0 if name is None else names.index(name)]


def _at(
    times: np.ndarray, keys: np.ndarray, values: np.ndarray, rotation: bool, steps: bool
) -> Float[np.ndarray, "frame width"]:
    within = np.clip(times, keys[0], keys[-1])
    if steps or len(keys) == 1:
        return values[np.searchsorted(keys, within, side="right") - 1]
    if rotation:
        return Slerp(keys, Rotation.from_quat(values))(within).as_quat()
    return np.stack([np.interp(within, keys, column) for column in values.T], axis=1)


def _local(node: dict[str, Any], moved: dict[str, np.ndarray], count: int) -> Float[np.ndarray, "frame 4 4"]:
    if not moved:
        return np.broadcast_to(local_matrix(node), (count, 4, 4))
    whole = np.tile(np.eye(4), (count, 1, 1))
    turns = moved.get("rotation", np.array([node.get("rotation", [0.0, 0.0, 0.0, 1.0])]))
    scales = moved.get("scale", np.array([node.get("scale", [1.0, 1.0, 1.0])]))
    whole[:, :3, :3] = Rotation.from_quat(turns).as_matrix() * scales[:, None, :]
    whole[:, :3, 3] = moved.get("translation", np.array([node.get("translation", [0.0, 0.0, 0.0])]))
    return whole


def _worlds(local: list[np.ndarray], parents: list[int]) -> Float[np.ndarray, "frame node 4 4"]:
    worlds = np.stack(local, axis=1)
    for node in parents_first(parents):
        if parents[node] >= 0:
            worlds[:, node] = worlds[:, parents[node]] @ worlds[:, node]
    return worlds
