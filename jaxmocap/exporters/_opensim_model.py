"""OSIM: the character as an OpenSim 4 model, whose coordinates are those of our MOT and whose markers our TRC's."""

import itertools
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap._files import write_text
from jaxmocap._results import InputError
from jaxmocap.character import Character, Skeleton, dominant_bodies
from jaxmocap.motion import Motion

from ._body_mass import body_mass
from ._exporter import ExportForm
from ._marker_set import marker_set
from ._neutral_body import REST_FROM_OPENSIM, NeutralBody, neutral_body
from ._opensim import PELVIS, coordinates_of, opensim_name

GEOMETRY = "_geometry"
"""What is added to the name of a model to name the folder of its meshes."""
SETUP = "_ik.xml"
"""What is added to the name of a model to name the settings of OpenSim's inverse kinematics."""
_ACCURACY = 1e-7
"""OpenSim's own 1e-5 ends degrees too early where a shoulder is near gimbal lock."""
_PULL = 1e-4
"""Weight of an angle (squared radians) beside a marker (squared metres), enough to choose between equivalent angles."""
_SPLINE = 6
"""Frames that OpenSim's splines through the angles need."""
_INDEPENDENT = 0.5
"""Volume between three axes of a joint below which it is described from where they are at right angles."""
_NOTE = (
    "Written by jaxmocap. Metres, kilograms; every body frame is x forward, y up, z right (ISB) in the neutral body, "
    "in which all coordinates are 0: arms straight out to the sides, palms down, legs straight. Masses are de Leva's "
    "(1996) or those of capsules. The motion is in the MOT file of the same name; the default pose is its first."
)


