"""The report of a calibration: its records, and a picture of the cameras' paths, the points and the person."""

from collections.abc import Collection
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from jaxmocap.camera import ViewGeometry, describe_views, look_at_point, read_colmap_points, view_geometry
from jaxmocap.capture import Capture, triangulated_people
from jaxmocap.geometry import Similarity

from ._child import Solved
from ._scale import Scale
from ._world import Gravity

OUTLINE_DEVIATION = 0.02
"""Of the scale that a known height and the person's outlines tell, relative: hair, caps, shoes and posture."""
_SIZE = 700  # of a panel of the picture, pixels
_COLOURS = ((230, 60, 40), (40, 110, 230), (30, 160, 60), (200, 120, 0), (140, 60, 200))


def _list(places: np.ndarray, names: tuple[str, ...]) -> dict[str, list[int]]:
    """List frames by camera name."""
    return {name: sorted(int(f) for c, f in places if c == camera) for camera, name in enumerate(names)}


def _geometries(solved: Solved, world: Similarity, joints: np.ndarray) -> list[ViewGeometry]:
    """Describe the views at every shared frame, about the person, or about where the cameras look."""
    person = np.median(world(joints), axis=0) if len(joints) else world(look_at_point(solved.poses))
    poses = world.cameras(solved.shared_poses())
    return [view_geometry(solved.intrinsics[:, 0, 0], poses[:, frame], person) for frame in range(poses.shape[1])]


