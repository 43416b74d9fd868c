"""Where the body or a limb was lost: spans of frames with a reason, for the report and for whoever reads it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool

from jaxmocap.character import Character

from ._confidence import VerdictSettings
from ._economy import group_bodies
from ._frame_result import FrameResult
from ._hindsight import stray

HIDDEN, FOREIGN, JUMPING = "no view shows it", "its pixels look like the background", "it leaves its way"
LOST = "the body's pixels look like the background, or it moves too fast"


@dataclass(frozen=True)
class LostSpan:
    """A part, "body" or a limb such as "left arm", that is not to be trusted in frames `first` to `last`, and why."""

    part: str
    first: int
    last: int
    why: str


def limb_names(character: Character) -> dict[str, str]:
    """What people call the limbs, by the name of their group of DOFs."""
    sides = {"l": "left", "r": "right"}
    limbs = [name for name, _ in character.skeleton.groups if name.endswith(("arm", "leg"))]
    return {name: f"{sides[name[0]]} {name.split('_')[-1]}" for name in limbs}


def runs(marked: Bool[np.ndarray, "frame"]) -> list[tuple[int, int]]:
    """Where marked frames begin, and where they have ended."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], marked.astype(int), [0]]))).tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))


def lost_spans(
    results: Sequence[FrameResult], character: Character, fps: float, settings: VerdictSettings
) -> list[LostSpan]:
    """Spans in which the whole body is lost, and in which a limb is: no view shows its outer half, its pixels look like
    the background, or it is far from halfway between the frames before and after."""
    body = np.array([result.status == "lost" for result in results])
    spans = _spans(results, body, "body", LOST)
    for limb, (group, name) in enumerate(limb_names(character).items()):
        hidden = np.array([result.limb_seen[limb] < settings.hidden for result in results])
        foreign = np.array([result.limb_costs[limb] > settings.foreign for result in results])
        for why, marked in ((HIDDEN, hidden), (FOREIGN, foreign & ~hidden)):
            spans += _spans(results, marked & ~body, name, why)
        jumping = _jumping(results, character, group, fps, settings)
        spans += _spans(results, jumping & ~hidden & ~foreign & ~body, name, JUMPING)
    return sorted(spans, key=lambda span: (span.first, span.part))


def without_trust(results: Sequence[FrameResult], spans: Sequence[LostSpan], character: Character) -> list[FrameResult]:
    """The results with no confidence in the landmarks of lost parts."""
    skeleton, parts = character.skeleton, limb_names(character)
    moved = {parts[name]: group_bodies(character, dofs) for name, dofs in skeleton.groups if name in parts}
    moved["body"] = np.ones(len(skeleton.body_names), bool)
    bodies = np.array(skeleton.landmark_bodies)
    marked = []
    for result in results:
        confidence = result.confidence
        for span in spans:
            if span.first <= result.frame <= span.last:
                confidence = np.where(moved[span.part][bodies], 0.0, confidence)
        marked.append(replace(result, confidence=confidence))
    return marked


def _jumping(
    results: Sequence[FrameResult], character: Character, group: str, fps: float, settings: VerdictSettings
) -> Bool[np.ndarray, "frame"]:
    dofs, far = character.skeleton.group(group), np.zeros(len(results))
    for here in range(1, len(results) - 1):
        earlier, pose, later = (result.pose for result in results[here - 1 : here + 2])
        far[here] = stray(character.skeleton, earlier, pose, later, dofs)[0]
    peak = far >= np.maximum(np.append(far[1:], 0), np.append(0, far[:-1]))  # its neighbours stray only because of it
    return peak & (far > settings.stray) & (2 * far * fps**2 > settings.jolt)


def _spans(results: Sequence[FrameResult], marked: Bool[np.ndarray, "frame"], part: str, why: str) -> list[LostSpan]:
    return [LostSpan(part, results[first].frame, results[stop - 1].frame, why) for first, stop in runs(marked)]
