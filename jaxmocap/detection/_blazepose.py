"""BlazePose: a network that finds people by anchors, and one that finds 33 landmarks in a turned square.

Bazarevsky, Grishchenko, Raveendran, Zhu, Zhang, Grundmann: BlazePose: On-device Real-time Body Pose tracking, 2020. The
numbers are those of MediaPipe's graphs pose_detection_cpu and pose_landmark_by_roi_cpu.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from ._layouts import BLAZEPOSE_33
from ._left_right import exchanged, mirrored_points
from ._person_model import Network, Sighting, Silhouette
from ._region import Region, brightened, whole

_FINDER, _SQUARE = 224, 256  # pixels of the two networks' pictures
PERSON_SHAPES = ((1, _FINDER, _FINDER, 3), (1, 2254, 12), (1, 2254, 1))
LANDMARK_SHAPES = ((1, _SQUARE, _SQUARE, 3), (1, 195), (1, 1), (1, _SQUARE, _SQUARE, 1), (1, 64, 64, 39), (1, 117))
"""Of each network's input and outputs."""

_STRIDES = {8: 2, 16: 2, 32: 6}  # anchors at every cell of so many pixels
_CERTAIN, _SAME_PERSON = 0.5, 0.3  # score of a person; overlap from which two boxes are one person
_HIPS, _RIM = 33, 34  # landmarks that tell the region
_HEAT_WINDOW, _HEAT_CERTAIN = 3, 0.5
_MIRRORED = [*mirrored_points(BLAZEPOSE_33), _HIPS, _RIM]


@dataclass(frozen=True)
class BlazePose:
    """The two networks.

    Attributes:
        person, landmarks: the networks.
        mirrored: whether the mirror image of the square is looked at too. It takes twice the time, brings the points
            up to 5 % nearer (measured on three captures) and tells when a network doubts itself. Moving the square to
            what was seen in it and looking again brought no more.
    """

    person: Network
    landmarks: Network
    mirrored: bool = True

    def find(
        self, picture: UInt8[np.ndarray, "height width 3"], part: Region | None = None, *, thorough: bool = True
    ) -> list[Region]:
        """Find everybody in a part of an RGB picture or in all of it, the most certain first.

        Where nobody is found and `thorough`, quarters of that are searched, in which people look larger.
        """
        picture = brightened(picture)
        everywhere = part or whole(picture)
        found = self._found(picture, [everywhere])
        if not found and thorough:
            height, width = picture.shape[:2]
            (x, y), half = everywhere.centre, everywhere.side / 2
            centres = [(x + across * half / 2, y + down * half / 2) for down in (-1, 0, 1) for across in (-1, 0, 1)]
            found = self._found(
                picture, [Region(c, half) for c in centres if 0 <= c[0] <= width and 0 <= c[1] <= height]
            )
        return [region for _, _, region in _one_each(found)]

    def _found(self, picture: np.ndarray, parts: list[Region]) -> list["_Found"]:
        squares = np.stack([part.cut(picture, _FINDER) for part in parts]).astype(np.float32) / 127.5 - 1
        result = []
        for part, boxes, scores in zip(parts, *self.person(squares), strict=True):
            likely = np.flatnonzero(scores[:, 0] > np.log(_CERTAIN / (1 - _CERTAIN)))
            values = boxes[likely].astype(np.float64).reshape(-1, 6, 2) / _FINDER
            values[:, [0, 2, 3, 4, 5]] += _anchors()[likely, None]
            for score, (centre, size, hips, rim, _, _) in zip(scores[likely, 0], values, strict=True):
                low, high = part.to_picture(np.array([centre - size / 2, centre + size / 2]))
                hips, rim = part.to_picture(np.array([hips, rim]))
                result.append((float(_sigmoid(score)), np.concatenate([low, high]), Region.around(hips, rim)))
        return result

    def look(self, picture: UInt8[np.ndarray, "height width 3"], region: Region) -> Sighting:
        """Look at the person in a region of an RGB picture: the mean of what the square and its mirror image show."""
        square = brightened(region.cut(picture, _SQUARE)).astype(np.float32) / 255
        squares = np.stack([square, square[:, ::-1]]) if self.mirrored else square[None]
        values, presence, shown, heat, _ = self.landmarks(squares)
        answers = [_landmarks(*one) for one in zip(values, heat, strict=True)]
        points, doubt, evidence = answers[0], 0.0, shown[0, ..., 0]
        if self.mirrored:
            other = answers[1][_MIRRORED] * (-1, 1, 1) + (1, 0, 0)
            if exchanged(points[:33], other[:33], BLAZEPOSE_33):  # their mean would lie on a line down the middle
                other = other[_MIRRORED]
            doubt = float(np.median(np.linalg.norm((points - other)[:33, :2], axis=-1)))
            points = (points + other) / 2
            evidence = (evidence + shown[1, :, ::-1, 0]) / 2
        points[:, :2] = region.to_picture(points[:, :2])
        next_region = Region.around(points[_HIPS, :2], points[_RIM, :2])
        silhouette = Silhouette(region, evidence.astype(np.float32))
        return Sighting(points[:33], float(presence[0].item()), next_region, doubt, silhouette)


