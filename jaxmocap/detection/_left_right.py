"""Left and right that a model exchanges: told by the person's other pictures, in which they stay what they are."""

import numpy as np
from jaxtyping import Bool, Float64, Int64

from ._layouts import LAYOUTS, Layout

WEIGHTS = {"shoulder": 1.0, "hip": 1.0, "elbow": 0.5, "knee": 0.5, "wrist": 0.25, "ankle": 0.25}
"""How much joints count: the trunk does not turn round from picture to picture, while legs and arms pass each other."""

_FARTHEST = 0.15  # of the region's side; a point that moves farther counts no more
_SWITCH = 0.06  # what it costs that a model begins or ends to exchange the sides: half of what a person facing us moves
_EXCHANGED = 1e-4  # what each picture costs in which it does
_APART = 6.0  # usual steps between pictures that still tell of each other


def exchanged_sides(
    points: Float64[np.ndarray, "frame point 3"],
    sides: Float64[np.ndarray, " frame"],
    frames: Int64[np.ndarray, " frame"],
) -> Bool[np.ndarray, " frame"]:
    """Tell in which pictures of a video the person's left and right are exchanged.

    `points` are x, y and confidence in the order of a layout, `sides` those of the regions in pixels, `frames` the
    pictures' numbers. Of all ways to exchange left and right in some pictures the one is taken in which the joints move
    least from picture to picture (Viterbi), where beginning and ending count too, and fewer pictures are preferred. So
    most pictures have to be right, and what only the legs or arms of somebody seen from the side could tell is left.
    """
    result = np.zeros(len(points), bool)
    known = np.flatnonzero(sides > 0)
    if len(known) < 2 or (layout := layout_of(points.shape[1])) is None:
        return result
    mirrored = mirrored_points(layout)
    steps = np.diff(frames[known])
    near = steps <= _APART * np.median(steps)
    cost, before = np.array([0.0, _EXCHANGED]), np.zeros((len(known), 2), int)
    for number in range(1, len(known)):
        last, this = known[number - 1], known[number]
        stays = crosses = 0.0
        if near[number - 1]:
            side = float(sides[last] + sides[this]) / 2
            stays = distance(points[last], points[this], layout, side)
            crosses = distance(points[last], points[this][mirrored], layout, side)
        ways = cost[:, None] + np.array([[stays, crosses + _SWITCH], [crosses + _SWITCH, stays]])
        before[number] = ways.argmin(axis=0)
        cost = ways.min(axis=0) + (0.0, _EXCHANGED)
    state = int(cost.argmin())
    for number in range(len(known) - 1, -1, -1):
        result[known[number]] = bool(state)
        state = before[number, state]
    return result


def exchanged(
    first: Float64[np.ndarray, "point 3"], second: Float64[np.ndarray, "point 3"], layout: Layout, side: float = 1.0
) -> bool:
    """Tell whether two answers to one picture exchange left and right: they lie apart, and otherwise near together."""
    apart = distance(first, second, layout, side)
    return apart > _SWITCH / 2 and distance(first, second[mirrored_points(layout)], layout, side) < apart / 2


def distance(
    first: Float64[np.ndarray, "point dim"], second: Float64[np.ndarray, "point dim"], layout: Layout, side: float
) -> float:
    """Measure how far the joints of two answers lie apart, in sides of the region: weighed by `WEIGHTS` and by what
    both are certain of, 0 if that is nothing."""
    rows, weights = _joints(layout)
    certain = weights * np.minimum(first[rows, 2], second[rows, 2])
    apart = np.linalg.norm(first[rows, :2] - second[rows, :2], axis=-1) / side
    total = certain.sum()
    return float((certain * np.minimum(apart, _FARTHEST)).sum() / total) if total > 0 else 0.0


def mirrored_points(layout: Layout) -> list[int]:
    """List for every point the one that is it on the other side: itself for those that have no side."""
    other = {"l_": "r_", "r_": "l_"}
    return [layout.points.index(other.get(name[:2], name[:2]) + name[2:]) for name in layout.points]


def layout_of(count: int) -> Layout | None:
    """Find the layout that has so many points."""
    return next((one for one in LAYOUTS.values() if len(one.points) == count), None)


def _joints(layout: Layout) -> tuple[list[int], Float64[np.ndarray, " joint"]]:
    known = [(row, WEIGHTS[name[2:]]) for row, name in enumerate(layout.points) if name[2:] in WEIGHTS]
    return [row for row, _ in known], np.array([weight for _, weight in known])
