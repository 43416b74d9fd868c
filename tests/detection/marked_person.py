"""A drawn person with a known answer, and networks that read it: a red spot marks the hips and a green one the head.

The people of the pictures are a rigid figure: landmark n lies `FIGURE[n]` from the hips, in units of the distance to
the head, x to the side and y towards the head.
"""

import cv2
import numpy as np

from jaxmocap.detection import LAYOUTS
from jaxmocap.detection._blazepose import BlazePose

SIZE = (320, 240)
_side = {"l_": 1.0, "r_": -1.0}
FIGURE = np.array(
    [
        (_side.get(name[:2], 0.0) * (0.1 + 0.01 * (len(name) % 7)), 0.05 * (len(name) % 11) - 0.2)
        for name in LAYOUTS["blazepose33"].points
    ]
)


def answer(hips: np.ndarray, head: np.ndarray) -> np.ndarray:
    """The 33 points in the picture."""
    up = np.asarray(head, float) - hips
    side = np.array([-up[1], up[0]])  # to the right of a person drawn upright: their left, as they face us
    return np.asarray(hips, float) + FIGURE[:, :1] * side + FIGURE[:, 1:] * up


def draw(*people: tuple[np.ndarray, np.ndarray], level: int = 255, radius: int = 3) -> np.ndarray:
    """A picture of people, each given by hips and head."""
    picture = np.full((SIZE[1], SIZE[0], 3), level // 8, np.uint8)
    for number, spots in enumerate(zip(*people, strict=True)):
        for x, y in spots:
            colour = [0, 0, 0]
            colour[number] = level
            at = (round((x - 0.5) * 16), round((y - 0.5) * 16))
            cv2.circle(picture, at, radius * 16, colour, -1, cv2.LINE_AA, shift=4)
    return picture


def spots(square: np.ndarray, channel: int) -> list[np.ndarray]:
    """Centres of the spots of one colour in a picture of values 0 to 1, largest first; specks do not count."""
    weight = np.clip(square[..., channel] - square[..., [c for c in range(3) if c != channel]].max(-1), 0, None)
    weight[weight < 0.25] = 0
    count, labels, statistics, _ = cv2.connectedComponentsWithStats((weight > 0).astype(np.uint8))
    found, largest = [], 0.0
    for label in sorted(range(1, count), key=lambda one: -statistics[one, cv2.CC_STAT_AREA]):
        rows, columns = np.nonzero(labels == label)
        mass = weight[rows, columns]
        if mass.sum() < max(2, 0.3 * largest):
            continue
        largest = max(largest, mass.sum())
        found.append(np.array([(mass * columns).sum(), (mass * rows).sum()]) / mass.sum() + 0.5)
    return found


def find_marks(pictures: np.ndarray) -> list[np.ndarray]:
    """The person detector: for every red spot, the nearest green one is the head."""
    boxes, scores = np.zeros((len(pictures), 2254, 12), np.float32), np.full((len(pictures), 2254, 1), -9, np.float32)
    for number, picture in enumerate(pictures):
        red, green = (spots((picture + 1) / 2, channel) for channel in (0, 1))
        for hips in red if green else ():
            head = min(green, key=lambda one: np.linalg.norm(one - hips))
            cell = int(hips[1] // 8) * 28 + int(hips[0] // 8)
            anchor = (np.array([int(hips[0] // 8), int(hips[1] // 8)]) + 0.5) * 8
            reach = 2 * np.linalg.norm(head - hips)
            boxes[number, 2 * cell] = np.concatenate(
                [hips - anchor, [reach, reach], *[hips - anchor, head - anchor] * 2]
            )
            scores[number, 2 * cell] = 4.0
    return [boxes, scores]


def read_marks(pictures: np.ndarray) -> list[np.ndarray]:
    """The landmark network: the figure of the spots nearest to the middle, and a disc about the hips, half as wide as
    the head is high, for the silhouette."""
    count = len(pictures)
    evidence = np.full((count, 256, 256, 1), -9, np.float32)
    places = np.mgrid[:256, :256][::-1].transpose(1, 2, 0) + 0.5
    values, presence = np.zeros((count, 39, 5), np.float32), np.zeros((count, 1), np.float32)
    for number, picture in enumerate(pictures):
        red, green = (spots(picture, channel) for channel in (0, 1))
        if not (red and green):
            continue
        hips = min(red, key=lambda one: np.linalg.norm(one - 128))
        head = min(green, key=lambda one: np.linalg.norm(one - hips))
        values[number, :, 3:] = 3.0
        values[number, :33, :2] = answer(hips, head)
        values[number, 33:35, :2] = hips, head
        evidence[number, ..., 0] = np.linalg.norm(head - hips) / 2 - np.linalg.norm(places - hips, axis=-1)
        presence[number] = 0.99
    nothing = np.full((count, 64, 64, 39), -9, np.float32)
    return [values.reshape(count, 195), presence, evidence, nothing, np.zeros((count, 117))]


MODEL = BlazePose(find_marks, read_marks)
