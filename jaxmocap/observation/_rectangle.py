"""The rectangle of sec. 4.1 that bounds the pixels scored in a frame."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from jaxmocap._results import InputError
from jaxmocap.camera import Cameras

SIDES = (540, 768, 1080, 1536, 2160)
"""Pixels of both sides, where the picture is as large: few shapes, so that the programs compiled for one capture serve
the next. The first is the shorter side of the usual picture, held upright or not; a smaller picture's own comes before
it. A frame of street took 1 to 6 % longer with 448 x 448 pixels than with 448 x 256.
"""
SLACK = 1.05
"""A new size is this much larger than needed."""


@dataclass(frozen=True)
class Rectangle:
    """One size for all views, each view's first row and column in the full image (multiples of 4), and `area`, the mean
    number of pixels of the views' tight rectangles (M_1 of Eq. 6)."""

    origins: Int[np.ndarray, "camera 2"]
    height: int
    width: int
    area: float

    @property
    def size(self) -> tuple[int, int]:
        """Height and width."""
        return self.height, self.width

    def crop(self, image: np.ndarray, camera: int) -> np.ndarray:
        """Crop one view's image to its rectangle."""
        return image[self.window(camera)]

    def window(self, camera: int) -> tuple[slice, slice]:
        """Return rows and columns of one view's rectangle in the full image."""
        row, column = (int(start) for start in self.origins[camera])
        return slice(row, row + self.height), slice(column, column + self.width)


def projected_box(
    vertices: Float[np.ndarray, "vertex 3"],
    intrinsics: Float[np.ndarray, "3 3"],
    cam_from_world: Float[np.ndarray, "4 4"],
) -> Float[np.ndarray, "4"] | None:
    """Find the bounding box (left, top, right, bottom) in pixels; None when nothing lies in front of the camera."""
    local = vertices @ cam_from_world[:3, :3].T + cam_from_world[:3, 3]
    local = local[local[:, 2] > 0.05]
    if not len(local):
        return None
    pixels = local @ intrinsics.T
    pixels = pixels[:, :2] / pixels[:, 2:]
    return np.concatenate([pixels.min(0), pixels.max(0)])


def place_rectangle(
    boxes: Float[np.ndarray, "camera 4"],
    flow_speed: Float[np.ndarray, "camera"],
    sizes: tuple[tuple[int, int], ...],
    previous: Rectangle | None = None,
    names: tuple[str, ...] = (),
) -> Rectangle:
    """Widen the boxes of the predicted silhouette and give them a common size that never shrinks within a sequence.

    They are widened by the larger of 10 % of their size, 1.5 times the mean flow and 20 pixels.

    Raises `InputError` when a box lies entirely outside its image: the character left that camera's view.
    """
    boxes = boxes.copy()
    for camera, (width, height) in enumerate(sizes):
        left, top, right, bottom = boxes[camera]
        if right < 0 or bottom < 0 or left > width or top > height:
            name = names[camera] if names else str(camera)
            raise InputError(
                f"The projected character left the image of camera '{name}'; "
                "check the cameras or the initial pose, or track only frames in which every camera sees the person."
            )
        margin = max(0.1 * max(right - left, bottom - top), 1.5 * float(flow_speed[camera]), 20.0)
        boxes[camera] = (left - margin, top - margin, right + margin, bottom + margin)
        boxes[camera, 0::2] = np.clip(boxes[camera, 0::2], 0, width)
        boxes[camera, 1::2] = np.clip(boxes[camera, 1::2], 0, height)
    extent = boxes[:, 2:] - boxes[:, :2]
    limit = np.min(np.asarray(sizes), axis=0) // 4 * 4
    need = np.minimum(extent.max(axis=0), limit)
    if previous is not None and (need <= (previous.width, previous.height)).all():
        width, height = previous.width, previous.height
    else:
        sides = (limit.min(), *SIDES) if limit.min() < SIDES[0] else SIDES
        wanted = np.minimum(SLACK * need, limit)
        side = next((side for side in sides if (wanted <= np.minimum(side, limit)).all()), limit.max())
        width, height = (int(min(side, most)) for most in limit)
    origins = []
    for camera, (full_width, full_height) in enumerate(sizes):
        centre = 0.5 * (boxes[camera, :2] + boxes[camera, 2:])
        column = int(np.clip(centre[0] - width / 2, 0, full_width - width)) // 4 * 4
        row = int(np.clip(centre[1] - height / 2, 0, full_height - height)) // 4 * 4
        origins.append((row, column))
    return Rectangle(np.array(origins), height, width, float(np.prod(extent, axis=1).mean()))


def frame_rectangle(
    vertices: np.ndarray,
    cameras: Cameras,
    frame: int,
    previous: Rectangle | None = None,
    speed: np.ndarray | None = None,
) -> Rectangle:
    """Place the rectangle around a posed mesh in every view."""
    view = cameras.at(frame)
    intrinsics, cam_from_world = np.asarray(view.intrinsics), np.asarray(view.cam_from_world)
    boxes = []
    for camera, name in enumerate(cameras.names):
        box = projected_box(vertices, intrinsics[camera], cam_from_world[camera])
        if box is None:
            raise InputError(
                f"the person lies behind camera '{name}' at frame {frame}; check the cameras and the keypoints."
            )
        boxes.append(box)
    still = np.zeros(cameras.num_cameras) if speed is None else speed
    return place_rectangle(np.stack(boxes), still, cameras.sizes, previous, cameras.names)
