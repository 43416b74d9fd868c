"""The joints of an OpenSim model: one of ours each, with our axes, limits and order of turns."""

import itertools
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap._results import InputError
from jaxmocap.character import Skeleton

from ._neutral_body import REST_FROM_OPENSIM, NeutralBody
from ._opensim import PELVIS

_INDEPENDENT = 0.5
"""Volume between three axes of a joint below which it is described from where they are at right angles."""


def add_root(joints: ElementTree.Element, name: str, start: np.ndarray) -> None:
    """Join the pelvis to the ground: three turns, then three shifts."""
    names, axes = list(PELVIS), ((0, 0, 1), (1, 0, 0), (0, 1, 0), *np.eye(3))
    still = np.zeros(3)
    joint = _joint(joints, "CustomJoint", "ground_pelvis", "/ground", f"/bodyset/{name}", still, still)
    coordinates, transform = add_element(joint, "coordinates"), add_element(joint, "SpatialTransform")
    for number, (coordinate, axis) in enumerate(zip(names, axes, strict=True)):
        reach = np.pi if number < 3 else 100.0
        _coordinate(coordinates, coordinate, start[number], -reach, reach)
        kind = f"rotation{number + 1}" if number < 3 else f"translation{number - 2}"
        _transform_axis(transform, kind, coordinate, np.array(axis), 0.0)


def add_joint(
    joints: ElementTree.Element, skeleton: Skeleton, body: NeutralBody, number: int, start: np.ndarray
) -> None:
    """Join a body to its parent: up to three turns about its joint, in the order of Eq. 2."""
    parent, name = skeleton.parents[number], skeleton.body_names[number]
    angles = _angles_of(skeleton, number)
    axes = body.axes[angles] @ REST_FROM_OPENSIM  # in the parent's frame
    place = REST_FROM_OPENSIM.T @ (body.joints[number] - body.joints[parent])
    shift, last = 0.0, np.zeros(3)
    if len(angles) == 3:
        shift = _shift(axes)
        last = shift * axes[1]
        axes[2] = Rotation.from_rotvec(-last).apply(axes[2])
    turns = Rotation.from_rotvec(last).as_euler("XYZ")
    parent_name = f"/bodyset/{skeleton.body_names[parent]}"
    kind = "CustomJoint" if angles else "WeldJoint"
    joint = _joint(joints, kind, skeleton.joint_names[number], parent_name, f"/bodyset/{name}", place, turns)
    if not angles:
        return
    coordinates, transform = add_element(joint, "coordinates"), add_element(joint, "SpatialTransform")
    for angle in angles:
        low, high = (float(limit[angle]) + body.at_rest[angle] for limit in (skeleton.lower, skeleton.upper))
        _coordinate(coordinates, skeleton.angle_names[angle], start[6 + angle], low, high)
    for row, axis in enumerate(_completed(axes)):
        coordinate = skeleton.angle_names[angles[row]] if row < len(angles) else None
        _transform_axis(transform, f"rotation{row + 1}", coordinate, axis, shift if row == 1 else 0.0)
    for row, axis in enumerate(np.eye(3)):
        _transform_axis(transform, f"translation{row + 1}", None, axis, 0.0)


def _angles_of(skeleton: Skeleton, number: int) -> list[int]:
    """List the joint angles of a body. Raises `InputError` for a joint that a `CustomJoint` cannot hold."""
    angles = [angle for angle, owner in enumerate(skeleton.dof_body) if owner == number]
    off = np.asarray(skeleton.origins)[angles] - skeleton.joints[number]
    axes = np.asarray(skeleton.axes)[angles]
    astray = np.linalg.norm(np.cross(off, axes), axis=1) > 1e-5
    parallel = any(np.linalg.norm(np.cross(a, b)) < 0.1 for a, b in itertools.pairwise(axes))
    if len(angles) > 3 or astray.any() or parallel:
        raise InputError(
            f"the joint {skeleton.joint_names[number]} turns about {len(angles)} axes, which an OpenSim joint cannot "
            "hold: up to three through one point, each at an angle to the next, were expected; write a .bvh or .glb."
        )
    return angles


def _shift(axes: np.ndarray) -> float:
    """Find the angle of the second axis from which the third one is at right angles to the plane of the others.

    OpenSim wants three axes that are independent where all angles are zero; the first and last axis of a shoulder whose
    arm points sideways are the same line. It is 0 where the axes are independent as they are.
    """
    if abs(np.linalg.det(axes)) > _INDEPENDENT:
        return 0.0
    normal = np.cross(axes[0], axes[1])
    last = axes[2] - (axes[2] @ axes[1]) * axes[1]
    turns = [np.arctan2(np.cross(way, last) @ axes[1], way @ last) for way in (normal, -normal)]
    return float(min(turns, key=abs))


def _completed(axes: np.ndarray) -> list[np.ndarray]:
    """Add axes that nothing turns about, to three."""
    three = list(axes)
    while len(three) < 3:
        new = np.cross(three[0], three[1] if len(three) == 2 else np.eye(3)[np.abs(three[0]).argmin()])
        three.append(new / np.linalg.norm(new))
    return three


def _joint(
    joints: ElementTree.Element, kind: str, name: str, parent: str, child: str, place: np.ndarray, turns: np.ndarray
) -> ElementTree.Element:
    """Add a joint at a place of its parent whose last frame is turned in its child by Euler angles about x, y, z."""
    joint = add_element(joints, kind, name=name)
    ends = (("parent", parent, place, np.zeros(3)), ("child", child, np.zeros(3), turns))
    for end, frame, _, _ in ends:
        add_element(joint, f"socket_{end}_frame", f"{Path(frame).name}_offset")
    frames = add_element(joint, "frames")
    for _, frame, translation, orientation in ends:
        offset = add_element(frames, "PhysicalOffsetFrame", name=f"{Path(frame).name}_offset")
        add_element(offset, "socket_parent", frame)
        add_element(offset, "translation", numbers(*translation))
        add_element(offset, "orientation", numbers(*orientation))
    return joint


def _coordinate(coordinates: ElementTree.Element, name: str, start: float, low: float, high: float) -> None:
    """Add a coordinate with its range, which it may leave: OpenSim's solver stops too early at a range it must keep."""
    one = add_element(coordinates, "Coordinate", name=name)
    add_element(one, "default_value", numbers(start))
    add_element(one, "range", numbers(low, high))
    add_element(one, "clamped", "false")
    add_element(one, "locked", "false")


def _transform_axis(
    transform: ElementTree.Element, name: str, coordinate: str | None, axis: np.ndarray, shift: float
) -> None:
    one = add_element(transform, "TransformAxis", name=name)
    add_element(one, "coordinates", coordinate or "")
    add_element(one, "axis", numbers(*axis))
    if coordinate is None:
        add_element(add_element(one, "Constant", name="function"), "value", "0")
    else:
        add_element(add_element(one, "LinearFunction", name="function"), "coefficients", numbers(1.0, shift))


def add_element(
    parent: ElementTree.Element, tag: str, text: str | None = None, **attributes: str
) -> ElementTree.Element:
    """Add an element with a text."""
    element = ElementTree.SubElement(parent, tag, attributes)
    element.text = text
    return element


def numbers(*values: float) -> str:
    """Write numbers as OpenSim reads them."""
    return " ".join(f"{value:.9g}" for value in values)
