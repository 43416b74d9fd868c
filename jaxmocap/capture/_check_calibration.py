"""How good the calibration is: from the report that `calibrate` writes beside the model, else from its points."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap._results import InputError
from jaxmocap.camera import Cameras, ranges, read_colmap_points

from ._capture import Capture
from ._config import Finding

_LARGEST_RESIDUAL = 1.0  # pixels at a width of 960
_LARGEST_AT_PERSON = 0.03  # metres by which a pose's deviation moves the person in its view
_LARGEST_SCALE = 0.03
_LARGEST_OF_BLUR = 2.0  # pixels, of single frames, which a quick turn blurs
_SURE = 0.5  # degrees
_LARGEST_HEIGHT_SCALE = 0.05
_LARGEST_KEYPOINT_RESIDUAL = 8.0  # pixels at a width of 960
_LARGEST_TURN = 3.0  # degrees


def check_calibration(capture: Capture, cameras: Cameras, distance: float | None) -> Iterator[Finding]:
    """Check residuals, uncertainty of the poses, frames that were filled in, scale.

    `distance` is that of the person, metres.
    """
    folder = capture.cameras_path
    if folder is None or not folder.is_dir():
        return
    report = folder / "calibration.json"
    if not report.is_file():
        yield from _points(capture)
        yield from _refinement(capture, folder / "refinement.json")
        return
    try:
        record = json.loads(report.read_text(encoding="utf-8"))
        table = json.loads((folder / "uncertainty.json").read_text(encoding="utf-8"))
        for camera, name in enumerate(cameras.names):
            about = _static_camera if record.get("from") == "person" else _camera
            yield from about(capture, camera, record["cameras"][name], table[name], distance)
        yield from _world(record, folder.name, (folder / "calibration.png").is_file())
    except (OSError, ValueError, KeyError, TypeError, AttributeError, IndexError, RecursionError) as error:
        yield Finding(
            "warning",
            folder.name,
            f"{report} and uncertainty.json are not what calibrate writes ({type(error).__name__}: {error}); remove "
            f"them, or run jaxmocap calibrate {capture.folder} --replace",
        )


def well_placed_frames(capture: Capture, camera: int) -> set[int]:
    """Find the frames of a camera's own video whose poses fit what they see.

    The report beside the model tells; none without one.
    """
    folder = capture.cameras_path
    if folder is None or not (folder / "uncertainty.json").is_file():
        return set()
    limit = _LARGEST_OF_BLUR * max(capture.sizes[camera]) / 960
    try:
        table = json.loads((folder / "uncertainty.json").read_text(encoding="utf-8"))[capture.camera_names[camera]]
        rows = zip(table["frame"], table["residual"], table["rotation_deviation"], table["how"], strict=True)
        return {
            int(frame)
            for frame, residual, turn, how in rows
            if how != "interpolated" and float(residual) < limit and float(turn) < _SURE
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return set()  # `check_calibration` says so


def _camera(
    capture: Capture, camera: int, record: dict[str, Any], table: dict[str, Any], distance: float | None
) -> Iterator[Finding]:
    name, scale = capture.camera_names[camera], max(capture.sizes[camera]) / 960
    residual = float(record["median_residual_pixels"])
    yield Finding(
        "note",
        name,
        f"{name} was calibrated with a focal length of {record['focal_pixels']:.1f} pixels; the background fits to "
        f"{residual:.2f} pixels (median of about {record['median_observations']} points a frame); poses are uncertain "
        f"by {100 * record['centre_deviation_m']:.2f} cm and {record['rotation_deviation_degrees']:.3f} degrees",
    )
    if residual > _LARGEST_RESIDUAL * scale:
        yield Finding(
            "warning",
            name,
            f"the background fits {name}'s poses only to {residual:.2f} pixels, expected below "
            f"{_LARGEST_RESIDUAL * scale:.1f}: blur, much that moves, or stabilised video; calibrate again with "
            "--key-step 2 and --replace, and switch stabilisation off when filming",
        )
    frames = np.array(table["frame"])
    shared = np.isin(frames, capture.video_frames[camera])
    filled = sorted({int(frame) for frame in record["interpolated"]} & set(frames[shared].tolist()))
    if filled:
        selected = [int(capture.video_frames[camera, frame]) for frame in capture.selected_frames or ()]
        also = f"; of these {ranges(chosen)} is selected: select another" if (chosen := [
            frame for frame in filled if frame in selected
        ]) else ""  # fmt: skip
        yield Finding(
            "warning",
            f"{name} frame {ranges(filled)}",
            f"{name}'s pose at frame {ranges(filled)} could only be filled in between its neighbours{also}; calibrate "
            "again with --key-step 2 --replace, or expect a worse result there",
        )
    if distance is not None:
        turn = np.radians(np.array(table["rotation_deviation"], float)[shared])
        shift = np.array(table["centre_deviation"], float)[shared]
        moved = np.hypot(shift, distance * turn)
        bad = frames[shared][moved > _LARGEST_AT_PERSON]
        if len(bad):
            yield Finding(
                "warning",
                f"{name} frame {ranges([int(f) for f in bad])}",
                f"{name}'s pose is so uncertain at frame {ranges([int(f) for f in bad])} that it moves the person by "
                f"up to {100 * float(moved.max()):.0f} cm: there is too little background there; calibrate again with "
                "--key-step 2 --replace, or film with more of it in the picture",
            )


def _static_camera(
    capture: Capture, camera: int, record: dict[str, Any], table: dict[str, Any], distance: float | None
) -> Iterator[Finding]:
    """Of a camera that stands still, which was placed by the person."""
    name, scale = capture.camera_names[camera], max(capture.sizes[camera]) / 960
    residual, turn = float(record["median_residual_pixels"]), float(record["rotation_deviation_degrees"])
    yield Finding(
        "note",
        name,
        f"{name} stands still and was placed by the person's keypoints, which fit to {residual:.1f} pixels; its focal "
        f"length is {record['focal_pixels']:.0f} pixels, its orientation is known to {turn:.1f} degrees",
    )
    if residual > _LARGEST_KEYPOINT_RESIDUAL * scale:
        yield Finding(
            "warning",
            name,
            f"the person's keypoints fit {name} only to {residual:.1f} pixels, expected below "
            f"{_LARGEST_KEYPOINT_RESIDUAL * scale:.0f}: another person, another moment (offset), or a poor detector",
        )
    if turn > _LARGEST_TURN:
        yield Finding(
            "warning",
            name,
            f"{name}'s orientation is known only to {turn:.1f} degrees: film the person walking about the whole of the "
            "place, towards the cameras and across, or give the focal lengths with --focal",
        )


def _world(record: dict[str, Any], folder: str, has_picture: bool) -> Iterator[Finding]:
    scale, gravity = record["scale"], record["gravity"]
    deviation, more = float(scale["relative_deviation"]), ""
    doubtful = deviation > _LARGEST_SCALE
    if doubtful and scale["from"] == "height" and deviation < _LARGEST_HEIGHT_SCALE:
        doubtful, more = (
            False,
            ", since limbs of people of one height differ; an actor, --camera-distance or fit-character "
            "--scale-cameras tell it better",
        )
    elif doubtful:
        more = "; more frames with keypoints make it surer, or --camera-distance with a measured length"
    yield Finding(
        "warning" if doubtful else "note",
        folder,
        f"the scale is from the {scale['from']}, to {100 * deviation:.1f} %, and up from the {gravity['from']}{more}",
    )
    for warning in record["warnings"]:
        yield Finding("warning", folder, str(warning))
    if has_picture:
        yield Finding("note", folder, f"{folder}/calibration.png shows the cameras' paths, the points and the person")


def _refinement(capture: Capture, report: Path) -> Iterator[Finding]:
    """Report what `refine-cameras` left, if it made this model."""
    if not report.is_file():
        return
    try:
        record = json.loads(report.read_text(encoding="utf-8"))
        for name in capture.camera_names:
            camera = record["cameras"][name]
            yield Finding(
                "note",
                name,
                f"{name} was refined with the tracked body, by {100 * camera['moved_m']:.1f} cm and "
                f"{camera['turned_degrees']:.2f} degrees; its clock by {1000 * camera['late_seconds']:+.1f} ms, known "
                f"to {1000 * camera['late_deviation_seconds']:.1f} ms",
            )
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        yield Finding(
            "warning",
            report.parent.name,
            f"{report} is not what refine-cameras writes ({type(error).__name__}: {error}); remove it",
        )


def _points(capture: Capture) -> Iterator[Finding]:
    """Of a model from elsewhere, what its points tell."""
    assert capture.cameras_path is not None
    try:
        points, errors = read_colmap_points(capture.cameras_path)
    except InputError as error:
        yield Finding("warning", capture.cameras_path.name, str(error))
        return
    if len(points) == 0:
        return
    residual, scale = float(np.median(errors)), max(max(size) for size in capture.sizes) / 960
    said = f"the {len(points)} points of the model fit to {residual:.2f} pixels (median)"
    if residual > _LARGEST_RESIDUAL * scale:
        said += f", expected below {_LARGEST_RESIDUAL * scale:.1f}: the poses are doubtful; calibrate again"
        yield Finding("warning", capture.cameras_path.name, said)
    else:
        yield Finding("note", capture.cameras_path.name, said)