def make_record(
    capture: Capture,
    solved: Solved,
    scale: Scale,
    gravity: Gravity,
    world: Similarity,
    joints: Float[np.ndarray, "joint 3"],
    seconds: float,
) -> dict[str, Any]:
    """Make what `calibration.json` holds.

    Lengths are metres, angles degrees, residuals pixels; frames are those of each camera's own video. `world` is
    metric_world_from_model, `joints` of the person are in the model's world, `seconds` is how long it took.
    """
    tables, names = solved.tables, capture.camera_names
    geometries = _geometries(solved, world, joints)
    middle = sorted(geometries, key=lambda geometry: geometry.angle)[len(geometries) // 2]
    worst = min(geometries, key=lambda geometry: geometry.angle)
    found = _list(tables["interpolated"], names)
    cameras = {}
    for camera, name in enumerate(names):
        mine = solved.places[:, 0] == camera
        seen = tables["num_observations"] > 0 if "joints" in tables else mine
        placed = mine & ~np.isin(solved.places[:, 1], found[name])
        focal, radial = solved.intrinsics[camera, 0, 0], solved.distortion[camera, 0]
        frames = solved.places[mine, 1]
        cameras[name] = {
            "frames": [int(frames.min()), int(frames.max())],
            "registered": int(mine.sum()) - len(found[name]),
            "outliers": _list(tables["outliers"], names)[name],
            "placed_again": _list(tables["placed_again"], names)[name],
            "interpolated": found[name],
            "focal_pixels": round(float(focal), 2),
            "radial_distortion": round(float(radial), 5),
            "median_residual_pixels": round(float(np.nanmedian(tables["residual"][mine])), 3),
            "median_observations": int(np.median(tables["num_observations"][mine & seen])),
            "centre_deviation_m": round(float(world.scale * np.median(tables["centre_deviation"][placed])), 5),
            "rotation_deviation_degrees": round(float(np.degrees(np.median(tables["angle_deviation"][placed]))), 4),
        }
    warnings = [
        *gravity.warnings,
        *(
            f"{name}: {len(frames)} frames could not be placed and lie between their neighbours; do not select them"
            for name, frames in found.items()
            if frames
        ),
    ]
    lengths = tables["track_lengths"]
    return {
        "format": 1,
        "from": "person" if "joints" in tables else "background",
        "cameras": cameras,
        "points": len(solved.points),
        "mean_track_length": round(float(np.mean(lengths)), 1) if len(lengths) else 0.0,
        "scale": {
            "from": scale.source,
            "relative_deviation": round(scale.deviation, 4),
            "bones": scale.num_bones,
            "frames": scale.num_frames,
        },
        "gravity": {
            "from": gravity.source,
            "differences_degrees": {name: round(angle, 2) for name, angle in gravity.differences.items()},
            "ground_points": 0 if gravity.ground is None else gravity.ground.count,
        },
        "person": {
            "angle_degrees": round(middle.angle, 1),
            "least_angle_degrees": round(worst.angle, 1),
            "across_m_per_pixel": round(middle.across, 5),
            "depth_m_per_pixel": round(middle.depth, 5),
            "sentence": describe_views(middle),
        },
        "warnings": warnings,
        "seconds": round(seconds, 1),
    }


def pose_table(capture: Capture, solved: Solved, world: Similarity) -> dict[str, Any]:
    """Make what `uncertainty.json` holds: per camera, one row per frame of its video."""
    tables = solved.tables
    interpolated = {(int(c), int(f)) for c, f in tables["interpolated"]}
    again = {(int(c), int(f)) for c, f in tables["placed_again"]}
    result: dict[str, Any] = {
        "format": 1,
        "units": "metres, degrees, pixels; standard deviations after the best similarity of all cameras",
    }
    for camera, name in enumerate(capture.camera_names):
        mine = np.flatnonzero(solved.places[:, 0] == camera)
        places = [(camera, int(solved.places[row, 1])) for row in mine]
        result[name] = {
            "frame": [frame for _, frame in places],
            "centre_deviation": [round(world.scale * float(v), 6) for v in tables["centre_deviation"][mine]],
            "rotation_deviation": [round(float(np.degrees(v)), 5) for v in tables["angle_deviation"][mine]],
            "residual": [round(float(v), 3) for v in tables["residual"][mine]],
            "observations": [int(v) for v in tables["num_observations"][mine]],
            "how": [
                "interpolated" if place in interpolated else "placed again" if place in again else "registered"
                for place in places
            ],
        }
    return result


def rescaled(record: dict[str, Any], table: dict[str, Any], factor: float) -> tuple[dict[str, Any], dict[str, Any]]:
    """Multiply the lengths of `calibration.json` and `uncertainty.json`; height and outlines tell their scale now."""
    person = record["person"]
    across, depth = factor * person["across_m_per_pixel"], factor * person["depth_m_per_pixel"]
    cameras = {
        name: one | {"centre_deviation_m": round(factor * one["centre_deviation_m"], 5)}
        for name, one in record["cameras"].items()
    }
    record = record | {
        "cameras": cameras,
        "scale": record["scale"] | {"from": "height and outlines", "relative_deviation": OUTLINE_DEVIATION},
        "person": person
        | {
            "across_m_per_pixel": round(across, 5),
            "depth_m_per_pixel": round(depth, 5),
            "sentence": describe_views(ViewGeometry(person["angle_degrees"], across, depth)),
        },
    }
    deviations = {
        name: table[name] | {"centre_deviation": [round(factor * v, 6) for v in table[name]["centre_deviation"]]}
        for name in cameras
    }
    return record, table | deviations


def draw_paths(
    capture: Capture,
    poses: Float[np.ndarray, "camera frame 4 4"],
    points: Float[np.ndarray, "point 3"],
    person: Float[np.ndarray, "joint 3"],
    interpolated: Collection[tuple[int, int]] = (),
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw the paths of cameras, RGB: left from above, right from the side, with a bar of one metre.

    Everything is in metres. Points are grey, the person's joints black; every tenth pose has a stroke that shows where
    it looks; poses `interpolated` (camera, frame of its own video) are rings.
    """
    centres = -np.einsum("ctji,ctj->cti", poses[..., :3, :3], poses[..., :3, 3])
    x, y, z = np.eye(3)
    above = np.stack({"x": (-y, z), "y": (x, z), "z": (x, -y)}[capture.up])
    side = np.stack({"x": (-y, -x), "y": (x, -y), "z": (x, -z)}[capture.up])
    content = np.concatenate([centres.reshape(-1, 3), person.reshape(-1, 3), np.zeros((1, 3))])
    low, high = content.min(0) - 1.0, content.max(0) + 1.0
    panels = []
    for title, axes in (("from above", above), ("from the side", side)):
        corners = np.sort(np.stack([axes @ low, axes @ high]), axis=0)
        scale = _SIZE / float((corners[1] - corners[0]).max())
        image = np.full((_SIZE, _SIZE, 3), 255, np.uint8)

        def pixel(
            value: np.ndarray, axes: np.ndarray = axes, corners: np.ndarray = corners, scale: float = scale
        ) -> tuple[int, int]:
            x, y = (axes @ value - corners.mean(0)) * scale + _SIZE / 2
            return int(np.clip(x, -9999, 9999)), int(np.clip(y, -9999, 9999))

        for point in points:
            cv2.circle(image, pixel(point), 1, (190, 190, 190), -1)
        for point in person:
            cv2.circle(image, pixel(point), 3, (0, 0, 0), -1, cv2.LINE_AA)
        for camera, name in enumerate(capture.camera_names):
            colour = _COLOURS[camera % len(_COLOURS)]
            path = np.array([pixel(centre) for centre in centres[camera]], np.int32)
            cv2.polylines(image, [path], False, colour, 2, cv2.LINE_AA)
            for frame in range(0, len(path), 10):
                ahead = pixel(centres[camera, frame] + 0.4 * poses[camera, frame, 2, :3])
                cv2.line(image, tuple(map(int, path[frame])), ahead, colour, 1, cv2.LINE_AA)
            for frame in range(len(path)):
                if (camera, int(capture.video_frames[camera, frame])) in interpolated:
                    cv2.circle(image, tuple(map(int, path[frame])), 5, colour, 1, cv2.LINE_AA)
            cv2.putText(image, name, (12, 60 + 24 * camera), cv2.FONT_HERSHEY_SIMPLEX, 0.6, colour, 2, cv2.LINE_AA)
        cv2.putText(image, title, (12, 28), cv2.FONT_HERSHEY_SIMPLEX, 0.7, (0, 0, 0), 1, cv2.LINE_AA)
        cv2.line(image, (12, _SIZE - 20), (12 + round(scale), _SIZE - 20), (0, 0, 0), 2)
        cv2.putText(image, "1 m", (12, _SIZE - 28), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 1, cv2.LINE_AA)
        panels.append(image)
    return np.concatenate(panels, axis=1)


def draw_cameras(capture: Capture) -> UInt8[np.ndarray, "height width 3"]:
    """Draw `draw_paths`' picture of a capture that has cameras.

    It shows the points of its COLMAP model, and the person's joints where keypoints are seen in two views. Raises
    `InputError` if there are no cameras.
    """
    cameras, folder = capture.cameras, capture.cameras_path
    people = triangulated_people(capture, cameras, [])
    joints = np.concatenate([points[np.isfinite(points).all(1)] for points in people.values()] or [np.zeros((0, 3))])
    points = np.zeros((0, 3))
    if folder is not None and folder.is_dir():
        points = capture.metres_per_unit * read_colmap_points(folder)[0]
    return draw_paths(capture, np.asarray(cameras.cam_from_world, float), points, joints)


def png_bytes(image: UInt8[np.ndarray, "height width 3"]) -> bytes:
    """Encode an image, RGB, as a PNG file."""
    done, data = cv2.imencode(".png", np.ascontiguousarray(image[..., ::-1]))
    assert done
    return data.tobytes()
