"""A limb lost in one frame and seen in the next is found by looking back."""

from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from perturbed import arm_away, vertex_errors

from jaxmocap._runtime import Clock
from jaxmocap.character import difference, landmark_positions, retract, with_limb
from jaxmocap.character._pose import ball_joints, equivalent_angles
from jaxmocap.energies import search_energy
from jaxmocap.motion import MotionHistory
from jaxmocap.search import BodySearch, Evidence, SearchPlan
from jaxmocap.track import Answer, BackwardSearch, FrameTracker, Tracker
from jaxmocap.track._backward_search import _backwards, _refined, _straightened, doubtful_run, limb_deviation
from jaxmocap.track._state import Tracked

LOST = 1


@pytest.mark.parametrize(
    ("costs", "run"),
    [
        ([0.2, 0.7, 0.6, 0.3], 2),
        ([0.7, 0.2, 0.6, 0.3], 1),
        ([0.7, 0.7, 0.7, 0.65], 0),
        ([0.2, 0.4, 0.4, 0.1], 0),
        ([0.2, np.nan, 0.7, 0.3], 1),
        ([0.2, 0.7, np.nan], 0),
    ],
)
def test_only_frames_clearly_worse_than_the_last_are_doubtful(costs, run):
    assert doubtful_run(np.array(costs), BackwardSearch(foreign=0.5, better=0.1)) == run


def test_a_limb_is_moved_part_of_the_way(world):
    arm = world.character.skeleton.group("l_arm")
    here, there = world.pose(0), world.pose(2)
    index = np.array(arm) - 6
    halfway = with_limb(here, there, arm, 0.5)
    expected = np.array(here.angles)
    expected[index] = 0.5 * (np.asarray(here.angles) + np.asarray(there.angles))[index]
    np.testing.assert_allclose(halfway.angles, expected, atol=1e-6)
    np.testing.assert_array_equal(halfway.root, here.root)


def test_the_refinement_sees_the_motion_in_the_answer_s_set_of_angles(world):
    """A joint that turns steadily goes on as it did where the answer has its other set of angles."""
    skeleton, history = world.character.skeleton, []
    (joint, twice), step = ball_joints(skeleton)[-1], np.zeros(skeleton.num_dofs, np.float32)
    step[6:][joint] = 0.05, -0.03, 0.04
    poses = [world.pose(0)]
    for _ in range(3):
        poses.append(retract(skeleton, poses[-1], jnp.asarray(step)))
    angles = np.array(poses[-1].angles)
    angles[joint] = equivalent_angles(angles[joint], twice, angles[joint], angles[joint])
    answer = eqx.tree_at(lambda pose: pose.angles, poses[-1], jnp.asarray(angles))
    places = lambda pose: np.asarray(landmark_positions(skeleton, pose))  # noqa: E731
    np.testing.assert_allclose(places(answer), places(poses[-1]), atol=1e-4)
    tracked = [SimpleNamespace(frame=None, history=MotionHistory(0.1, poses[-2], (step, step)))]
    _refined(tracked, 0, answer, {}, skeleton, lambda frame, answer, told: (answer, history.append(told)))
    (told,) = history
    assert np.abs(told.pose.angles - poses[-2].angles).max() > 1
    for increment in told.increments:
        np.testing.assert_allclose(places(retract(skeleton, told.pose, increment)), places(poses[-1]), atol=2e-3)


def test_a_frame_that_is_searched_from_each_of_the_next_ones_takes_a_key_of_its_own_each_time(world):
    skeleton, keys = world.character.skeleton, []
    search = SimpleNamespace(
        groups=[SimpleNamespace(dofs=skeleton.group("l_arm"))],
        character=world.character,
        key=jax.random.key(0),
        score=lambda problem, poses: (np.arange(len(poses), 0.0, -1.0), None),
        group=lambda number, pose, problem, history, key: (pose, keys.append(jax.random.key_data(key).tolist())),
    )
    search.key_of = lambda frame, number: BodySearch.key_of(search, frame, number)
    tracked = [
        Tracked(None, SimpleNamespace(number=number, problem=None), SimpleNamespace(pose=world.pose(min(number, 2))))
        for number in range(4)
    ]
    for count in (3, 4):
        poses = [one.result.pose for one in tracked[:count]]
        assert len(_backwards(tracked[:count], poses, count - 2, 0, search)) == count - 2
    assert len(keys) == 3
    assert len({tuple(key) for key in keys}) == 3


def looked_back(world, poses, settings=BackwardSearch()):
    """A tracker that has found these poses in the three frames, its last step, and all results before that."""
    energy = search_energy(uncovered_scale=4.0, step=2, sampling="nearest", fail="ignore", outside="ignore")
    plan = SearchPlan(step=2, iterations=12, particles=64)
    plain = Tracker(energy, plan, refine=None, backward_search=settings)
    tracker = FrameTracker(world.observations(), plain, jax.random.key(0))
    state, found = tracker.first(world.shown(0), poses[0]).state._replace(recent=(), history=None), []
    for number, pose in enumerate(poses):
        answer = Answer(pose, np.zeros(tracker.character.skeleton.num_dofs))
        frame = world.frame(number, observations=tracker.observations)
        step = tracker.judge(state, frame, answer, Clock())
        state = step.state
        found.append(step.result)
    return tracker, found, step