_Found = tuple[float, Float64[np.ndarray, "4"], Region]
"""Score, box (left, top, right, bottom) and region of a person."""


@lru_cache(maxsize=1)
def _anchors() -> Float64[np.ndarray, "2254 2"]:
    """Centres of the finder's anchors, as shares of its picture; all anchors have its whole size."""
    centres = []
    for stride, count in _STRIDES.items():
        cells = (np.arange(_FINDER // stride) + 0.5) * stride / _FINDER
        x, y = np.meshgrid(cells, cells)
        centres.append(np.repeat(np.column_stack([x.ravel(), y.ravel()]), count, axis=0))
    return np.concatenate(centres)


def _one_each(found: list[_Found]) -> list[_Found]:
    """Keep the most certain of every group of overlapping boxes."""
    kept: list[_Found] = []
    for one in sorted(found, key=lambda one: -one[0]):
        if all(_overlap(one[1], other[1]) < _SAME_PERSON for other in kept):
            kept.append(one)
    return kept


def _overlap(first: np.ndarray, second: np.ndarray) -> float:
    """Intersection over union."""
    sides = np.clip(np.minimum(first[2:], second[2:]) - np.maximum(first[:2], second[:2]), 0, None)
    shared = float(sides.prod())
    areas = [float(np.clip(box[2:] - box[:2], 0, None).prod()) for box in (first, second)]
    return shared / max(sum(areas) - shared, 1e-9)


def _landmarks(
    values: Float32[np.ndarray, "195"], heat: Float32[np.ndarray, "rows columns 39"]
) -> Float64[np.ndarray, "35 3"]:
    """Landmarks as shares of the square, and confidence."""
    rows = values.reshape(39, 5)[:35].astype(np.float64)
    return np.column_stack([_refined(rows[:, :2] / _SQUARE, heat), _sigmoid(rows[:, 3:]).min(axis=1)])


def _refined(
    places: Float64[np.ndarray, "35 2"], heat: Float32[np.ndarray, "rows columns 39"]
) -> Float64[np.ndarray, "35 2"]:
    """Move landmarks to the middle of their heat map's mass around them, where it is certain of them (MediaPipe's
    RefineLandmarksFromHeatmapCalculator)."""
    rows, columns = heat.shape[:2]
    result = places.copy()
    for number, (x, y) in enumerate(places):
        column, row = int(np.floor(x * columns)), int(np.floor(y * rows))
        if not (0 <= column < columns and 0 <= row < rows):
            continue
        top, left = max(row - _HEAT_WINDOW, 0), max(column - _HEAT_WINDOW, 0)
        mass = _sigmoid(heat[top : row + _HEAT_WINDOW + 1, left : column + _HEAT_WINDOW + 1, number])
        if mass.max() >= _HEAT_CERTAIN:
            down, across = np.mgrid[top : top + mass.shape[0], left : left + mass.shape[1]]
            result[number] = (mass * across).sum() / columns, (mass * down).sum() / rows
            result[number] /= mass.sum()
    return result


def _sigmoid(values: np.ndarray) -> np.ndarray:
    return 1 / (1 + np.exp(-np.clip(values.astype(np.float64), -50, 50)))
