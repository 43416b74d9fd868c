"""Search backwards: a limb that one frame shows clearly and the frames before do not is searched again there."""

from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxmocap.character import (
    Pose,
    Skeleton,
    landmark_positions,
    nearest_equivalent,
    rewritten_increments,
    with_limb,
)
from jaxmocap.motion import after
from jaxmocap.refinement import Refinement
from jaxmocap.search import BodySearch

from ._state import Tracked

MARGIN = 0.002
"""Energy by which an answer has to be better."""

SLACK = 0.004
"""Energy by which an answer from halfway may be worse."""


@dataclass(frozen=True)
class BackwardSearch:
    """Search limbs of earlier frames again that a later frame shows to be wrong. The paper only looks forwards.

    A limb that looks foreign, and less so in a later frame, is searched from there, backwards from frame to frame. A
    limb that is far from halfway in time between the frames before and after is searched from halfway; the answer
    counts where it deviates half as far, does not hide the limb, and costs little more.

    Attributes:
        foreign: mean cost of Eq. 6 over the limb's distal half above which it looks foreign.
        better: by how much less it costs in the later frame.
        longest: frames that a limb is followed backwards at most.
        deviation: metres from halfway above which a limb is searched from there,
        acceleration_limit: if that is an acceleration above this, metres per second squared.
        hidden: share of the distal half that an answer has to show in some view, where more was shown.
    """

    foreign: float = 0.45
    better: float = 0.15
    longest: int = 6
    deviation: float = 0.15
    acceleration_limit: float = 200.0
    hidden: float = 0.5


def doubtful_run(costs: Float[np.ndarray, "frame"], settings: BackwardSearch) -> int:
    """Count the frames just before the last one that look foreign where the last one does not."""
    foreign = (costs[:-1] > settings.foreign) & (costs[:-1] > costs[-1] + settings.better)
    return int(np.cumprod(foreign[::-1]).sum())


def search_backwards(
    tracked: Sequence[Tracked], search: BodySearch, refinement: Refinement | None, settings: BackwardSearch
) -> dict[int, Pose]:
    """Search better poses of earlier frames, by position in `tracked`; the last frame is the one just tracked.

    A doubtful limb is searched from where it was one frame later, or on the way from there to where it was last seen,
    of which every frame takes an even part, from the youngest doubtful frame to the oldest; then the frames are refined
    from the oldest to the youngest. A pose counts when it lowers Eq. 5 by `MARGIN`. A limb that is not doubtful but
    leaves its way in the last frame but one is searched there from halfway.
    """
    better = dict[int, Pose]()
    costs = np.stack([one.result.limb_costs for one in tracked])
    for limb, number in enumerate(search.limbs):
        run = min(doubtful_run(costs[:, limb], settings), len(tracked) - 2)
        poses = [better.get(position, one.result.pose) for position, one in enumerate(tracked)]
        if run > 0:
            found, margin = _backwards(tracked, poses, run, number, search), MARGIN
        else:
            found, margin = _straightened(tracked, poses, limb, search, settings), -SLACK
        for position in sorted(found):
            problem = tracked[position].frame.problem
            answer = _refined(tracked, position, found[position], better, search.character.skeleton, refinement)
            totals, _ = search.score(problem, [poses[position], answer])
            if totals[1] < totals[0] - margin:
                better[position] = answer
    return better


def _refined(
    tracked: Sequence[Tracked],
    position: int,
    answer: Pose,
    better: dict[int, Pose],
    skeleton: Skeleton,
    refinement: Refinement | None,
) -> Pose:
    """Refine a frame's new answer; the refinement sees the better poses of earlier frames."""
    if refinement is None:
        return answer
    history = tracked[position].history
    if history is not None:
        if position - 1 in better:
            before = tracked[position - 1]
            history = after(skeleton, before.history, before.frame.timestamp, better[position - 1], "same")
        near = nearest_equivalent(skeleton, history.pose, answer)
        increments = rewritten_increments(skeleton, history.pose, near, history.increments)
        history = history._replace(pose=near, increments=tuple(increments))
    return refinement(tracked[position].frame, answer, history)[0]


