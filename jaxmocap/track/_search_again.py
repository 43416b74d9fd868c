"""Search limbs again that seem lost, and choose between answers by what they show once they are refined."""

import jax
import numpy as np
from jaxtyping import Float

from jaxmocap.character import Pose, with_limb
from jaxmocap.motion import MotionHistory
from jaxmocap.observation import Frame
from jaxmocap.refinement import Refinement
from jaxmocap.search import BodySearch, Retry, SearchMemory, uncovered_share

REMEMBERED = 30
"""Frames that say how much of the person usually stays uncovered."""

CLOSE = 2.0
"""Times the spread that keep a search where a limb was last seen."""

MARGIN = 0.005
"""Energy by which an answer has to be better."""

SLACK, NEAR = 0.001, 0.01
"""Energy by which an answer that shows a hidden limb may be worse, and by which before both are refined."""


def search_again(
    search: BodySearch,
    refinement: Refinement | None,
    retry: Retry,
    frame: Frame,
    start: Pose,
    pose: Pose,
    history: MotionHistory | None,
    memory: SearchMemory,
) -> tuple[Pose, SearchMemory]:
    """Search limbs that seem lost again.

    They are searched in turn from where the frame's search began and from where it ended; hidden ones also from where
    they were last seen. Those of the frame before have a part of these searches.
    """
    evidence, problem = search.evidence, frame.problem
    drawn = evidence.draw(pose, problem)
    hidden = evidence.limb_shares(drawn) < retry.hidden
    left, usual = uncovered_share(drawn.ids, problem), np.median(memory.uncovered) if memory.uncovered else 0.0
    doubtful = evidence.limb_costs(drawn) > retry.foreign
    doubtful |= hidden | (left > max(retry.uncovered, retry.unusual * usual))
    for limb in np.flatnonzero(doubtful & (retry.tries > 0)):
        number = search.limbs[limb]
        dofs = search.groups[number].dofs
        starts = [(with_limb(pose, start, dofs), pose)[i % 2] for i in range(retry.tries)]
        within = [np.inf] * retry.tries
        if hidden[limb] and (last := memory.last_seen[limb]) is not None:
            starts += [with_limb(pose, last, dofs)] * retry.tries
            within += [(CLOSE, np.inf)[i % 2] for i in range(retry.tries)]
        keys = jax.random.split(search.key_of(frame.number, 100 + number), len(starts))
        searches = list(zip(starts, keys, within, strict=True))
        if memory.searched_again[limb] > 0:
            searches = searches[memory.searched_again[limb] % retry.turns :: retry.turns] or searches[:1]
        found = [search.group(number, begin, problem, None, key, within=reach)[0] for begin, key, reach in searches]
        totals, _ = search.score(problem, [pose, *found])
        best = int(np.argmin(totals[1:]))
        if totals[1 + best] < totals[0] - MARGIN:
            pose = found[best]
        elif hidden[limb]:
            pose = _shown(search, refinement, retry, int(limb), frame, [pose, *found], totals, history)
    return pose, memory._replace(
        uncovered=(*memory.uncovered, left)[-REMEMBERED:],
        searched_again=np.where(doubtful, memory.searched_again + 1, 0),
    )


def _shown(
    search: BodySearch,
    refinement: Refinement | None,
    retry: Retry,
    limb: int,
    frame: Frame,
    poses: list[Pose],
    totals: Float[np.ndarray, "pose"],
    history: MotionHistory | None,
) -> Pose:
    """Choose the best pose that shows a limb, where it explains enough.

    That is as much as the first pose, which hides the limb, at once or after both are refined.
    """
    evidence, problem = search.evidence, frame.problem
    shares = [evidence.limb_shares(evidence.draw(pose, problem))[limb] for pose in poses]
    shown = np.array(shares) >= retry.hidden
    best = int(np.argmin(np.where(shown, totals, np.inf)))
    if not shown[best] or totals[best] > totals[0] + NEAR:
        return poses[0]
    if totals[best] <= totals[0] + SLACK:
        return poses[best]
    both = [pose if refinement is None else refinement(frame, pose, history)[0] for pose in (poses[0], poses[best])]
    refined, _ = search.score(problem, both)
    return poses[best] if refined[1] <= refined[0] + SLACK else poses[0]
