"""Feet of another body that stand where ours do: how high its hips are, where its ankles go, how its legs bend."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from jaxmocap.character import Character
from jaxmocap.clip import find_contacts
from jaxmocap.motion import Contact, Motion

from ._legs import STANDING, Legs, bent, legs_of, lowest, with_feet_of

_FADE = 0.2
"""Seconds over which a foot comes to where it will stand, and leaves it."""
_SMOOTH = 0.1  # seconds over which the hips are lowered
_LOWERED = 0.1  # of the leg, by which the hips may be lowered
_GROUND = 5.0  # percentile of the soles' heights that is the ground where no foot stands


class Stance(NamedTuple):
    """What the hips and legs of the other body do.

    Attributes:
        turns: of every body the rotation from rest.
        hips: path of the middle between the hips.
        scale: what lengths of the path are multiplied by.
        slides: metres by which a point slides at most while it stands, in the motion and on the other body.
        lowered: metres by which the hips are lowered at most, so that feet reach the ground.
    """

    turns: Float[np.ndarray, "frame bone 3 3"]
    hips: Float[np.ndarray, "frame 3"]
    scale: float
    slides: tuple[float, float]
    lowered: float


class _Marks(NamedTuple):
    """What is carried over of the motion's hips and feet, in the size of the other body.

    Attributes:
        hips: path of the middle between the hips.
        steps: paths of heels and toes that say how they slide while they stand.
        ankles: where they would be if legs were of one size.
        heights: of heels and toes.
        floor: heights below which no foot must come.
    """

    hips: Float[np.ndarray, "frame 3"]
    steps: Float[np.ndarray, "frame 2 2 3"]
    ankles: Float[np.ndarray, "frame 2 3"]
    heights: Float[np.ndarray, "frame 2 2"]
    floor: Float[np.ndarray, "frame 2"]


def stand(
    motion: Motion, target: Character, turns: Float[np.ndarray, "frame bone 3 3"], knees: Float[np.ndarray, "2 3"]
) -> Stance:
    """Carry the path over and hold the feet of a target, whose bodies turn by `turns`, where the motion's stand.

    Lengths of the path are scaled by those of the legs, about the point of the ground under the first frame. A point
    that stands slides no farther than in the motion; where heel and toe both do, the mean of their steps counts. Before
    and after, the foot comes there and leaves smoothly. Legs bend in the planes in which they were bent (`knees` are
    the axes at rest), and no foot is deeper in the ground than the motion's.
    """
    source, up = legs_of(motion.character), np.eye(3)["xyz".index(motion.up)]
    legs = with_feet_of(legs_of(target), source)
    names, scale = target.skeleton.body_names, legs.length / source.length
    thigh, shank, foot = ([names.index(f"{side}_{body}") for side in "lr"] for body in ("thigh", "shank", "foot"))
    feet, stands, seconds = turns[:, foot], _stands(motion), motion.timestamps
    standing = stands[..., 0] | stands[..., 1]
    marks = _marks(motion, source, legs, stands, up)
    held = _held(marks, stands, np.einsum("tfij,fpj->tfpi", feet, legs.feet[:, :2]), up)
    for side, span in _runs(standing):
        deep = (marks.floor - lowest(legs, held, feet, up))[span, side].max()
        held[span, side] += max(deep, 0.0) * up

    sockets = np.einsum("tij,fj->tfi", turns[:, 0], legs.hips)
    bones = np.einsum("btfij,bfj->btfi", np.stack([turns[:, thigh], turns[:, shank]]), legs.bones)
    hung = sockets + bones.sum(axis=0)  # ankles, from the middle between the hips

    def ankles_below(hips: np.ndarray) -> np.ndarray:
        free = hips[:, None] + hung
        return free + _faded(held - free, standing, seconds)

    away = marks.hips[:, None] + sockets - ankles_below(marks.hips)
    aside = np.sum(away**2, axis=2) - (away @ up) ** 2
    reach = np.linalg.norm(legs.bones, axis=2).sum(axis=0)
    missing = np.maximum(away @ up - np.sqrt(np.maximum(reach**2 - aside, 0.0)), 0.0)
    missing *= _faded(np.ones_like(held), standing, seconds)[..., 0] > 0
    lowered = _envelope(np.minimum(missing.max(axis=1), _LOWERED * legs.length), motion.seconds_per_interval)
    hips = marks.hips - lowered[:, None] * up

    ankles = ankles_below(hips)
    ankles += np.maximum(marks.floor - lowest(legs, ankles, feet, up), 0.0)[..., None] * up
    turns = turns.copy()
    for side in range(2):
        axis = turns[:, thigh[side]] @ knees[side]
        change = bent(hips + sockets[:, side], bones[:, :, side], ankles[:, side], axis)
        for body, turn in zip((thigh[side], shank[side]), change, strict=True):
            turns[:, body] = turn @ turns[:, body]
    bones = np.einsum("btfij,bfj->btfi", np.stack([turns[:, thigh], turns[:, shank]]), legs.bones)
    reached = (hips[:, None] + sockets + bones.sum(axis=0))[:, :, None]
    reached = reached + np.einsum("tfij,fpj->tfpi", feet, legs.feet[:, :2])
    slides = _slide(_points(motion), stands, up), _slide(reached, stands, up)
    return Stance(turns, hips, scale, slides, float(lowered.max()))


def _points(motion: Motion) -> Float[np.ndarray, "frame 2 2 3"]:
    """Take the paths of heels and toes."""
    chosen = [[motion.joint_names.index(f"{side}_{point}") for point in STANDING] for side in "lr"]
    return motion.joints[:, chosen].astype(np.float64)


def _marks(
    motion: Motion, source: Legs, legs: Legs, stands: Bool[np.ndarray, "frame 2 2"], up: Float[np.ndarray, "3"]
) -> _Marks:
    """Scale the path of the hips and of what stands, but heels and toes lie as high over the sole as is their own."""
    scale, points = legs.length / source.length, _points(motion)
    bodies = motion.body_transforms.astype(np.float64)
    feet = bodies[:, [motion.character.skeleton.body_names.index(f"{side}_foot") for side in "lr"], :3, :3]
    ankles = motion.joints[:, [motion.joint_names.index(f"{side}_ankle") for side in "lr"]].astype(np.float64)
    low = lowest(source, ankles, feet, up)
    soles = points @ up - (source.feet[:, :2, 1] - source.soles[:, None])  # heights, were the foot flat
    ground = np.median(soles[stands]) if stands.any() else np.percentile(low.min(axis=1), _GROUND)
    hips = bodies[:, 0, :3, :3] @ source.middle + bodies[:, 0, :3, 3]
    centre = hips[0] + (ground - hips[0] @ up) * up
    heights = ground + scale * (soles - ground) + legs.feet[:, :2, 1] - legs.soles[:, None]
    floor = ground + np.minimum(min(scale, 1.0) * (low - ground), 0.0)
    hips, ankles = (centre + scale * (path - centre) for path in (hips, ankles))
    return _Marks(hips, min(scale, 1.0) * points, ankles, heights, floor)


def _stands(motion: Motion) -> Bool[np.ndarray, "frame 2 2"]:
    """Mark where heels and toes stand; they are looked for where nobody did."""
    contacts = motion.contacts
    if contacts is None:
        up = np.eye(3)["xyz".index(motion.up)]
        found = find_contacts(motion.joints, motion.timestamps, motion.character.skeleton, up)
        contacts = [Contact(name, int(motion.frames[a]), int(motion.frames[b])) for name, a, b in found]
    stands = np.zeros((len(motion), 2, 2), bool)
    for name, first, last in contacts:
        side, _, point = name.partition("_")
        stands[(motion.frames >= first) & (motion.frames <= last), "lr".index(side), STANDING.index(point)] = True
    return stands


def _held(
    marks: _Marks,
    stands: Bool[np.ndarray, "frame 2 2"],
    arms: Float[np.ndarray, "frame 2 2 3"],
    up: Float[np.ndarray, "3"],
) -> Float[np.ndarray, "frame 2 3"]:
    """Find paths of the ankles on which the points that stand slide as in the motion; zeros where none stands.

    `arms` lead from the ankles to heels and toes: the foot turns as it does and rolls over both. On the mean of a
    contact the ankle is where it would be without all this, but as high as the points that stand ask for.
    """
    ankles, rests = np.zeros_like(marks.ankles), marks.steps - arms
    for side, span in _runs(stands[..., 0] | stands[..., 1]):
        for frame in range(span.start + 1, span.stop):
            both = stands[frame, side] & stands[frame - 1, side]
            chosen = both if both.any() else stands[frame, side] | stands[frame - 1, side]
            steps = rests[frame, side] - rests[frame - 1, side]
            ankles[frame, side] = ankles[frame - 1, side] + steps[chosen].mean(axis=0)
        off = (marks.ankles - ankles)[span, side].mean(axis=0)
        high = marks.heights[span, side] - (ankles[span, side, None] + arms[span, side]) @ up
        ankles[span, side] += off + (high[stands[span, side]].mean() - off @ up) * up
    return ankles


def _runs(flags: Bool[np.ndarray, "frame 2"]) -> list[tuple[int, slice]]:
    """List the runs of true flags, with their columns."""
    edges = np.diff(np.pad(flags.astype(np.int8), ((1, 1), (0, 0))), axis=0)
    spans = [np.flatnonzero(column).reshape(-1, 2) for column in edges.T]
    return [(side, slice(int(first), int(stop))) for side, found in enumerate(spans) for first, stop in found]


def _faded(
    shifts: Float[np.ndarray, "frame 2 3"], standing: Bool[np.ndarray, "frame 2"], seconds: Float[np.ndarray, " frame"]
) -> Float[np.ndarray, "frame 2 3"]:
    """Keep shifts while a foot stands, and let those of its first and last frame fade before and after.

    Between two contacts that are close one becomes the other.
    """
    kept = np.where(standing[..., None], shifts, 0.0)
    for side in range(2):
        frames = np.flatnonzero(standing[:, side])
        if not len(frames):
            continue
        gaps = [(None, frames[0]), *((a, b) for a, b in pairwise(frames) if b > a + 1), (frames[-1], None)]
        for before, after in gaps:
            between = np.arange(0 if before is None else before + 1, len(seconds) if after is None else after)
            gap = np.inf if before is None or after is None else seconds[after] - seconds[before]
            for edge in (before, after):
                if edge is not None:
                    left = 1 - np.abs(seconds[between] - seconds[edge]) / (gap if gap < 2 * _FADE else _FADE)
                    left = np.clip(left, 0.0, 1.0)[:, None]
                    kept[between, side] += left**2 * (3 - 2 * left) * shifts[edge, side]
    return kept


def _envelope(values: Float[np.ndarray, " frame"], interval: float) -> Float[np.ndarray, " frame"]:
    """Smooth values without falling below any."""
    width = 2 * round(_SMOOTH / max(interval, 1e-3)) + 1
    highest = maximum_filter1d(values, 2 * width - 1, mode="nearest")
    return uniform_filter1d(uniform_filter1d(highest, width, mode="nearest"), width, mode="nearest")


def _slide(
    paths: Float[np.ndarray, "frame 2 2 3"], stands: Bool[np.ndarray, "frame 2 2"], up: Float[np.ndarray, "3"]
) -> float:
    """Measure how far points come over the ground from where their contacts began, at most, metres."""
    level, farthest = paths - (paths @ up)[..., None] * up, 0.0
    for point in range(2):
        for side, span in _runs(stands[..., point]):
            way = level[span, side, point] - level[span.start, side, point]
            farthest = max(farthest, float(np.linalg.norm(way, axis=1).max()))
    return farthest
