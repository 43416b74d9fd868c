"""Qualisys calibrations (`.qca.txt`, XML, as Qualisys Track Manager exports them).

The convention is the one Pose2Sim's `read_qca` reads: `transform` holds the camera's place in the world in millimetres
and the rows r11 r12 r13, ... of world-to-camera, for a camera that looks along -z with y up; focal lengths and centres
are in 1/64 of a pixel of the sensor, of which the video shows the pixels `fov_video`, `right` and `bottom` included. A
camera is called by its serial number, which ends the names that QTM gives its videos.

Distortions are OpenCV's k1 k2 p1 p2 k3 as they stand. Pose2Sim divides these by 64 too, but QTM's own are as large as
OpenCV's for the same lens; a file that Pose2Sim made from another calibration holds 64 times its distortion. Qualisys
does not say where the centre of a pixel is; as in Pose2Sim it is at whole numbers, as in OpenCV. `viewrotation` turns
QTM's windows, not the videos, and is ignored.
"""

import math
import xml.etree.ElementTree as ElementTree
from typing import Any

import numpy as np

from jaxmocap._results import InputError

from ._file_storage import parse_xml
from ._static_camera import StaticCamera, WrittenCamera, check_names, pinhole, pose

MILLIMETRE = 0.001
_SUBPIXELS = 64
_FLIP = np.diag([1.0, -1.0, -1.0])  # y up and -z forward to y down and z forward
_ENTRIES = tuple(f"r{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3))
_DISTORTION = ("radialDistortion1", "radialDistortion2", "tangentalDistortion1", "tangentalDistortion2")


def _values(camera: Any, tag: str, keys: tuple[str, ...], where: str) -> np.ndarray:
    element = camera.find(tag)
    if element is None:
        raise InputError(
            f"{where} has no <{tag}>; expected its {', '.join(keys[:4])} and so on: export it from QTM again"
        )
    missing = [key for key in keys if key not in element.attrib]
    if missing:
        raise InputError(f"{where}: <{tag}> has no {', '.join(missing)}; export the calibration from QTM again")
    for key in keys:
        if not _is_number(element.attrib[key]):
            raise InputError(
                f"{where}: <{tag}> has {key} = {element.attrib[key][:40]!r}; expected a finite number: export it again"
            )
    return np.array([float(element.attrib[key]) for key in keys])


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def _camera(element: Any, where: str) -> StaticCamera:
    left, top, right, bottom = _values(element, "fov_video", ("left", "top", "right", "bottom"), where)
    width, height = right - left + 1, bottom - top + 1
    if not (width >= 1 and height >= 1 and width == int(width) and height == int(height)):
        raise InputError(f"{where}: <fov_video> spans {width:g}x{height:g} pixels; expected whole numbers above 0")
    optics = _values(element, "intrinsic", ("focalLengthU", "focalLengthV", "centerPointU", "centerPointV"), where)
    fx, fy, cx, cy = optics / _SUBPIXELS
    extra = [key for key in ("skew", "radialDistortion3") if key in element.find("intrinsic").attrib]
    others = dict(zip(extra, _values(element, "intrinsic", tuple(extra), where), strict=True))
    if others.get("skew", 0.0) != 0:
        raise InputError(f"{where} has a skew of {others['skew']:g}, which is not supported; expected 0")
    distortion = np.append(_values(element, "intrinsic", _DISTORTION, where), others.get("radialDistortion3", 0.0))
    rotation = _FLIP @ _values(element, "transform", _ENTRIES, where).reshape(3, 3)
    position = _values(element, "transform", ("x", "y", "z"), where)
    matrix = np.array([[fx, 0.0, cx - left], [0.0, fy, cy - top], [0.0, 0.0, 1.0]])
    return StaticCamera(
        (int(width), int(height)), pinhole(matrix, where), distortion, pose(rotation, -rotation @ position)
    )


def read_qualisys(text: str, names: tuple[str, ...], label: str) -> list[StaticCamera]:
    """Read the cameras with these serial numbers, in that order; lengths in millimetres."""
    root = parse_xml(text, label)
    elements = [element for element in root.iter("camera") if "serial" in element.attrib]
    check_names(names, [element.attrib["serial"] for element in elements], label)
    by_serial = {element.attrib["serial"]: element for element in elements}
    return [_camera(by_serial[name], f"{label} camera {name}") for name in names]


def qualisys_text(cameras: list[WrittenCamera]) -> str:
    """Write a calibration that `read_qualisys` reads, and Pose2Sim except for the distortion.

    It lacks what only QTM knows: residuals, the wand, and the focal lengths in millimetres, which would take the pitch
    of the sensor.
    """
    root = ElementTree.Element("calibration", {"calibrated": "true", "source": "jaxmocap", "type": "regular"})
    listed = ElementTree.SubElement(root, "cameras")
    for camera in cameras:
        right, bottom = camera.size[0] - 1, camera.size[1] - 1
        about = {"active": "1", "avg-residual": "0", "serial": camera.name, "model": "none", "viewrotation": "0"}
        element = ElementTree.SubElement(listed, "camera", about)
        for tag in ("fov_marker", "fov_marker_max", "fov_video", "fov_video_max"):
            ElementTree.SubElement(element, tag, {"left": "0", "top": "0", "right": f"{right}", "bottom": f"{bottom}"})
        position = -camera.rotation.T @ camera.translation / MILLIMETRE
        place = dict(zip("xyz", position.tolist(), strict=True))
        turn = dict(zip(_ENTRIES, (_FLIP @ camera.rotation).ravel().tolist(), strict=True))
        ElementTree.SubElement(element, "transform", {key: repr(value) for key, value in (place | turn).items()})
        k, d = camera.intrinsics * _SUBPIXELS, camera.distortion
        optics = {"sensorMinU": 0.0, "sensorMaxU": camera.size[0] * _SUBPIXELS - 1.0}
        optics |= {"sensorMinV": 0.0, "sensorMaxV": camera.size[1] * _SUBPIXELS - 1.0}
        optics |= {"focalLengthU": k[0, 0], "focalLengthV": k[1, 1], "centerPointU": k[0, 2], "centerPointV": k[1, 2]}
        optics |= {"skew": 0.0, "radialDistortion1": d[0], "radialDistortion2": d[1], "radialDistortion3": d[4]}
        optics |= {"tangentalDistortion1": d[2], "tangentalDistortion2": d[3]}
        ElementTree.SubElement(element, "intrinsic", {key: repr(float(value)) for key, value in optics.items()})
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=False) + "\n"
