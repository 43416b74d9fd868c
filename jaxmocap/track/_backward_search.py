"""Search backwards: a limb that one frame shows clearly and the frames before do not is searched again there."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxmocap.character import Pose, Skeleton, nearest_equivalent, with_limb
from jaxmocap.motion import MotionHistory, after
from jaxmocap.observation import FrameImages, FrameProblem, Rectangle
from jaxmocap.refinement import Refinement
from jaxmocap.search import BodySearch
from jaxmocap.verdict import limb_deviation


@dataclass(frozen=True)
class BackwardSearch:
    """A limb whose outer half looks foreign (mean cost of Eq. 6 above `foreign`), and less so by `better` in a later
    frame, is searched again from there, backwards through at most `longest` frames; the answer counts where it lowers
    the energy by `margin`. A limb that is more than `deviation` metres from halfway between the frames before and
    after, an acceleration above `acceleration_limit` metres per second squared, is searched again from halfway; the
    answer counts where it deviates half as far, does not hide the limb (less than `hidden` of its outer half seen in
    any view, where more was), and raises the energy by less than `slack`. The paper only looks forwards."""

    foreign: float = 0.45
    better: float = 0.15
    longest: int = 6
    margin: float = 0.002
    deviation: float = 0.15
    acceleration_limit: float = 200.0
    hidden: float = 0.5
    slack: float = 0.004


@dataclass(frozen=True)
class Tracked:
    """A frame that has been tracked: what it began with, what it showed, its answer, and the mean cost of Eq. 6 over
    the outer half of each limb."""

    history: MotionHistory | None
    shown: FrameImages
    problem: FrameProblem
    rectangle: Rectangle
    pose: Pose
    costs: Float[np.ndarray, "limb"]


def doubtful_run(costs: Float[np.ndarray, "frame"], settings: BackwardSearch) -> int:
    """How many frames just before the last one look foreign where the last one does not."""
    foreign = (costs[:-1] > settings.foreign) & (costs[:-1] > costs[-1] + settings.better)
    return int(np.cumprod(foreign[::-1]).sum())


def search_backwards(
    frames: Sequence[Tracked], search: BodySearch, refinement: Refinement | None, settings: BackwardSearch
) -> dict[int, Pose]:
    """Better poses of earlier frames, by position in `frames`; the last frame is the one just tracked.

    A doubtful limb is searched from where it was one frame later, or halfway from there to where it was last seen, from
    the youngest doubtful frame to the oldest; then the frames are refined from the oldest to the youngest. A pose
    counts when it lowers Eq. 5 by `margin`. A limb that is not doubtful but strays in the last frame but one is
    searched there from halfway.
    """
    better = dict[int, Pose]()
    costs = np.stack([frame.costs for frame in frames])
    for limb, number in enumerate(search.limbs):
        run = min(doubtful_run(costs[:, limb], settings), len(frames) - 2)
        poses = [better.get(position, frame.pose) for position, frame in enumerate(frames)]
        if run > 0:
            found, margin = _backwards(frames, poses, run, number, search, settings), settings.margin
        else:
            found, margin = _straightened(frames, poses, limb, search, settings), -settings.slack
        for position in sorted(found):
            frame, answer = frames[position], found[position]
            answer = _refined(frames, position, answer, better, search.character.skeleton, refinement)
            totals, _ = search.score(frame.problem, [poses[position], answer])
            if totals[1] < totals[0] - margin:
                better[position] = answer
    return better


def _refined(
    frames: Sequence[Tracked],
    position: int,
    answer: Pose,
    better: dict[int, Pose],
    skeleton: Skeleton,
    refinement: Refinement | None,
) -> Pose:
    """A frame's new answer after the refinement, which sees the better poses of earlier frames."""
    frame = frames[position]
    history = frame.history
    if refinement is None:
        return answer
    if history is not None:
        if position - 1 in better:
            before = frames[position - 1]
            history = after(skeleton, before.history, before.shown.timestamp, better[position - 1], "same")
        history = history._replace(pose=nearest_equivalent(skeleton, history.pose, answer))
    return refinement(answer, frame.shown, frame.problem, frame.rectangle, history)[0]


def _straightened(
    frames: Sequence[Tracked], poses: list[Pose], limb: int, search: BodySearch, settings: BackwardSearch
) -> dict[int, Pose]:
    """The last frame but one with a limb searched from halfway, if it strays there, and then strays half as far and is
    not hidden: behind the body it would cost nothing."""
    number, position = search.limbs[limb], len(frames) - 2
    skeleton, dofs = search.character.skeleton, search.groups[number].dofs
    earlier, here, later = poses[-3:]
    before, middle = limb_deviation(skeleton, earlier, here, later, dofs)
    if before < max(settings.deviation, 0.5 * settings.acceleration_limit / search.fps**2):
        return {}
    frame = frames[position]
    answer, _ = search.group(number, middle, frame.problem, None, search.key_of(frame.shown.frame, 300 + number))
    shares = [search.shares(pose, frame.problem)[limb] for pose in (here, answer)]
    if (
        shares[1] < min(shares[0], settings.hidden)
        or limb_deviation(skeleton, earlier, answer, later, dofs)[0] >= 0.5 * before
    ):
        return {}
    return {position: answer}


def _backwards(
    frames: Sequence[Tracked], poses: list[Pose], run: int, number: int, search: BodySearch, settings: BackwardSearch
) -> dict[int, Pose]:
    """Searched poses of the doubtful frames of one limb, as far back as they are better."""
    dofs, found = search.groups[number].dofs, {}
    last = len(frames) - 1
    later, earlier = frames[last].pose, poses[last - run - 1]
    for position in range(last - 1, last - 1 - run, -1):
        frame, steps = frames[position], position - (last - run - 1) + 1
        here = poses[position]
        carried = with_limb(here, later, dofs)
        before = nearest_equivalent(search.character.skeleton, earlier, carried)
        starts = [carried, with_limb(carried, before, dofs, 1.0 / steps)]
        totals, _ = search.score(frame.problem, [here, *starts])
        start = starts[int(np.argmin(totals[1:]))]
        key = search.key_of(frame.shown.frame, 200 + number)
        answer, _ = search.group(number, start, frame.problem, frame.history, key)
        scored, _ = search.score(frame.problem, [here, answer])
        if not scored[1] < scored[0]:
            break
        found[position] = later = answer
    return found