@pytest.mark.slow
def test_a_lost_arm_is_found_from_the_frame_after(world):
    poses = [world.pose(0), arm_away(world, LOST), world.pose(2)]
    tracker, found, (state, result, revised) = looked_back(world, poses)
    assert [one.frame for one in revised] == [LOST]
    assert result.seconds["backward search"] > 0
    arm = next(group for group in tracker.body_search.groups if group.name == "l_arm")
    vertices = np.unique(np.asarray(tracker.character.faces)[np.asarray(arm.part.moves)])
    before, after = (vertex_errors(world, LOST, pose)[vertices].mean() for pose in (poses[LOST], revised[0].pose))
    assert before > 0.1
    assert after < 0.02
    wrist = list(world.character.skeleton.landmark_names).index("l_wrist")
    assert revised[0].confidence[wrist] > found[LOST].confidence[wrist] + 0.2
    moved = difference(world.character.skeleton, revised[0].pose, poses[2])
    np.testing.assert_allclose(state.history.increments[-1], moved, atol=1e-6)
    assert [one.result.pose is revised[0].pose for one in state.recent] == [False, True, False]


def test_a_limb_is_compared_with_halfway_and_not_with_where_the_body_went(world):
    skeleton = world.character.skeleton
    arm, leg = skeleton.group("l_arm"), skeleton.group("l_leg")
    poses = [world.pose(0), arm_away(world, LOST), world.pose(2)]
    far, middle = limb_deviation(skeleton, *poses, arm)
    assert far > 0.3
    assert limb_deviation(skeleton, poses[0], middle, poses[2], arm)[0] < 1e-3
    assert limb_deviation(skeleton, *poses, leg)[0] < 0.02
    shift = jnp.zeros(39).at[0].set(0.5)
    jumped = retract(skeleton, poses[1], shift)
    assert limb_deviation(skeleton, poses[0], jumped, poses[2], leg)[0] < 0.02


def test_after_a_gap_a_limb_is_compared_with_where_it_would_be_by_then(world):
    skeleton = world.character.skeleton
    arm = skeleton.group("l_arm")
    first, last = world.pose(0), arm_away(world, LOST)
    for share in (0.2, 0.5, 0.75):
        on_its_way = with_limb(first, last, arm, share)
        assert limb_deviation(skeleton, first, on_its_way, last, arm, share)[0] < 1e-3
    assert limb_deviation(skeleton, first, with_limb(first, last, arm, 0.2), last, arm)[0] > 0.1


@pytest.mark.parametrize(("seconds", "searched"), [((0.1, 0.1), True), ((0.1, 0.3), False)])
def test_a_limb_that_moves_evenly_over_a_gap_is_not_searched_from_halfway(world, seconds, searched):
    """It was a quarter of the way there after a quarter of the time: by frames it was 9 cm from halfway and more."""
    skeleton, asked = world.character.skeleton, []
    arm = skeleton.group("l_arm")
    first, last = world.pose(0), arm_away(world, LOST)
    poses = [first, with_limb(first, last, arm, 0.25), last]
    times = np.cumsum([0.0, *seconds])
    search = SimpleNamespace(
        limbs=[0],
        groups=[SimpleNamespace(dofs=arm)],
        character=world.character,
        fps=10.0,
        key_of=lambda frame, number: asked.append(frame),
        group=lambda *given: (poses[1], None),
        evidence=SimpleNamespace(draw=lambda pose, problem: pose, limb_shares=lambda drawn: [1.0]),
    )
    tracked = [
        Tracked(
            None if number == 0 else MotionHistory(times[number - 1], poses[number - 1], (), 0.1),
            SimpleNamespace(number=number, problem=None, timestamp=times[number]),
            None,
        )
        for number in range(3)
    ]
    settings = BackwardSearch(deviation=0.05, acceleration_limit=10.0)
    assert _straightened(tracked, poses, 0, search, settings) == {}
    assert bool(asked) is searched


@pytest.mark.slow
def test_an_arm_that_left_its_way_for_a_frame_is_searched_from_halfway(world):
    """All three frames look alike in cost, so that only the way tells."""
    poses = [world.pose(0), arm_away(world, LOST), world.pose(2)]
    revised = looked_back(world, poses, BackwardSearch(foreign=2.0))[2].revised
    assert [result.frame for result in revised] == [LOST]
    assert vertex_errors(world, LOST, revised[0].pose).mean() < 0.01
    assert looked_back(world, poses, BackwardSearch(foreign=2.0, deviation=9.0))[2].revised == ()
    assert looked_back(world, poses, BackwardSearch(foreign=2.0, acceleration_limit=1e5))[2].revised == ()


@pytest.mark.slow
def test_an_answer_that_hides_the_limb_does_not_count(world, monkeypatch):
    """The search stands for one that finds the truth."""
    monkeypatch.setattr(BodySearch, "group", lambda *_: (world.pose(LOST), np.zeros(39)))
    poses = [world.pose(0), arm_away(world, LOST), world.pose(2)]
    shares = lambda self, drawn: np.full(4, float(drawn.pose is poses[LOST]))  # noqa: E731
    monkeypatch.setattr(Evidence, "limb_shares", shares)
    assert looked_back(world, poses, BackwardSearch(foreign=2.0))[2].revised == ()
    assert looked_back(world, poses, BackwardSearch(foreign=2.0, hidden=0.0))[2].revised != ()


def test_nothing_is_changed_where_nothing_is_doubtful(world):
    _, _, step = looked_back(world, [world.pose(frame) for frame in range(3)])
    assert step.revised == ()
    np.testing.assert_array_equal(step.state.history.pose.angles, world.pose(2).angles)