def write_osim(motion: Motion, path: Path, form: ExportForm) -> None:
    """Write the model: a body with mass and inertia per body of ours, joints with our limits, markers, meshes."""
    character, skeleton = motion.character, _named(motion.character.skeleton)
    body, mass = neutral_body(character.skeleton), body_mass(character, form.mass)
    start = coordinates_of(motion)[0]
    frames = body.turns.swapaxes(1, 2) @ REST_FROM_OPENSIM  # rest from each body's frame
    rest = skeleton.joints.astype(np.float64)
    document = ElementTree.Element("OpenSimDocument", Version="40000")
    model = _add(document, "Model", name=opensim_name(Path(form.name).stem))
    for tag, text in (("credits", _NOTE), ("length_units", "meters"), ("force_units", "N")):
        _add(model, tag, text)
    _add(model, "gravity", "0 -9.80665 0")
    bodies = _add(_add(model, "BodySet", name="bodyset"), "objects")
    joints = _add(_add(model, "JointSet", name="jointset"), "objects")
    markers = _add(_add(model, "MarkerSet", name="markerset"), "objects")
    owners = dominant_bodies(character)
    for number, name in enumerate(skeleton.body_names):
        one = _add(bodies, "Body", name=name)
        if (owners == number).any():
            geometry = _add(_add(one, "attached_geometry"), "Mesh", name=f"{name}_mesh")
            _add(geometry, "socket_frame", "..")
            _add(geometry, "scale_factors", "1 1 1")
            _add(geometry, "mesh_file", f"{Path(form.name).stem}{GEOMETRY}/{name}.obj")
        turn = frames[number].T
        inertia = turn @ mass.inertias[number] @ turn.T
        _add(one, "mass", _numbers(mass.masses[number]))
        _add(one, "mass_center", _numbers(*turn @ (mass.centres[number] - rest[number])))
        _add(one, "inertia", _numbers(*inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]))
        if number == 0:
            _add_root(joints, name, start)
        else:
            _add_joint(joints, skeleton, body, number, start)
    places = marker_set(character)
    for name, number, place in zip(places.names, places.bodies, places.places, strict=True):
        one = _add(markers, "Marker", name=name)
        _add(one, "socket_parent_frame", f"/bodyset/{skeleton.body_names[number]}")
        _add(one, "location", _numbers(*frames[number].T @ (place - rest[number])))
        _add(one, "fixed", "true")
    ElementTree.indent(document)
    write_text(path, '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(document, "unicode") + "\n")


def write_osim_geometry(motion: Motion, folder: Path, form: ExportForm) -> None:
    """Write the triangles of each body as an OBJ in the body's own frame, metres."""
    character = motion.character
    skeleton, body = character.skeleton, neutral_body(character.skeleton)
    for number, (vertices, faces) in _pieces(character).items():
        placed = body.placed(skeleton, number, vertices) - body.joints[number]
        lines = [f"v {_numbers(*row)}" for row in placed @ REST_FROM_OPENSIM]
        lines += ["f " + " ".join(map(str, row)) for row in faces + 1]
        write_text(folder / f"{opensim_name(skeleton.body_names[number])}.obj", "\n".join(lines) + "\n")


def write_osim_setup(motion: Motion, path: Path, form: ExportForm) -> None:
    """Write settings with which OpenSim's inverse kinematics solves for the TRC of the same name.

    A shoulder has two sets of the same angles, and markers alone may find the other: angles are drawn to those of the
    MOT, but in a motion of fewer than six frames, which OpenSim's splines refuse.
    """
    name = form.name.removesuffix(SETUP)
    document = ElementTree.Element("OpenSimDocument", Version="40000")
    tool = _add(document, "InverseKinematicsTool", name=name)
    _add(tool, "model_file", f"{name}.osim")
    _add(tool, "marker_file", f"{name}.trc")
    known = (*PELVIS, *_named(motion.character.skeleton).angle_names) if len(motion) >= _SPLINE else ()
    if known:
        _add(tool, "coordinate_file", f"{name}.mot")
    _add(tool, "output_motion_file", f"{name}_ik.mot")
    _add(tool, "time_range", _numbers(*motion.timestamps[[0, -1]]))
    _add(tool, "accuracy", f"{_ACCURACY:g}")
    tasks = _add(_add(tool, "IKTaskSet", name="iktaskset"), "objects")
    for marker in marker_set(motion.character).names:
        _add_task(tasks, "IKMarkerTask", marker, 1.0)
    for coordinate in known:
        _add(_add_task(tasks, "IKCoordinateTask", coordinate, _PULL), "value_type", "from_file")
    ElementTree.indent(document)
    write_text(path, '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(document, "unicode") + "\n")


def _named(skeleton: Skeleton) -> Skeleton:
    """Give bodies, joints and angles names that OpenSim takes."""
    names = {field: getattr(skeleton, field) for field in ("body_names", "landmark_names", "dof_names")}
    return replace(skeleton, **{field: tuple(map(opensim_name, own)) for field, own in names.items()})


def _pieces(character: Character) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Cut the mesh into bodies, each with the vertices it needs."""
    vertices, faces = np.asarray(character.vertices, np.float64), np.asarray(character.faces)
    owners, pieces = dominant_bodies(character), {}
    for number in np.unique(owners):
        used, own = np.unique(faces[owners == number], return_inverse=True)
        pieces[int(number)] = (vertices[used], own.reshape(-1, 3))
    return pieces


def _add_root(joints: ElementTree.Element, name: str, start: np.ndarray) -> None:
    names, axes = list(PELVIS), ((0, 0, 1), (1, 0, 0), (0, 1, 0), *np.eye(3))
    still = np.zeros(3)
    joint = _joint(joints, "CustomJoint", "ground_pelvis", "/ground", f"/bodyset/{name}", still, still)
    coordinates, transform = _add(joint, "coordinates"), _add(joint, "SpatialTransform")
    for number, (coordinate, axis) in enumerate(zip(names, axes, strict=True)):
        reach = np.pi if number < 3 else 100.0
        _coordinate(coordinates, coordinate, start[number], -reach, reach)
        kind = f"rotation{number + 1}" if number < 3 else f"translation{number - 2}"
        _transform_axis(transform, kind, coordinate, np.array(axis), 0.0)


def _add_joint(
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
    coordinates, transform = _add(joint, "coordinates"), _add(joint, "SpatialTransform")
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
    joint = _add(joints, kind, name=name)
    ends = (("parent", parent, place, np.zeros(3)), ("child", child, np.zeros(3), turns))
    for end, frame, _, _ in ends:
        _add(joint, f"socket_{end}_frame", f"{Path(frame).name}_offset")
    frames = _add(joint, "frames")
    for _, frame, translation, orientation in ends:
        offset = _add(frames, "PhysicalOffsetFrame", name=f"{Path(frame).name}_offset")
        _add(offset, "socket_parent", frame)
        _add(offset, "translation", _numbers(*translation))
        _add(offset, "orientation", _numbers(*orientation))
    return joint


def _coordinate(coordinates: ElementTree.Element, name: str, start: float, low: float, high: float) -> None:
    """Add a coordinate with its range, which it may leave: OpenSim's solver stops too early at a range it must keep."""
    one = _add(coordinates, "Coordinate", name=name)
    _add(one, "default_value", _numbers(start))
    _add(one, "range", _numbers(low, high))
    _add(one, "clamped", "false")
    _add(one, "locked", "false")


def _transform_axis(
    transform: ElementTree.Element, name: str, coordinate: str | None, axis: np.ndarray, shift: float
) -> None:
    one = _add(transform, "TransformAxis", name=name)
    _add(one, "coordinates", coordinate or "")
    _add(one, "axis", _numbers(*axis))
    if coordinate is None:
        _add(_add(one, "Constant", name="function"), "value", "0")
    else:
        _add(_add(one, "LinearFunction", name="function"), "coefficients", _numbers(1.0, shift))


def _add_task(tasks: ElementTree.Element, kind: str, name: str, weight: float) -> ElementTree.Element:
    task = _add(tasks, kind, name=name)
    _add(task, "apply", "true")
    _add(task, "weight", f"{weight:g}")
    return task


def _add(parent: ElementTree.Element, tag: str, text: str | None = None, **attributes: str) -> ElementTree.Element:
    element = ElementTree.SubElement(parent, tag, attributes)
    element.text = text
    return element


def _numbers(*values: float) -> str:
    return " ".join(f"{value:.9g}" for value in values)
