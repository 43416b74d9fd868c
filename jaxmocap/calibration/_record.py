"""What the worker found, read back, and the report of a calibration."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from jaxmocap.camera import ViewGeometry, describe_views, look_at_point, view_geometry
from jaxmocap.capture import Capture

from ._footage import Footage
from ._gravity import Gravity
from ._subject import Scale
from ._world import WorldFromModel


@dataclass(frozen=True)
class Solved:
    """The worker's result in the model's units. Arrays by place (camera, frame of its own video) are in one order."""

    sizes: tuple[tuple[int, int], ...]
    video_frames: Int[np.ndarray, "camera frame"]
    places: Int[np.ndarray, "place 2"]
    poses: Float[np.ndarray, "place 4 4"]
    lens: Float[np.ndarray, "camera 4"]
    points: Float[np.ndarray, "point 3"]
    distance: float
    tables: Mapping[str, np.ndarray]

    @staticmethod
    def read(file: Path, capture: Capture, footage: Footage) -> "Solved":
        with np.load(file, allow_pickle=False) as arrays:
            tables = dict(arrays)
        return Solved(
            sizes=capture.sizes,
            video_frames=capture.video_frames,
            places=tables.pop("places"),
            poses=tables.pop("cam_from_world"),
            lens=tables.pop("lens"),
            points=tables.pop("points"),
            distance=float(tables.pop("distance")),
            tables=tables,
        )

    @property
    def intrinsics(self) -> Float[np.ndarray, "camera 3 3"]:
        return np.array([[[f, 0, cx], [0, f, cy], [0, 0, 1]] for f, cx, cy, _ in self.lens])

    @property
    def distortion(self) -> Float[np.ndarray, "camera 5"]:
        result = np.zeros((len(self.lens), 5))
        result[:, 0] = self.lens[:, 3]
        return result

    def index(self, camera: int, frame: int) -> int:
        """The place of a shared frame (position) of a camera."""
        own = self.video_frames[camera, frame]
        return int(np.flatnonzero((self.places[:, 0] == camera) & (self.places[:, 1] == own))[0])

    def pose(self, camera: int, frame: int) -> Float[np.ndarray, "4 4"]:
        return self.poses[self.index(camera, frame)]

    def shared_poses(self) -> Float[np.ndarray, "camera frame 4 4"]:
        cameras, frames = self.video_frames.shape
        return np.stack([[self.pose(camera, frame) for frame in range(frames)] for camera in range(cameras)])


def _list(places: np.ndarray, names: tuple[str, ...]) -> dict[str, list[int]]:
    """Frames by camera name."""
    return {name: sorted(int(f) for c, f in places if c == camera) for camera, name in enumerate(names)}


def _geometries(solved: Solved, world: WorldFromModel, joints: np.ndarray) -> list[ViewGeometry]:
    """At every shared frame, about the person, or where the cameras look."""
    person = np.median(world.points(joints), axis=0) if len(joints) else world.points(look_at_point(solved.poses))
    poses = world.poses(solved.shared_poses())
    return [view_geometry(solved.lens[:, 0], poses[:, frame], person) for frame in range(poses.shape[1])]


def make_record(
    capture: Capture,
    solved: Solved,
    scale: Scale,
    gravity: Gravity,
    world: WorldFromModel,
    joints: Float[np.ndarray, "joint 3"],
    seconds: float,
) -> dict[str, Any]:
    """What `calibration.json` holds. Lengths are metres, angles degrees, residuals pixels; frames are those of each
    camera's own video."""
    tables, names = solved.tables, capture.camera_names
    geometries = _geometries(solved, world, joints)
    middle = sorted(geometries, key=lambda geometry: geometry.angle)[len(geometries) // 2]
    worst = min(geometries, key=lambda geometry: geometry.angle)
    found = _list(tables["interpolated"], names)
    cameras = {}
    for camera, name in enumerate(names):
        mine = solved.places[:, 0] == camera
        focal, _, _, radial = solved.lens[camera]
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
            "median_observations": int(np.median(tables["num_observations"][mine])),
            "centre_deviation_m": round(float(world.scale * np.median(tables["centre_deviation"][mine])), 5),
            "rotation_deviation_degrees": round(float(np.degrees(np.median(tables["angle_deviation"][mine]))), 4),
        }
    warnings = [
        *gravity.warnings,
        *(
            f"{name}: {len(frames)} frames could not be placed and lie between their neighbours; do not select them"
            for name, frames in found.items()
            if frames
        ),
    ]
    return {
        "format": 1,
        "cameras": cameras,
        "points": len(solved.points),
        "mean_track_length": round(float(np.mean(tables["track_lengths"])), 1),
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


def pose_table(capture: Capture, solved: Solved, world: WorldFromModel) -> dict[str, Any]:
    """What `uncertainty.json` holds: per camera, one row per frame of its video."""
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
