"""A model that single frames are placed in: features matched with placed key frames, then perspective-n-point."""

from dataclasses import dataclass, field

import cv2  # noqa: F401  (before pycolmap: the other order crashes)
import numpy as np
import pycolmap
from jaxtyping import Float, Int

from ._features import Features, match
from ._footage import Footage
from ._matching import FEWEST_SEEN, Place, frame_pairs

_MAX_ERROR = 3.0  # pixels at a width of 960
_SMALLEST_SHARE = 0.2
_GUIDED_REACH = 12.0  # pixels at a width of 960


@dataclass
class Sightings:
    """The points of the model that a frame may see, some of them false.

    Attributes:
        pixels: where they are seen.
        points: their ids in the model.
        slots: their rows in `keypoints`.
        keypoints: those that the frame's image has, or will have: COLMAP lets an image have them once.
    """

    pixels: Float[np.ndarray, "sighting 2"]
    points: Int[np.ndarray, " sighting"]
    slots: Int[np.ndarray, " sighting"]
    keypoints: Float[np.ndarray, "keypoint 2"]


@dataclass
class PlacedFrame:
    """A frame that was placed.

    Attributes:
        cam_from_world: its pose.
        sightings: those that agree with the pose.
    """

    cam_from_world: pycolmap.Rigid3d
    sightings: Sightings


@dataclass
class Model:
    """A reconstruction that frames are added to.

    Attributes:
        footage: what it is made of.
        reconstruction: COLMAP's; lens i + 1 is that of camera i.
        features: those of the key frames.
        images: ids of the images by camera and frame; filled in from `reconstruction`.
    """

    footage: Footage
    reconstruction: pycolmap.Reconstruction
    features: dict[Place, Features]
    images: dict[Place, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for image in self.reconstruction.images.values():
            self.images[self.place_of(image)] = image.image_id

    @staticmethod
    def place_of(image: pycolmap.Image) -> Place:
        """Read camera and frame from an image's id and name."""
        return image.camera_id - 1, int(image.name.rsplit("/", 1)[1].removesuffix(".png"))

    def pose(self, place: Place) -> np.ndarray | None:
        """Look up cam_from_world (4, 4) of a frame; None if it has none."""
        image = self.reconstruction.images[self.images[place]] if place in self.images else None
        if image is None or not image.has_pose:
            return None
        pose = np.eye(4)
        pose[:3] = image.cam_from_world().matrix()
        return pose

    def remove(self, place: Place) -> None:
        """Take a frame's pose and observations out."""
        self.reconstruction.deregister_frame(self.reconstruction.images[self.images[place]].frame_id)

    def sightings(self, place: Place, features: Features) -> Sightings:
        """Match a frame's features with placed key frames around it; of several points the most frequent counts."""
        votes: dict[tuple[int, int], int] = {}
        for key in frame_pairs(self.footage, *place):
            if key == place or self.pose(key) is None:
                continue
            seen = self.reconstruction.images[self.images[key]].points2D
            for own, other in match(features, self.features[key]):
                point = seen[int(other)]
                if point.has_point3D():
                    votes[int(own), point.point3D_id] = votes.get((int(own), point.point3D_id), 0) + 1
        chosen = {own: point for (own, point), _ in sorted(votes.items(), key=lambda item: (item[1], item[0]))}
        index = np.array(sorted(chosen), int)
        pixels, points = features.points[index].astype(float), np.array([chosen[i] for i in index], int)
        if place in self.features:
            return Sightings(pixels, points, index, features.points.astype(float))
        return Sightings(pixels, points, np.arange(len(index)), pixels)

    def place(self, camera: int, sightings: Sightings, predicted: np.ndarray | None = None) -> PlacedFrame | None:
        """Estimate the pose from what a frame sees (perspective-n-point with RANSAC); None if that is too little.

        Given a pose `predicted` (4, 4), it is refined with the sightings within 12 pixels of it, at a width of 960.
        """
        points3d = self.reconstruction.points3D
        alive = np.array([int(point) in points3d for point in sightings.points], bool)
        pixels, points, slots = sightings.pixels[alive], sightings.points[alive], sightings.slots[alive]
        places = np.array([points3d[int(point)].xyz for point in points]).reshape(-1, 3)
        lens = self.reconstruction.cameras[camera + 1]
        scale = max(self.footage.videos[camera].size) / 960
        if predicted is not None:
            rigid = pycolmap.Rigid3d(predicted[:3])
            near = _residuals(lens, rigid, places, pixels) < _GUIDED_REACH * scale
            if near.sum() < FEWEST_SEEN:
                return None
            found = pycolmap.refine_absolute_pose(rigid, pixels, places, near, lens)
        else:
            if len(pixels) < FEWEST_SEEN:
                return None
            options = pycolmap.AbsolutePoseEstimationOptions()
            options.ransac.max_error = _MAX_ERROR * scale
            options.ransac.random_seed = self.footage.seed
            found = pycolmap.estimate_and_refine_absolute_pose(pixels, places, lens, options)
        if found is None:
            return None
        rigid = found["cam_from_world"]
        agrees = _residuals(lens, rigid, places, pixels) < _MAX_ERROR * scale
        if agrees.sum() < max(FEWEST_SEEN, _SMALLEST_SHARE * len(pixels)):
            return None
        return PlacedFrame(rigid, Sightings(pixels[agrees], points[agrees], slots[agrees], sightings.keypoints))

    def add(self, place: Place, found: PlacedFrame) -> None:
        """Put a frame into the model, with its observations, instead of what there was of it."""
        if place in self.images:
            if self.pose(place) is not None:
                self.remove(place)
            image = self.reconstruction.images[self.images[place]]
            frame = self.reconstruction.frames[image.frame_id]
            frame.set_cam_from_world(image.camera_id, found.cam_from_world)
            self.reconstruction.register_frame(image.frame_id)
        else:
            camera, number = place
            image = pycolmap.Image(
                name=self.footage.videos[camera].image_name(number),
                keypoints=found.sightings.keypoints,
                camera_id=camera + 1,
                image_id=max(self.images.values(), default=0) + 1,
            )
            self.reconstruction.add_image_with_trivial_frame(image, found.cam_from_world)
            self.images[place] = image.image_id
        for slot, point in zip(found.sightings.slots, found.sightings.points, strict=True):
            self.reconstruction.add_observation(int(point), pycolmap.TrackElement(self.images[place], int(slot)))

    def add_without_points(self, place: Place, cam_from_world: np.ndarray) -> None:
        """Put a pose into the model that nothing seen supports."""
        empty = Sightings(np.zeros((0, 2)), np.zeros(0, int), np.zeros(0, int), np.zeros((0, 2)))
        self.add(place, PlacedFrame(pycolmap.Rigid3d(cam_from_world[:3]), empty))


def _residuals(lens: pycolmap.Camera, rigid: pycolmap.Rigid3d, points: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Reprojection errors in pixels; infinite behind the camera."""
    inside = points @ rigid.rotation.matrix().T + rigid.translation
    front = inside[:, 2] > 1e-6
    errors = np.full(len(points), np.inf)
    if front.any():
        errors[front] = np.linalg.norm(lens.img_from_cam(inside[front]) - pixels[front], axis=1)
    return errors
