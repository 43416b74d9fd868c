"""Frames between the key frames, placed by the points that key frames see, which are followed into them."""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Int, UInt8

from ._features import detect, person_mask, read_images
from ._footage import Report
from ._matching import Place
from ._registration import Model, PlacedFrame, Sightings

_MOST_FOLLOWED = 600  # points of a key frame, those seen by most others
_MOST_WAITING = 8  # frames in memory until the next key frame
_WINDOW, _LEVELS = 21, 4  # pixels; halvings
_STEPS = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.01)
_RETURN, _AGREE = 0.5, 1.0  # pixels at a width of 960

Grey = UInt8[np.ndarray, "height width"]


class _KeyFrame(NamedTuple):
    """A placed key frame: its picture, where it sees points of the model (pixels), and their ids."""

    grey: Grey
    pixels: Float32[np.ndarray, "point 2"]
    points: Int[np.ndarray, " point"]


def follow(
    before: Grey, after: Grey, pixels: Float32[np.ndarray, "point 2"], within: float
) -> tuple[Float32[np.ndarray, "point 2"], Bool[np.ndarray, " point"]]:
    """Follow points from one picture into another (pyramidal Lucas-Kanade, Bouguet 2001).

    Returns where they arrive, and whether they come back to `within` so many pixels of where they were.
    """
    if len(pixels) == 0:
        return pixels, np.zeros(0, bool)
    start = np.ascontiguousarray((pixels - 0.5)[:, None])
    size = _WINDOW, _WINDOW
    arrived, there, _ = cv2.calcOpticalFlowPyrLK(
        before, after, start, np.empty_like(start), winSize=size, maxLevel=_LEVELS, criteria=_STEPS
    )
    back, again, _ = cv2.calcOpticalFlowPyrLK(
        after, before, arrived, np.empty_like(start), winSize=size, maxLevel=_LEVELS, criteria=_STEPS
    )
    good = (there.ravel() == 1) & (again.ravel() == 1) & (np.linalg.norm((back - start)[:, 0], axis=1) < within)
    return arrived[:, 0] + 0.5, good


def place_other_frames(model: Model, report: Report) -> dict[Place, Sightings]:
    """Place every frame that has no pose yet; return what each of them may see, for another try.

    Points that the key frames before and after it see are followed into a frame. Where that does not place it, its own
    features are matched with key frames, which takes several times as long.
    """
    footage = model.footage
    sightings: dict[Place, Sightings] = {}
    found: dict[Place, PlacedFrame] = {}
    frames = [(camera, frame) for camera, video in enumerate(footage.videos) for frame in video.frames]
    missing = {place for place in frames if model.pose(place) is None}

    def place_waiting(camera: int, waiting: dict[int, np.ndarray], around: Sequence[_KeyFrame]) -> None:
        for frame, image in waiting.items():
            place, person = (camera, frame), person_mask(footage.videos[camera], frame)
            seen = _followed(around, cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), person)
            placed = model.place(camera, seen)
            if placed is None:
                seen = model.sightings(place, detect(image, person, footage.num_features))
                placed = model.place(camera, seen)
            sightings[place] = seen
            if placed is not None:
                found[place] = placed
            report("placing all frames", len(sightings), len(missing))
        waiting.clear()

    for camera, video in enumerate(footage.videos):
        keys = {key for key in footage.key_frames(camera) if (camera, key) not in missing}
        last: list[_KeyFrame] = []
        waiting: dict[int, np.ndarray] = {}
        for frame, image in read_images(video, [f for f in video.frames if f in keys or (camera, f) in missing]):
            if frame in keys:
                key = _key_frame(model, (camera, frame), image)
                place_waiting(camera, waiting, [*last, key])
                last = [key]
            else:
                waiting[frame] = image
                if len(waiting) > _MOST_WAITING:
                    place_waiting(camera, waiting, last)
        place_waiting(camera, waiting, last)
    for place, placed in found.items():  # after all were placed by key frames alone
        model.add(place, placed)
    return sightings


def _key_frame(model: Model, place: Place, image: UInt8[np.ndarray, "height width 3"]) -> _KeyFrame:
    points3d = model.reconstruction.points3D
    seen = [p for p in model.reconstruction.images[model.images[place]].points2D if p.has_point3D()]
    seen.sort(key=lambda p: (-points3d[p.point3D_id].track.length(), p.point3D_id))
    seen = seen[:_MOST_FOLLOWED]
    pixels = np.array([p.xy for p in seen], np.float32).reshape(-1, 2)
    return _KeyFrame(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), pixels, np.array([p.point3D_id for p in seen], int))


def _followed(around: Sequence[_KeyFrame], grey: Grey, person: Bool[np.ndarray, "height width"]) -> Sightings:
    """List the key frames' points where they arrive outside the person.

    A point of two key frames is the mean of both; where they disagree, it is left out.
    """
    scale = max(grey.shape) / 960
    places: dict[int, list[np.ndarray]] = {}
    for key in around:
        arrived, good = follow(key.grey, grey, key.pixels, _RETURN * scale)
        columns, rows = np.clip(arrived.astype(int), 0, np.array(grey.shape[::-1]) - 1).T
        good &= ~person[rows, columns]
        for point, pixel in zip(key.points[good].tolist(), arrived[good], strict=True):
            places.setdefault(point, []).append(pixel)
    agreed = {
        point: np.mean(seen, axis=0)
        for point, seen in places.items()
        if np.ptp(np.array(seen), axis=0).max() <= _AGREE * scale
    }
    pixels = np.array(list(agreed.values()), float).reshape(-1, 2)
    return Sightings(pixels, np.array(list(agreed), int), np.arange(len(agreed)), pixels)
