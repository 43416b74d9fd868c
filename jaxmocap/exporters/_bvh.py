"""BVH: joints and their Euler angles, one joint per body or those of somebody else's rig."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxmocap._files import write_text
from jaxmocap.motion import Motion

from ._exporter import ExportForm
from ._prepare import UPRIGHT, best_order, euler_angles
from ._retarget import retargeted

_SHORTEST_TIP = 0.05


class _Tree(NamedTuple):
    """The joints to write, the first one the root: their rest places, what they move, and the mesh at rest."""

    names: tuple[str, ...]
    parents: tuple[int, ...]
    joints: Float[np.ndarray, "joint 3"]
    transforms: Float[np.ndarray, "frame joint 4 4"]
    vertices: Float[np.ndarray, "vertex 3"]
    weights: Float[np.ndarray, "vertex joint"]


def write_bvh(motion: Motion, path: Path, form: ExportForm) -> None:
    """Write the skeleton of the tracked body, or of the rig that the user named, and its Euler angles.

    The root joint (`pelvis`, if it is ours) moves by its position in the world; every joint turns in the order of axes
    that keeps it farthest from gimbal lock. All angles at zero are the rest pose of the actor, or of the rig, upright,
    facing z (y, towards -y, where z is up). Tips are the farthest points of the mesh.

    The format has no place for units and axes: lengths and the vertical axis are those that were asked for.
    """
    upright = UPRIGHT[form.up]
    tree = _tree(motion, form)
    rotations = tree.transforms[:, :, :3, :3] @ upright.T
    root = tree.transforms[:, 0, :3, :3] @ tree.joints[0] + tree.transforms[:, 0, :3, 3]
    columns = [form.per_metre * root]
    lines = ["HIERARCHY"]

    def write(joint: int, depth: int) -> None:
        parent = tree.parents[joint]
        turn = rotations[:, joint] if parent < 0 else rotations[:, parent].swapaxes(1, 2) @ rotations[:, joint]
        order = best_order(turn)
        offset = np.zeros(3) if parent < 0 else tree.joints[joint] - tree.joints[parent]
        channels = " ".join(f"{axis}rotation" for axis in order)
        columns.append(np.degrees(euler_angles(turn, order)))
        indent = "\t" * depth
        lines.append(f"{indent}{'ROOT' if parent < 0 else 'JOINT'} {'_'.join(tree.names[joint].split())}")
        lines.append(f"{indent}{{")
        lines.append(f"{indent}\tOFFSET {_numbers(form.per_metre * upright @ offset)}")
        place = "Xposition Yposition Zposition " if parent < 0 else ""
        lines.append(f"{indent}\tCHANNELS {6 if place else 3} {place}{channels}")
        children = [child for child, above in enumerate(tree.parents) if above == joint]
        for child in children:
            write(child, depth + 1)
        if not children:
            tip = form.per_metre * upright @ _tip(tree, joint)
            lines.extend(
                (f"{indent}\tEnd Site", f"{indent}\t{{", f"{indent}\t\tOFFSET {_numbers(tip)}", f"{indent}\t}}")
            )
        lines.append(f"{indent}}}")

    write(0, 0)
    rate = form.frame_rate or 30.0
    lines += ["MOTION", f"Frames: {len(motion)}", f"Frame Time: {1 / rate:.9g}"]
    lines += [_numbers(row) for row in np.concatenate(columns, axis=1)]
    write_text(path, "\n".join(lines) + "\n")


def _tree(motion: Motion, form: ExportForm) -> _Tree:
    """Take the joints of the tracked body, or of the rig that is named."""
    if form.rig is not None:
        found = retargeted(motion, form)
        form.say(found.told)
        rest = found.rest_from_joint[:, :3, 3]
        return _Tree(found.names, found.parents, rest, found.world_from_rest, found.vertices, found.weights)
    character, skeleton = motion.character, motion.character.skeleton
    joints, transforms = skeleton.joints.astype(np.float64), motion.body_transforms.astype(np.float64)
    vertices, weights = np.asarray(character.vertices, np.float64), np.asarray(character.weights)
    return _Tree(skeleton.body_names, skeleton.parents, joints, transforms, vertices, weights)


def _tip(tree: _Tree, joint: int) -> np.ndarray:
    """Find the way from a joint to the farthest vertex that mostly follows it."""
    own = tree.vertices[tree.weights[:, joint] > 0.5] - tree.joints[joint]
    lengths = np.linalg.norm(own, axis=1)
    if not len(own) or lengths.max() < _SHORTEST_TIP:
        return np.array([0.0, -_SHORTEST_TIP, 0.0])
    return own[lengths.argmax()]


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{value:.6f}" for value in values)
