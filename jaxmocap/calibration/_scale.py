"""The model's scale: from the person's bones or height, or from the distance between two cameras."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_array

from jaxmocap._results import InputError
from jaxmocap.capture import KEYPOINT_NAMES, Capture

from ._child import Solved
from ._footage import CONFIDENT
from ._levenberg_marquardt import factors, minimise
from ._subject import BONES, SubjectView, confident, triangulate_views

_JOINTS = sorted({joint for pairs in BONES.values() for pair in pairs for joint in pair})
_INDEX = np.array([KEYPOINT_NAMES.index(joint) for joint in _JOINTS])
_PIXEL_SIGMA = 3.0  # of a detector, pixels at a width of 960
_BONE_SIGMA = 0.04  # of a bone's length: a detector's joints are not the skeleton's
FEWEST_BONES = 4
MOST_INSTANTS = 36
"""As many instants at the most are used to find the scale."""
_HEIGHT_DEVIATION = 0.04  # limbs of people of one height differ by this


class Scale(NamedTuple):
    """The model's scale.

    Attributes:
        metres_per_unit: of the model.
        deviation: its standard deviation, relative.
        source: what it was found from.
        num_bones: number of bones that were measured; 0 where it was not found from bones.
        num_frames: number of frames in which they were measured.
    """

    metres_per_unit: float
    deviation: float
    source: str
    num_bones: int = 0
    num_frames: int = 0


def fit_scale(views: Sequence[SubjectView], lengths: Mapping[str, float], source: str, width: int) -> Scale | None:
    """Find the scale at which the person's bones have these lengths (metres); None if fewer than four bones are seen.

    Joints and scale are solved for together (maximum likelihood of keypoints and lengths), since lengths between noisy
    points taken one by one come out too long. `width` of the images in pixels sets the keypoints' noise. Of more than
    `MOST_INSTANTS` instants so many are used, spread evenly: keypoints of neighbouring frames err alike.
    """
    if len(views) > MOST_INSTANTS:
        views = [views[i] for i in np.linspace(0, len(views) - 1, MOST_INSTANTS).round().astype(int)]
    starts = [triangulate_views(view)[_INDEX] for view in views]
    known = np.stack([np.isfinite(points).all(axis=1) for points in starts])
    bones = [
        (number, _JOINTS.index(a), _JOINTS.index(b), lengths[name])
        for number in range(len(views))
        for name, pairs in BONES.items()
        if name in lengths
        for a, b in pairs
        if known[number][_JOINTS.index(a)] and known[number][_JOINTS.index(b)]
    ]
    if len(bones) < FEWEST_BONES:
        return None
    first = np.array([np.linalg.norm(starts[n][a] - starts[n][b]) / length for n, a, b, length in bones])
    start = float(-np.log(np.median(first)))
    unit = float(np.exp(-start))  # model units of a metre, so that all unknowns are near one
    numbers = np.cumsum(known).reshape(known.shape) - 1  # of the joints that are solved for
    ends = np.array([(numbers[n, a], numbers[n, b]) for n, a, b, _ in bones])
    problem = _ScaleProblem(
        _sightings(views, known, numbers),
        ends,
        np.array([length for *_, length in bones]),
        _PIXEL_SIGMA * width / 960,
        start,
        unit,
    )
    initial = np.append(np.concatenate([p[k] for p, k in zip(starts, known, strict=True)]).ravel() / unit, 0.0)
    found, _, normal = minimise(problem, initial)
    last = np.zeros(found.size)
    last[-1] = 1.0
    variance = factors(normal).solve(last)[-1]
    return Scale(float(np.exp(start + found[-1])), float(np.sqrt(variance)), source, len(bones), len(views))


class _Sightings(NamedTuple):
    """Keypoints that are looked at: the number of the joint, the matrix from world to pixels, and the pixel."""

    joint: Int[np.ndarray, "sighting"]
    matrix: Float[np.ndarray, "sighting 3 4"]
    pixel: Float[np.ndarray, "sighting 2"]


def _sightings(
    views: Sequence[SubjectView], known: Bool[np.ndarray, "instant joint"], numbers: Int[np.ndarray, "instant joint"]
) -> _Sightings:
    joints, matrices, pixels = [], [], []
    for view, these, own in zip(views, known, numbers, strict=True):
        for camera, projection in enumerate(view.intrinsics @ view.cam_from_world[:, :3]):
            found = view.keypoints[camera][_INDEX]
            usable = these & (found[:, 2] >= CONFIDENT)
            joints.append(own[usable])
            matrices.append(np.broadcast_to(projection, (int(usable.sum()), 3, 4)))
            pixels.append(found[usable, :2])
    return _Sightings(np.concatenate(joints), np.concatenate(matrices), np.concatenate(pixels))


class _ScaleProblem(NamedTuple):
    """Residuals of keypoints and bone lengths, and their sparse Jacobian: a keypoint tells of one joint, a bone of two
    and of the scale. Unknowns are the joints in metres of the start's scale, and the logarithm of the rest."""

    seen: _Sightings
    ends: Int[np.ndarray, "bone 2"]
    lengths: Float[np.ndarray, "bone"]
    sigma: float
    start: float
    unit: float

    def residuals(self, values: Float[np.ndarray, "unknown"]) -> Float[np.ndarray, "row"]:
        points = self.unit * values[:-1].reshape(-1, 3)
        image = self._image(points)
        off = (image[:, :2] / image[:, 2:] - self.seen.pixel) / self.sigma
        across = points[self.ends[:, 0]] - points[self.ends[:, 1]]
        stretch = np.exp(self.start + values[-1])
        bones = (stretch * np.linalg.norm(across, axis=1) / self.lengths - 1) / _BONE_SIGMA
        return np.concatenate([off.ravel(), bones])

    def jacobian(self, values: Float[np.ndarray, "unknown"]) -> csr_array:
        points = self.unit * values[:-1].reshape(-1, 3)
        image, turned = self._image(points), self.seen.matrix[:, :, :3]
        shown = image[:, :2, None] * turned[:, 2:] / image[:, 2, None, None] ** 2
        moved = self.unit * (turned[:, :2] / image[:, 2, None, None] - shown) / self.sigma
        across = points[self.ends[:, 0]] - points[self.ends[:, 1]]
        long = np.linalg.norm(across, axis=1)
        pull = np.exp(self.start + values[-1]) / self.lengths / _BONE_SIGMA
        along = self.unit * (pull / long)[:, None] * across
        sightings, bones = len(self.seen.joint), len(self.ends)
        axes, first = np.arange(3), 2 * sightings + np.arange(bones)
        rows = [np.repeat(np.arange(2 * sightings), 3), np.repeat(first, 3), np.repeat(first, 3), first]
        columns = [
            np.repeat(3 * self.seen.joint, 6) + np.tile(axes, 2 * sightings),
            (3 * self.ends[:, :1] + axes).ravel(),
            (3 * self.ends[:, 1:] + axes).ravel(),
            np.full(bones, values.size - 1),
        ]
        entries = [moved.ravel(), along.ravel(), -along.ravel(), pull * long]
        where = np.concatenate(rows), np.concatenate(columns)
        return csr_array((np.concatenate(entries), where), shape=(2 * sightings + bones, values.size))

    def _image(self, points: Float[np.ndarray, "joint 3"]) -> Float[np.ndarray, "sighting 3"]:
        matrix = self.seen.matrix
        return np.einsum("nij,nj->ni", matrix[:, :, :3], points[self.seen.joint]) + matrix[:, :, 3]


