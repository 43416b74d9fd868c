"""Which groups are searched, from made-up speeds and costs."""

import numpy as np
import pytest

from jaxmocap.character import dominant_bodies
from jaxmocap.search import Gating, look_at, mean_costs, seen_shares
from jaxmocap.search._gating import GroupGate

SLOW, FAST = 0.1, 5.0


def test_a_calm_group_is_left_out_for_a_while_and_then_searched():
    gate = GroupGate(Gating(longest=3), 2)
    gate.learn(np.array([0.2, 0.2]))
    found = [gate.search(np.array([SLOW, FAST]), np.array([0.2, 0.2])).tolist() for _ in range(5)]
    assert found == [[False, True]] * 3 + [[True, True]] + [[False, True]]


@pytest.mark.parametrize("costs", [[0.25], [np.nan]])
def test_a_group_that_is_worse_explained_or_unseen_is_searched(costs):
    gate = GroupGate(Gating(slack=0.01), 1)
    gate.learn(np.array([0.2]))
    assert gate.search(np.array([SLOW]), np.array(costs)).all()
    assert not gate.search(np.array([SLOW]), np.array([0.209])).any()


def test_nothing_is_left_out_before_the_first_answer():
    gate = GroupGate(Gating(), 3)
    assert gate.search(np.full(3, SLOW), np.zeros(3)).all()
    gate.learn(np.array([0.2, np.nan, 0.2]))
    assert gate.search(np.full(3, SLOW), np.full(3, 0.2)).tolist() == [False, True, False]


def test_the_outer_half_of_a_limb_is_beyond_its_hinge(world):
    skeleton = world.character.skeleton
    whole, distal = (skeleton.bodies_of("l_arm", distal) for distal in (False, True))
    names = np.array(skeleton.body_names)
    assert set(names[distal]) < set(names[whole])
    assert all(name.startswith("l_") for name in names[whole])
    assert skeleton.bodies_of("root").all()


def test_costs_are_means_over_the_pixels_of_the_bodies(world):
    bodies = dominant_bodies(world.character)
    groups = [world.character.skeleton.bodies_of(name) for name in ("l_arm", "r_leg")]
    faces = [np.flatnonzero(group[bodies]) for group in groups]
    ids = np.full((2, 10, 10), -1)
    ids[0, :5], ids[1, 0, :4] = faces[0][:10], faces[0][10]
    costs = np.where(ids >= 0, np.arange(100).reshape(10, 10) / 100, 9.0)
    found = mean_costs(groups, bodies, ids, costs)
    assert found[0] == pytest.approx(costs[ids >= 0].mean())
    assert np.isnan(found[1])


def test_a_limb_in_front_is_seen_and_one_behind_the_body_is_not(world):
    skeleton, bodies = world.character.skeleton, dominant_bodies(world.character)
    groups = [skeleton.bodies_of(name, distal=True) for name in ("l_arm", "r_arm")]
    own = np.asarray(world.character.weights).argmax(1)
    arm, trunk = np.flatnonzero(groups[0][bodies])[0], np.flatnonzero(~(groups[0] | groups[1])[bodies])[0]
    over = np.full((2, len(own)), -1)
    over[:, groups[0][own]] = [[arm], [trunk]]
    over[:, groups[1][own]] = trunk
    np.testing.assert_allclose(seen_shares(groups, world.character, bodies, over), [1.0, 0.0])
    seen = look_at(world.character, world.pose(0), world.problem(0))
    assert seen_shares(groups, world.character, bodies, seen.over).min() > 0.8
