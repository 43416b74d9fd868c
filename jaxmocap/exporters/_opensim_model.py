"""OSIM: the character as an OpenSim 4 model, whose coordinates are those of our MOT and whose markers our TRC's."""

import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path

import numpy as np

from jaxmocap._files import write_text
from jaxmocap.character import Character, Skeleton, dominant_bodies
from jaxmocap.motion import Motion

from ._body_mass import body_mass
from ._exporter import ExportForm
from ._marker_set import marker_set
from ._neutral_body import REST_FROM_OPENSIM, neutral_body
from ._opensim import PELVIS, coordinates_of, opensim_name
from ._opensim_joints import add_element, add_joint, add_root, numbers

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
    model = add_element(document, "Model", name=opensim_name(Path(form.name).stem))
    for tag, text in (("credits", _NOTE), ("length_units", "meters"), ("force_units", "N")):
        add_element(model, tag, text)
    add_element(model, "gravity", "0 -9.80665 0")
    bodies = add_element(add_element(model, "BodySet", name="bodyset"), "objects")
    joints = add_element(add_element(model, "JointSet", name="jointset"), "objects")
    markers = add_element(add_element(model, "MarkerSet", name="markerset"), "objects")
    owners = dominant_bodies(character)
    for number, name in enumerate(skeleton.body_names):
        one = add_element(bodies, "Body", name=name)
        if (owners == number).any():
            geometry = add_element(add_element(one, "attached_geometry"), "Mesh", name=f"{name}_mesh")
            add_element(geometry, "socket_frame", "..")
            add_element(geometry, "scale_factors", "1 1 1")
            add_element(geometry, "mesh_file", f"{Path(form.name).stem}{GEOMETRY}/{name}.obj")
        turn = frames[number].T
        inertia = turn @ mass.inertias[number] @ turn.T
        add_element(one, "mass", numbers(mass.masses[number]))
        add_element(one, "mass_center", numbers(*turn @ (mass.centres[number] - rest[number])))
        add_element(one, "inertia", numbers(*inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]))
        if number == 0:
            add_root(joints, name, start)
        else:
            add_joint(joints, skeleton, body, number, start)
    places = marker_set(character)
    for name, number, place in zip(places.names, places.bodies, places.places, strict=True):
        one = add_element(markers, "Marker", name=name)
        add_element(one, "socket_parent_frame", f"/bodyset/{skeleton.body_names[number]}")
        add_element(one, "location", numbers(*frames[number].T @ (place - rest[number])))
        add_element(one, "fixed", "true")
    ElementTree.indent(document)
    write_text(path, '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(document, "unicode") + "\n")


def write_osim_geometry(motion: Motion, folder: Path, form: ExportForm) -> None:
    """Write the triangles of each body as an OBJ in the body's own frame, metres."""
    character = motion.character
    skeleton, body = character.skeleton, neutral_body(character.skeleton)
    for number, (vertices, faces) in _pieces(character).items():
        placed = body.placed(skeleton, number, vertices) - body.joints[number]
        lines = [f"v {numbers(*row)}" for row in placed @ REST_FROM_OPENSIM]
        lines += ["f " + " ".join(map(str, row)) for row in faces + 1]
        write_text(folder / f"{opensim_name(skeleton.body_names[number])}.obj", "\n".join(lines) + "\n")


def write_osim_setup(motion: Motion, path: Path, form: ExportForm) -> None:
    """Write settings with which OpenSim's inverse kinematics solves for the TRC of the same name.

    A shoulder has two sets of the same angles, and markers alone may find the other: angles are drawn to those of the
    MOT, but in a motion of fewer than six frames, which OpenSim's splines refuse.
    """
    name = form.name.removesuffix(SETUP)
    document = ElementTree.Element("OpenSimDocument", Version="40000")
    tool = add_element(document, "InverseKinematicsTool", name=name)
    add_element(tool, "model_file", f"{name}.osim")
    add_element(tool, "marker_file", f"{name}.trc")
    known = (*PELVIS, *_named(motion.character.skeleton).angle_names) if len(motion) >= _SPLINE else ()
    if known:
        add_element(tool, "coordinate_file", f"{name}.mot")
    add_element(tool, "output_motion_file", f"{name}_ik.mot")
    add_element(tool, "time_range", numbers(*motion.timestamps[[0, -1]]))
    add_element(tool, "accuracy", f"{_ACCURACY:g}")
    tasks = add_element(add_element(tool, "IKTaskSet", name="iktaskset"), "objects")
    for marker in marker_set(motion.character).names:
        _add_task(tasks, "IKMarkerTask", marker, 1.0)
    for coordinate in known:
        add_element(_add_task(tasks, "IKCoordinateTask", coordinate, _PULL), "value_type", "from_file")
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


def _add_task(tasks: ElementTree.Element, kind: str, name: str, weight: float) -> ElementTree.Element:
    task = add_element(tasks, kind, name=name)
    add_element(task, "apply", "true")
    add_element(task, "weight", f"{weight:g}")
    return task
