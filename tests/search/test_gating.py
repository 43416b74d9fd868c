"""Which groups are searched, from made-up speeds and costs."""

import numpy as np
import pytest

from jaxmocap.search import DrawnPose, Evidence, Gating, SearchMemory
from jaxmocap.search._gating import gated

SLOW, FAST = 0.1, 5.0


def remembered(*costs):
    return SearchMemory.start(len(costs), 4)._replace(explained=np.array(costs))


def test_a_still_group_is_left_out_for_a_while_and_then_searched():
    memory, found = remembered(0.2, 0.2), []
    for _ in range(5):
        wanted, memory = gated(Gating(longest=3), memory, np.array([SLOW, FAST]), np.array([0.2, 0.2]))
        found.append(wanted.tolist())
    assert found == [[False, True]] * 3 + [[True, True]] + [[False, True]]


@pytest.mark.parametrize("costs", [[0.25], [np.nan]])
def test_a_group_that_is_worse_explained_or_unseen_is_searched(costs):
    settings, memory = Gating(slack=0.01), remembered(0.2)
    assert gated(settings, memory, np.array([SLOW]), np.array(costs))[0].all()
    assert not gated(settings, memory, np.array([SLOW]), np.array([0.209]))[0].any()


def test_nothing_is_left_out_before_the_first_answer():
    assert gated(Gating(), SearchMemory.start(3, 4), np.full(3, SLOW), np.zeros(3))[0].all()
    known = remembered(0.2, -np.inf, 0.2)
    assert gated(Gating(), known, np.full(3, SLOW), np.full(3, 0.2))[0].tolist() == [False, True, False]


def test_the_outer_half_of_a_limb_is_beyond_its_hinge(world):
    skeleton = world.character.skeleton
    whole, outer = (skeleton.bodies_of("l_arm", distal=distal) for distal in (False, True))
    names = np.array(skeleton.body_names)
    assert set(names[outer]) < set(names[whole])
    assert all(name.startswith("l_") for name in names[whole])
    assert skeleton.bodies_of("root").all()


def test_costs_are_means_over_the_pixels_of_the_bodies(world):
    evidence = Evidence.of(world.character)
    groups = [world.character.skeleton.bodies_of(name) for name in ("l_arm", "r_leg")]
    faces = [np.flatnonzero(group[evidence.face_bodies]) for group in groups]
    ids = np.full((2, 10, 10), -1)
    ids[0, :5], ids[1, 0, :4] = faces[0][:10], faces[0][10]
    costs = np.where(ids >= 0, np.arange(100).reshape(10, 10) / 100, 9.0)
    found = evidence.mean_costs(DrawnPose(world.pose(0), ids, costs, np.zeros((2, 0), int)), groups)
    assert found[0] == pytest.approx(costs[ids >= 0].mean())
    assert np.isnan(found[1])


def test_a_limb_in_front_is_seen_and_one_behind_the_body_is_not(world):
    evidence = Evidence.of(world.character)
    left, right = evidence.distal[:2]
    own, bodies = np.asarray(world.character.weights).argmax(1), evidence.face_bodies
    arm, trunk = np.flatnonzero(left[bodies])[0], np.flatnonzero(~(left | right)[bodies])[0]
    over = np.full((2, len(own)), -1)
    over[:, left[own]] = [[arm], [trunk]]
    over[:, right[own]] = trunk
    nothing = np.full((2, 4, 4), -1)
    made_up = DrawnPose(world.pose(0), nothing, np.zeros(nothing.shape), over)
    np.testing.assert_allclose(evidence.limb_shares(made_up)[:2], [1.0, 0.0])
    assert evidence.limb_shares(evidence.draw(world.pose(0), world.problem(0))).min() > 0.8
