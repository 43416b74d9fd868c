"""Where the body or a limb was lost: spans of frames with a reason, for the report and for whoever reads it."""

from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool

from jaxmocap.character import (
    Character,
    Pose,
    Skeleton,
    landmark_positions,
    nearest_equivalent,
    with_limb,
)

from ._frame_verdict import FrameResult, VerdictSettings

HIDDEN, FOREIGN, JUMPING = "no view shows it", "its pixels look like the background", "it leaves its way"
LOST = "the body's pixels look like the background, or it moves too fast"


@dataclass(frozen=True)
class LostSpan:
    """A part, "body" or a limb such as "left arm", that is not to be trusted in frames `first` to `last`, and why."""

    part: str
    first: int
    last: int
    why: str


def runs(marked: Bool[np.ndarray, "frame"]) -> list[tuple[int, int]]:
    """Find where marked frames begin, and where they have ended."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], marked.astype(int), [0]]))).tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))


def lost_spans(
    results: Sequence[FrameResult], character: Character, fps: float, settings: VerdictSettings
) -> list[LostSpan]:
    """List the spans in which the whole body is lost, and in which a limb is.

    No view shows the limb's outer half, its pixels look like the background, or it is far from halfway between the
    frames before and after.
    """
    body = np.array([result.status == "lost" for result in results])
    spans = _spans(results, body, "body", LOST)
    for limb, (group, name) in enumerate(character.skeleton.limb_labels.items()):
        hidden = np.array([result.limb_seen[limb] < settings.hidden for result in results])
        foreign = np.array([result.limb_costs[limb] > settings.foreign for result in results])
        for why, marked in ((HIDDEN, hidden), (FOREIGN, foreign & ~hidden)):
            spans += _spans(results, marked & ~body, name, why)
        jumping = _jumping(results, character, group, fps, settings)
        spans += _spans(results, jumping & ~hidden & ~foreign & ~body, name, JUMPING)
    return sorted(spans, key=lambda span: (span.first, span.part))


def _jumping(
    results: Sequence[FrameResult], character: Character, group: str, fps: float, settings: VerdictSettings
) -> Bool[np.ndarray, "frame"]:
    dofs, far = character.skeleton.group(group), np.zeros(len(results))
    for here in range(1, len(results) - 1):
        earlier, pose, later = (result.pose for result in results[here - 1 : here + 2])
        far[here] = limb_deviation(character.skeleton, earlier, pose, later, dofs)[0]
    peak = far >= np.maximum(np.append(far[1:], 0), np.append(0, far[:-1]))  # its neighbours deviate only because of it
    return peak & (far > settings.limb_deviation) & (2 * far * fps**2 > settings.acceleration_limit)


def _spans(results: Sequence[FrameResult], marked: Bool[np.ndarray, "frame"], part: str, why: str) -> list[LostSpan]:
    return [LostSpan(part, results[first].frame, results[stop - 1].frame, why) for first, stop in runs(marked)]


def limb_deviation(
    skeleton: Skeleton, earlier: Pose, pose: Pose, later: Pose, dofs: tuple[int, ...]
) -> tuple[float, Pose]:
    """Measure how far a limb's landmarks are, at most, from halfway between two other poses, metres.

    Returns with it the pose with the limb halfway.
    """
    before, after = nearest_equivalent(skeleton, earlier, pose), nearest_equivalent(skeleton, later, pose)
    middle = with_limb(with_limb(pose, before, dofs), with_limb(pose, after, dofs), dofs, 0.5)
    moved = landmark_positions(skeleton, pose) - landmark_positions(skeleton, middle)
    return float(jnp.linalg.norm(moved, axis=1).max()), middle
