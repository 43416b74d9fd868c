"""What speaks for and against a frame's answer, measured once it is found; nothing of it steers the search."""

import itertools
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float

from jaxmocap._runtime import cores
from jaxmocap.camera import view_angles
from jaxmocap.character import Pose, Skeleton, skin
from jaxmocap.observation import Frame
from jaxmocap.refinement import Comparison, FlowSettings, compare, current_views
from jaxmocap.search import DrawnPose, Evidence, without_seams

_LEAST_PIXELS = 100
"""Of a body, or a limb's outer half, that two views show, to say something about it."""

WIDEST = 45.0
"""Degrees between two cameras, seen from the body, at which they still show a surface alike enough for optical flow."""


@dataclass(frozen=True)
class FrameSignals:
    """Per camera, of the pixels the body covers: `costs`, the mean of Eq. 6, and `bare`, the share of those before a
    known background that look like it; and, as a share of all of them, the pixels beside the body that look foreign,
    `uncovered`. Farther from it than the rectangle of sec. 4.1 reaches they are somebody else's and do not count.

    Per ordered pair of cameras, of the pixels whose surface the other camera shows too: `matched`, the share at which
    both pictures show the same, as far as optical flow can tell; and `view_gaps`, the median distance in metres of what
    the two show from each other. NaN where they share too little, or stand more than `WIDEST` degrees apart.

    `limb_gaps` is the same for each limb's outer half over all pairs, and `at_limit` the share of the joint angles that
    are at a limit; `speed` is the root's, in metres per second.
    """

    costs: Float[np.ndarray, "camera"]
    bare: Float[np.ndarray, "camera"]
    uncovered: Float[np.ndarray, "camera"]
    matched: Float[np.ndarray, "pair"]
    view_gaps: Float[np.ndarray, "pair"]
    limb_gaps: Float[np.ndarray, "limb"]
    at_limit: float
    speed: float

    def as_json(self) -> dict[str, list[float | None] | float]:
        """Return the signals as numbers that JSON knows."""
        record = {field.name: getattr(self, field.name) for field in fields(self)}
        return {
            name: round(float(value), 5)
            if np.ndim(value) == 0
            else [round(float(v), 5) if np.isfinite(v) else None for v in value]
            for name, value in record.items()
        }


def frame_signals(
    evidence: Evidence, frame: Frame, drawn: DrawnPose, settings: FlowSettings, speed: float = 0.0
) -> FrameSignals:
    """Gather the signals of a pose that was drawn in a frame."""
    covered, background = drawn.ids >= 0, np.asarray(frame.problem.background)
    foreign, alike = background > 0.5, background < 0.5  # 0.5 where nothing is known
    gaps, matched, limbs = _between_views(evidence, frame, drawn, settings)
    return FrameSignals(
        np.array([c[b].mean() if b.any() else 1.0 for c, b in zip(drawn.costs, covered, strict=True)]),
        _shares(alike & covered, covered, (alike | foreign) & covered),
        _shares(foreign & ~covered & _around(covered), covered, covered),
        matched,
        gaps,
        limbs,
        _share_at_limit(evidence.character.skeleton, drawn.pose),
        speed,
    )


def _around(covered: Bool[np.ndarray, "camera height width"]) -> Bool[np.ndarray, "camera height width"]:
    """Mark the box of the body in each view, widened like the rectangle of sec. 4.1."""
    near = np.zeros_like(covered)
    for box, body in zip(near, covered, strict=True):
        row, column = np.nonzero(body)
        if len(row):
            margin = int(max(0.1 * max(np.ptp(row), np.ptp(column)), 20))
            top, left = max(row.min() - margin, 0), max(column.min() - margin, 0)
            box[top : row.max() + margin + 1, left : column.max() + margin + 1] = True
    return near


def _shares(
    marked: Bool[np.ndarray, "camera height width"],
    covered: Bool[np.ndarray, "camera height width"],
    whole: Bool[np.ndarray, "camera height width"],
) -> Float[np.ndarray, "camera"]:
    """Divide the marked pixels of each view by `whole`, 0 where that is little; thin seams do not count."""
    views = zip(marked, covered, whole, strict=True)
    return np.array(
        [without_seams(here, body).sum() / of.sum() if of.sum() >= _LEAST_PIXELS else 0.0 for here, body, of in views],
        float,
    )


def _between_views(
    evidence: Evidence, frame: Frame, drawn: DrawnPose, settings: FlowSettings
) -> tuple[Float[np.ndarray, "pair"], Float[np.ndarray, "pair"], Float[np.ndarray, "limb"]]:
    """`view_gaps`, `matched` and `limb_gaps`."""
    character, problem = evidence.character, frame.problem
    vertices = skin(character, drawn.pose)
    views = current_views(frame.crops(), problem, vertices, drawn.ids)
    middle = np.append(np.asarray(vertices).mean(0), 1.0)
    cam_from_world = np.asarray(problem.cam_from_world)
    angles = view_angles(cam_from_world, middle[:3])

    def compared(pair: tuple[int, int]) -> Comparison | None:
        m, n = pair
        if angles[m, n] > WIDEST:
            return None
        return compare(character.faces, problem.surface.near_faces, views[m], views[n], settings)

    pairs = list(itertools.permutations(range(problem.num_cameras), 2))
    gaps, matched = [], []
    limbs: list[list[np.ndarray]] = [[np.zeros(0)] for _ in evidence.distal]
    with ThreadPoolExecutor(cores()) as pool:
        comparisons = list(pool.map(compared, pairs))
    for (m, _), found in zip(pairs, comparisons, strict=True):
        if found is None:
            gaps.append(np.nan)
            matched.append(np.nan)
            continue
        metres = float((cam_from_world[m] @ middle)[2]) / float(np.asarray(problem.intrinsics)[m, 0, 0])
        distances = metres * np.linalg.norm(found.moved[found.good], axis=1)
        bodies = evidence.face_bodies[drawn.ids[m][found.good]]
        shared = found.seen.sum()
        gaps.append(_median(distances))
        matched.append(found.good.sum() / shared if shared >= _LEAST_PIXELS else np.nan)
        for limb, distal in zip(limbs, evidence.distal, strict=True):
            limb.append(distances[distal[bodies]])
    medians = [_median(np.concatenate(limb)) for limb in limbs]
    return np.array(gaps, float), np.array(matched, float), np.array(medians, float)


def _median(values: Float[np.ndarray, " pixel"]) -> float:
    return float(np.median(values)) if len(values) >= _LEAST_PIXELS else float("nan")


def _share_at_limit(skeleton: Skeleton, pose: Pose, margin: float = 0.0175) -> float:
    angles, lower, upper = (np.asarray(a) for a in (pose.angles, skeleton.lower, skeleton.upper))
    return float(((angles < lower + margin) | (angles > upper - margin)).mean())
