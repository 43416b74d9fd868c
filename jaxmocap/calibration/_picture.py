"""A picture of the cameras' paths, the points and the person: from above and from the side."""

from collections.abc import Collection

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from jaxmocap.camera import read_colmap_points
from jaxmocap.capture import Capture, triangulated_people

_SIZE = 700
_COLOURS = ((230, 60, 40), (40, 110, 230), (30, 160, 60), (200, 120, 0), (140, 60, 200))


def draw_paths(
    capture: Capture,
    poses: Float[np.ndarray, "camera frame 4 4"],
    points: Float[np.ndarray, "point 3"],
    person: Float[np.ndarray, "joint 3"],
    interpolated: Collection[tuple[int, int]] = (),
) -> UInt8[np.ndarray, "height width 3"]:
    """RGB; left from above, right from the side, both in metres with a bar of one metre. Points are grey, the person's
    joints black; every tenth pose has a stroke that shows where it looks; poses `interpolated` (camera, frame of its
    own video) are rings."""
    centres = -np.einsum("ctji,ctj->cti", poses[..., :3, :3], poses[..., :3, 3])
    above = np.array([[1, 0, 0], [0, 0, 1]] if capture.up == "y" else [[1, 0, 0], [0, -1, 0]], float)
    side = np.array([[1, 0, 0], [0, -1, 0]] if capture.up == "y" else [[1, 0, 0], [0, 0, -1]], float)
    content = np.concatenate([centres.reshape(-1, 3), person.reshape(-1, 3), np.zeros((1, 3))])
    low, high = content.min(0) - 1.0, content.max(0) + 1.0
    panels = []
    for title, axes in (("from above", above), ("from the side", side)):
        corners = np.sort(np.stack([axes @ low, axes @ high]), axis=0)
        scale = _SIZE / float((corners[1] - corners[0]).max())
        image = np.full((_SIZE, _SIZE, 3), 255, np.uint8)

        def pixel(value: np.ndarray, axes=axes, corners=corners, scale=scale) -> tuple[int, int]:
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
    """The picture of `draw_paths` for a capture that has cameras: with the points of its COLMAP model, and the person's
    joints where keypoints are seen in two views. Raises `InputError` if there are no cameras."""
    cameras, folder = capture.cameras, capture.cameras_path
    people = triangulated_people(capture, cameras, [])
    joints = np.concatenate([points[np.isfinite(points).all(1)] for points in people.values()] or [np.zeros((0, 3))])
    points = np.zeros((0, 3))
    if folder is not None and folder.is_dir():
        points = capture.metres_per_unit * read_colmap_points(folder)[0]
    return draw_paths(capture, np.asarray(cameras.cam_from_world, float), points, joints)


def png_bytes(image: UInt8[np.ndarray, "height width 3"]) -> bytes:
    """The image as a PNG file."""
    done, data = cv2.imencode(".png", np.ascontiguousarray(image[..., ::-1]))
    assert done
    return data.tobytes()