def _straightened(
    tracked: Sequence[Tracked], poses: list[Pose], limb: int, search: BodySearch, settings: BackwardSearch
) -> dict[int, Pose]:
    """Search a limb of the last frame but one from halfway, if it is far from there.

    The pose is kept if the limb is then half as far and not hidden: behind the body it would cost nothing.
    """
    number, position = search.limbs[limb], len(tracked) - 2
    skeleton, dofs = search.character.skeleton, search.groups[number].dofs
    earlier, here, later = poses[-3:]
    steps, seconds = [_steps_to(one) for one in tracked[-2:]], np.diff([one.frame.timestamp for one in tracked[-3:]])
    share = steps[0] / sum(steps)
    before, middle = limb_deviation(skeleton, earlier, here, later, dofs, share)
    if before < max(settings.deviation, 0.5 * settings.acceleration_limit * seconds[0] * seconds[1]):
        return {}
    frame, evidence = tracked[position].frame, search.evidence
    answer, _ = search.group(number, middle, frame.problem, None, search.key_of(frame.number, 300 + number))
    shares = [evidence.limb_shares(evidence.draw(pose, frame.problem))[limb] for pose in (here, answer)]
    if shares[1] < min(shares[0], settings.hidden):
        return {}
    left = limb_deviation(skeleton, earlier, answer, later, dofs, share)[0]
    return {position: answer} if left < 0.5 * before else {}


def _backwards(
    tracked: Sequence[Tracked], poses: list[Pose], run: int, number: int, search: BodySearch
) -> dict[int, Pose]:
    """Search the doubtful frames of one limb backwards, as far as the poses get better."""
    dofs, found = search.groups[number].dofs, {}
    last = len(tracked) - 1
    later, earlier = tracked[last].result.pose, poses[last - run - 1]
    for position in range(last - 1, last - 1 - run, -1):
        history, frame, _ = tracked[position]
        here, steps = poses[position], [_steps_to(one) for one in tracked[last - run : position + 2]]
        as_later = with_limb(here, later, dofs)
        before = nearest_equivalent(search.character.skeleton, earlier, as_later)
        starts = [as_later, with_limb(as_later, before, dofs, steps[-1] / sum(steps))]
        totals, _ = search.score(frame.problem, [here, *starts])
        start = starts[int(np.argmin(totals[1:]))]
        again = 1000 * (last - 1 - position)  # a frame may be searched from each of the next ones
        key = search.key_of(frame.number, 200 + again + number)
        answer, _ = search.group(number, start, frame.problem, history, key)
        scored, _ = search.score(frame.problem, [here, answer])
        if not scored[1] < scored[0]:
            break
        found[position] = later = answer
    return found


def _steps_to(tracked: Tracked) -> float:
    """Tell how many steps a frame lies after the one before."""
    return 1.0 if tracked.history is None else tracked.history.steps(tracked.frame.timestamp)


def limb_deviation(
    skeleton: Skeleton, earlier: Pose, pose: Pose, later: Pose, dofs: tuple[int, ...], share: float = 0.5
) -> tuple[float, Pose]:
    """Measure how far a limb's landmarks are, at most, from the way between two other poses, metres.

    Returns with it the pose with the limb on that way, at this share of the time between them.
    """
    before, after = nearest_equivalent(skeleton, earlier, pose), nearest_equivalent(skeleton, later, pose)
    middle = with_limb(with_limb(pose, before, dofs), with_limb(pose, after, dofs), dofs, share)
    moved = landmark_positions(skeleton, pose) - landmark_positions(skeleton, middle)
    return float(jnp.linalg.norm(moved, axis=1).max()), middle
