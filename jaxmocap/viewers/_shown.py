"""What viewers in three dimensions show: a result, its images, the truth and a second result, frame by frame."""

import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from jaxmocap._results import InputError
from jaxmocap.capture import Capture
from jaxmocap.geometry import IDENTITY, align_cameras
from jaxmocap.metrics import Truth
from jaxmocap.motion import Motion

from ._first_view import frustum_size
from ._overlay import bone_indices
from ._video import positions_in_capture, view_in_capture

_IMAGE_SIDE = 640  # pixels of the longer side; enough to look at, quick to send
_MOMENTS = 60  # positions at which the person's way is looked at


@dataclass(frozen=True, eq=False)
class Shown:
    """A motion, and what there is to show beside it.

    Attributes:
        motion: the result.
        capture: whose images are shown; None without.
        positions: where the motion's frames are in the capture.
        truth: points in the motion's world, metres, NaN where unknown; None without.
        other: a second result of the same frames; None without.
        other_positions: where that result shows each frame; -1 where it does not.
        missing: sentences about what could not be had.
    """

    motion: Motion
    capture: Capture | None
    positions: tuple[int, ...]
    truth: Float[np.ndarray, "frame point 3"] | None
    other: Motion | None
    other_positions: Int[np.ndarray, " frame"]
    missing: tuple[str, ...]

    @property
    def camera_names(self) -> tuple[str, ...]:
        return () if self.motion.cameras is None else self.motion.cameras.names

    def image(self, view: int, index: int, side: int = _IMAGE_SIDE) -> UInt8[np.ndarray, "height width 3"] | None:
        """Read one view's image at a position of the motion, RGB, its longer side at most `side` pixels; None without a
        capture."""
        if self.capture is None:
            return None
        image = self.capture.image(view_in_capture(self.capture, self.camera_names[view]), self.positions[index])
        scale = min(side / max(image.shape[:2]), 1.0)
        return cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)

    @cached_property
    def people(self) -> Float[np.ndarray, "point 3"]:
        """Joints at moments of the whole clip, with the ground under them, metres."""
        joints = self.motion.joints[:: max(len(self.motion) // _MOMENTS, 1)].reshape(-1, 3).astype(np.float64)
        below = joints.copy()
        below[:, "xyz".index(self.motion.up)] = self.ground
        return np.concatenate([joints, below])

    @cached_property
    def ground(self) -> float:
        """Height of the ground: below it are hardly any joints, metres."""
        return float(np.percentile(self.motion.joints[..., "xyz".index(self.motion.up)], 1))

    def world_from_cam(self, view: int, index: int) -> Float[np.ndarray, "4 4"]:
        """Return where one camera is at a position of the motion."""
        assert self.motion.cameras is not None
        cam_from_world = np.asarray(self.motion.cameras.cam_from_world[view, index], np.float64)
        pose = np.eye(4)
        pose[:3, :3] = cam_from_world[:3, :3].T
        pose[:3, 3] = -pose[:3, :3] @ cam_from_world[:3, 3]
        return pose

    def frustum_depth(self, view: int) -> float:
        """Compute how far a camera's drawn picture is from it, so that the frustum is a tenth of the scene, metres."""
        cameras = self.motion.cameras
        assert cameras is not None
        tangents = np.array(cameras.sizes[view]) / np.diag(np.asarray(cameras.intrinsics[view]))[:2]
        centres = np.array([self.world_from_cam(number, 0)[:3, 3] for number in range(len(cameras.names))])
        return frustum_size(self.people, centres) / max(1.0, *tangents.tolist())

    def frustum(self, view: int, index: int) -> Float[np.ndarray, "5 3"]:
        """Find the corners of a camera's drawn frustum: its centre, and its picture's corners in order, metres."""
        cameras, depth = self.motion.cameras, self.frustum_depth(view)
        assert cameras is not None
        half = depth * np.array(cameras.sizes[view]) / (2 * np.diag(np.asarray(cameras.intrinsics[view]))[:2])
        signs = np.array([[0, 0, 0], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]])
        pose = self.world_from_cam(view, index)
        return signs * [*half, depth] @ pose[:3, :3].T + pose[:3, 3]

    def scene(self, index: int) -> tuple[Float[np.ndarray, "point 3"], Float[np.ndarray, "camera 5 3"], int]:
        """Gather what the first view frames: the person's points, the frusta, and which axis is vertical."""
        frusta = [self.frustum(view, index) for view in range(len(self.camera_names))]
        return self.people, np.array(frusta).reshape(-1, 5, 3), "xyz".index(self.motion.up)

    def bones(self, motion: Motion, index: int) -> Float[np.ndarray, "bone 2 3"]:
        """Find both ends of the skeleton's bones, metres."""
        return motion.joints[index][bone_indices(motion.joint_names)]

    def aside(self) -> tuple[float, float, float]:
        """Return where a second result stands beside the first: 1.5 metres to the right as the first camera sees it."""
        cameras = self.motion.cameras
        right = np.array([1.0, 0.0, 0.0] if cameras is None else cameras.cam_from_world[0, 0, 0, :3], float)
        level = np.arange(3) != "xyz".index(self.motion.up)  # a camera that leans must not lift it
        right = level * right / max(float(np.linalg.norm(level * right)), 1e-6)
        x, y, z = (1.5 * float(value) for value in right)
        return x, y, z

    def other_at(self, index: int) -> int | None:
        """Find where the second motion shows the same frame; None where it does not."""
        found = int(self.other_positions[index])
        return None if self.other is None or found < 0 else found


def gather(
    result: Motion | str | os.PathLike[str],
    other: Motion | str | os.PathLike[str] | None = None,
    truth: str | os.PathLike[str] | None = None,
    capture: Capture | str | os.PathLike[str] | None = None,
) -> Shown:
    """Gather all there is to show of a result.

    The capture and its truth are those that the result was tracked in, unless others are given; where those are gone it
    is shown without. Raises `InputError` for what is given and unusable.
    """
    motion = result if isinstance(result, Motion) else Motion.load(result)
    missing: list[str] = []
    opened, positions = _capture_of(motion, capture, missing)
    compared = other if other is None or isinstance(other, Motion) else Motion.load(other)
    found = np.full(len(motion), -1)
    if compared is not None:
        places = {int(frame): place for place, frame in enumerate(compared.frames)}
        found = np.array([places.get(int(frame), -1) for frame in motion.frames])
        if (found < 0).all():
            raise InputError("The two results have no frame in common; are they of the same capture?")
    points = _truth_of(motion, truth, missing)
    return Shown(motion, opened, positions, points, compared, found, tuple(missing))


def _capture_of(
    motion: Motion, given: Capture | str | os.PathLike[str] | None, missing: list[str]
) -> tuple[Capture | None, tuple[int, ...]]:
    recorded = motion.provenance.get("capture")
    if given is None and not recorded:
        missing.append("The result does not say in which capture it was tracked; it is shown without images.")
        return None, ()
    try:
        opened = given if isinstance(given, Capture) else Capture.open(str(given or recorded))
        for name in () if motion.cameras is None else motion.cameras.names:
            view_in_capture(opened, name)
        return opened, tuple(positions_in_capture(opened, motion))
    except InputError as error:
        if given is not None:
            raise
        missing.append(f"It is shown without images: {error}")
        return None, ()


def _truth_of(
    motion: Motion, given: str | os.PathLike[str] | None, missing: list[str]
) -> Float[np.ndarray, "frame point 3"] | None:
    """Markers, else joints, of the truth at the motion's frames and in its world."""
    path = given or motion.provenance.get("truth")
    if not path:
        return None
    if given is None and not Path(path).is_file():
        missing.append(f"The truth {path} is no longer there; it is shown without.")
        return None
    try:
        truth, evaluated = Truth.read(path).at(motion)
        placed = IDENTITY
        if truth.cam_from_world is not None and evaluated.cameras is not None:
            ours, true = truth.camera_pairs(evaluated)
            placed = align_cameras(true, ours)
    except InputError as error:
        if given is not None:
            raise
        missing.append(f"It is shown without the truth: {error}")
        return None
    points = truth.markers if truth.markers is not None else truth.joints
    assert points is not None  # a truth file has one of them
    everywhere = np.full((len(motion), *points.shape[1:]), np.nan)
    everywhere[np.isin(motion.frames, evaluated.frames)] = placed(points)
    return everywhere
