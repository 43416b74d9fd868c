"""BVH: a joint per body and their Euler angles."""

from pathlib import Path

import numpy as np

from jaxmocap._files import write_text
from jaxmocap.motion import Motion

from ._exporter import ExportForm
from ._prepare import UPRIGHT, best_order, euler_angles

_SHORTEST_TIP = 0.05


def write_bvh(motion: Motion, path: Path, form: ExportForm) -> None:
    """Write the skeleton of the tracked body and its Euler angles.

    The root joint `pelvis` moves by its position in the world; every joint turns in the order of axes that keeps it
    farthest from gimbal lock. All angles at zero are the rest pose of the actor, upright, facing z (y, towards -y,
    where z is up). Tips are the farthest points of the mesh.

    The format has no place for units and axes: lengths and the vertical axis are those that were asked for.
    """
    upright = UPRIGHT[form.up]
    bodies = motion.body_transforms.astype(np.float64)
    rotations = bodies[:, :, :3, :3] @ upright.T
    skeleton = motion.character.skeleton
    joints = skeleton.joints.astype(np.float64)
    pelvis = bodies[:, 0, :3, :3] @ joints[0] + bodies[:, 0, :3, 3]
    columns = [form.per_metre * pelvis]
    lines = ["HIERARCHY"]

    def write(body: int, depth: int) -> None:
        parent = skeleton.parents[body]
        turn = rotations[:, body] if parent < 0 else rotations[:, parent].swapaxes(1, 2) @ rotations[:, body]
        order = best_order(turn)
        offset = np.zeros(3) if parent < 0 else joints[body] - joints[parent]
        channels = " ".join(f"{axis}rotation" for axis in order)
        columns.append(np.degrees(euler_angles(turn, order)))
        indent = "\t" * depth
        lines.append(f"{indent}{'ROOT' if parent < 0 else 'JOINT'} {skeleton.body_names[body]}")
        lines.append(f"{indent}{{")
        lines.append(f"{indent}\tOFFSET {_numbers(form.per_metre * upright @ offset)}")
        place = "Xposition Yposition Zposition " if parent < 0 else ""
        lines.append(f"{indent}\tCHANNELS {6 if place else 3} {place}{channels}")
        children = [child for child, above in enumerate(skeleton.parents) if above == body]
        for child in children:
            write(child, depth + 1)
        if not children:
            tip = form.per_metre * upright @ _tip(motion, body, joints[body])
            lines.extend(
                (f"{indent}\tEnd Site", f"{indent}\t{{", f"{indent}\t\tOFFSET {_numbers(tip)}", f"{indent}\t}}")
            )
        lines.append(f"{indent}}}")

    write(0, 0)
    rate = form.frame_rate or 30.0
    lines += ["MOTION", f"Frames: {len(motion)}", f"Frame Time: {1 / rate:.9g}"]
    lines += [_numbers(row) for row in np.concatenate(columns, axis=1)]
    write_text(path, "\n".join(lines) + "\n")


def _tip(motion: Motion, body: int, joint: np.ndarray) -> np.ndarray:
    """Find the way from a joint to the farthest vertex that mostly follows its body."""
    vertices = np.asarray(motion.character.vertices, np.float64)
    own = vertices[np.asarray(motion.character.weights)[:, body] > 0.5] - joint
    lengths = np.linalg.norm(own, axis=1)
    if not len(own) or lengths.max() < _SHORTEST_TIP:
        return np.array([0.0, -_SHORTEST_TIP, 0.0])
    return own[lengths.argmax()]


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{value:.6f}" for value in values)