def refuse_without_scale(
    capture: Capture, lengths: dict[str, float], keypoints: dict[int, np.ndarray], distance: float | None
) -> None:
    """Raise `InputError`, before the long run, where nothing tells the scale."""
    if distance is not None:
        return
    how = "or give the metres between the first two cameras at their first shared frame with --camera-distance"
    if not lengths:
        raise InputError(
            f"capture '{capture.name}' has no actor to tell its scale: give the person's height with --height, {how}"
        )
    most = max((confident(found, lengths) for found in keypoints.values()), default=0)
    having = [name for camera, name in enumerate(capture.camera_names) if capture.keypoint_frames(camera)]
    if most < FEWEST_BONES and len(having) == 1:
        raise InputError(
            f"only '{having[0]}' has keypoints, and the person's size cannot be measured in one view: add keypoints of "
            f"another camera at the same frames (jaxmocap detect {capture.folder}), {how}"
        )
    if most < FEWEST_BONES:
        raise InputError(
            f"capture '{capture.name}' has no frame with keypoints of the person's limbs in two cameras among those "
            f"wanted (at best {most} bones are seen, {FEWEST_BONES} are needed), so its scale cannot be told: add "
            f"keypoints, {how}"
        )


def find_scale(
    solved: Solved,
    views: list[SubjectView],
    lengths: dict[str, float],
    source: str,
    distance: float | None,
) -> Scale:
    """Find the scale from the metres between the first two cameras where given, else from the person.

    Raises `InputError` where the keypoints make no person, or those cameras stand too close together.
    """
    if distance is not None:
        first, second = (-pose[:3, :3].T @ pose[:3, 3] for pose in (solved.pose(0, 0), solved.pose(1, 0)))
        apart = float(np.linalg.norm(first - second))
        if apart < 0.005 * solved.distance:
            raise InputError(
                f"the first two cameras stand {100 * apart / solved.distance:.1f} % of the distance to the scene apart "
                "at their first shared frame, too close for --camera-distance; give --height instead"
            )
        return Scale(distance / apart, 0.02, "camera distance")
    scale = fit_scale(views, lengths, source, max(max(size) for size in solved.sizes))
    if scale is None:
        raise InputError(
            "the keypoints do not triangulate to a person in front of the cameras, so the scale cannot be told; check "
            "that they belong to these cameras and frames, and that offset in capture.toml is right"
        )
    if source == "height":
        return scale._replace(deviation=float(np.hypot(scale.deviation, _HEIGHT_DEVIATION)))
    return scale
