"""The annealing of a limb on the real energy."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from perturbed import arm_away, vertex_errors

from jaxmocap.character import clamp, retract
from jaxmocap.energies import search_energy
from jaxmocap.observation import draw
from jaxmocap.samplers import InteractingSimulatedAnnealing
from jaxmocap.search import Reach, _group_search, group_searches, uncovered_share
from jaxmocap.search._drawn_meshes import simplified_mesh
from jaxmocap.search._group_search import wide_population

FRAME = 2
WIDTH = 7
"""Degrees of freedom of the widest limb, which the others are searched with."""


@pytest.fixture(scope="module")
def searches(world):
    energy = search_energy(step=2, sampling="nearest")
    return {search.name: search for search in group_searches(world.character, energy)}


@pytest.fixture(scope="module")
def find(world, searches):
    """(start, found pose, result) of a limb perturbed by so many `degrees` in every joint."""

    def run(name, seed=0, key=3, degrees=10, **options):
        search, skeleton = searches[name], world.character.skeleton
        delta = np.zeros(39, np.float32)
        signs = np.random.default_rng(seed).choice([-1, 1], len(search.dofs))
        delta[list(search.dofs)] = np.deg2rad(degrees * signs)
        start = clamp(skeleton, retract(skeleton, world.pose(FRAME), jnp.asarray(delta)))
        sampler = InteractingSimulatedAnnealing(
            num_particles=64,
            num_iterations=12,
            answer="best_if_better",
            sigma_min=jnp.full(WIDTH, 0.00436),
        )
        spread, problem = skeleton.initial_spread, world.problem(FRAME)
        result = search(sampler, start, problem, spread, jax.random.key(key), Reach(**options))
        return start, retract(skeleton, start, result.increment), result

    return run


def limb_errors(world, searches, name, pose):
    vertices = np.unique(np.asarray(world.character.faces)[np.asarray(searches[name].part.moves)])
    return vertex_errors(world, FRAME, pose)[vertices]


@pytest.mark.parametrize("name", ["l_arm", *(pytest.param(leg, marks=pytest.mark.slow) for leg in ("r_leg", "l_leg"))])
def test_a_limb_ten_degrees_off_is_brought_back(world, searches, find, name):
    start, found, result = find(name)
    before, after = (limb_errors(world, searches, name, pose).mean() for pose in (start, found))
    assert before > 0.03
    assert after < 0.5 * before
    others = np.delete(np.arange(39), searches[name].dofs)
    np.testing.assert_array_equal(np.asarray(result.increment)[others], 0)
    skeleton = world.character.skeleton
    assert np.all((found.angles >= skeleton.lower - 1e-6) & (found.angles <= skeleton.upper + 1e-6))


@pytest.mark.slow
def test_with_a_prior_a_limb_stays_where_it_is_right_and_is_brought_back_where_it_is_not(world, searches, find):
    """Turns that two views hardly see (an arm about its own axis) are left as they are, not drawn by chance."""
    spread, gone = world.character.skeleton.initial_spread, {}
    dofs = list(searches["l_arm"].dofs)
    for prior in (0.0, 0.002):
        moved = [np.asarray(find("l_arm", key=key, degrees=0, prior=prior)[2].increment)[dofs] for key in range(4)]
        gone[prior] = np.sqrt(np.mean(np.square(moved / spread[dofs])))
    assert gone[0.002] < 0.6 * gone[0.0]
    start, found, _ = find("l_arm", prior=0.002)
    before, after = (limb_errors(world, searches, "l_arm", pose).mean() for pose in (start, found))
    assert after < 0.5 * before


def test_a_strong_prior_holds_a_limb_at_the_start(find):
    _, _, held = find("l_arm", degrees=0, prior=1e3)
    assert np.abs(held.increment).max() < 1e-3


def test_a_lost_arm_leaves_part_of_the_person_uncovered(world):
    seen = jnp.asarray(world.masks(FRAME), jnp.float32)
    problem = eqx.tree_at(lambda p: p.background, world.problem(FRAME), seen)
    shares = [
        uncovered_share(np.asarray(draw(world.character, pose, problem)[1]), problem)
        for pose in (world.pose(FRAME), arm_away(world, FRAME))
    ]
    assert shares[0] < 0.02
    assert shares[1] > 0.03


@pytest.mark.slow
def test_a_lost_arm_is_found_further_afield(world):
    """A fresh search: its region is larger than the usual one. One of three keys may miss, for chance leads it."""
    sampler = InteractingSimulatedAnnealing(
        num_particles=96, num_iterations=16, answer="best_if_better", sigma_min=jnp.full(WIDTH, 0.00436)
    )
    energy = search_energy(uncovered_scale=4.0, step=2, sampling="nearest", fail="ignore", outside="ignore")
    search = next(group for group in group_searches(world.character, energy, step=2) if group.name == "l_arm")
    start, after, spread = arm_away(world, FRAME), [], world.character.skeleton.initial_spread

    def found(key, **reach):
        return search(sampler, start, world.problem(FRAME), spread, jax.random.key(key), Reach(0.5, **reach)).increment

    for key in range(3):
        pose = retract(world.character.skeleton, start, found(key))
        after.append(limb_errors(world, {"l_arm": search}, "l_arm", pose).mean())
    assert limb_errors(world, {"l_arm": search}, "l_arm", start).mean() > 0.1
    assert np.median(after) < 0.02
    assert np.any(np.abs(found(0)) > 1.001 * spread)
    assert np.all(np.abs(found(0, within=1.0)) <= 1.001 * spread)


def test_a_third_of_the_far_particles_leaves_the_inner_joints_alone():
    spread, lower, upper = jnp.full(4, 0.1), jnp.full(4, -3.0), jnp.full(4, 2.0)
    distal = jnp.array([False, False, True, True])
    found = np.asarray(wide_population(jax.random.key(0), 3000, spread, lower, upper, distal))
    near, even, anywhere = found[0::3], found[1::3], found[2::3]
    np.testing.assert_allclose(near.std(0), 0.3, rtol=0.1)
    assert even.min() >= -1.2001
    assert even.max() <= 1.2001
    np.testing.assert_allclose(even.std(0), 2.4 / np.sqrt(12), rtol=0.1)
    np.testing.assert_allclose(anywhere[:, :2].std(0), 0.1, rtol=0.1)
    np.testing.assert_allclose(anywhere[:, 2:].mean(0), -0.5, atol=0.2)
    np.testing.assert_allclose(anywhere[:, 2:].std(0), 5.0 / np.sqrt(12), rtol=0.1)


def test_the_same_key_gives_the_same_bits_and_another_key_others(find):
    first, again, other = (find("l_arm", key=key)[2] for key in (3, 3, 4))
    assert np.asarray(first.increment).tobytes() == np.asarray(again.increment).tobytes()
    assert float(first.energy) == float(again.energy)
    assert np.any(np.asarray(first.increment) != np.asarray(other.increment))


@pytest.mark.slow
def test_capacities_that_are_too_small_grow_and_do_not_change_the_answer(find, searches):
    _, _, enough = find("l_leg")
    sizes = searches["l_leg"].sizes
    before, sizes.capacity = sizes.capacity, 256
    _, _, again = find("l_leg")
    assert sizes.capacity >= 1.1 * int(enough.needed)
    assert sizes.capacity <= before
    np.testing.assert_allclose(again.increment, enough.increment, atol=1e-5)


@pytest.mark.slow
def test_a_simplified_mesh_at_every_second_pixel_finds_the_limb(world, searches):
    surface = world.problem(FRAME).surface
    mesh = simplified_mesh(world.character, surface, 0.5)
    assert mesh.surface.colour_distance.shape[1] == mesh.character.faces.shape[0] < world.character.faces.shape[0]
    energy = search_energy(step=2, sampling="nearest", fail="ignore", outside="ignore")
    search = next(group for group in group_searches(world.character, energy, 2, mesh) if group.name == "l_leg")
    start = clamp(
        world.character.skeleton,
        retract(world.character.skeleton, world.pose(FRAME), jnp.zeros(39).at[jnp.array(search.dofs)].set(0.15)),
    )
    sampler = InteractingSimulatedAnnealing(num_particles=64, num_iterations=14, sigma_min=jnp.full(WIDTH, 0.00436))
    spread = world.character.skeleton.initial_spread
    found = search(sampler, start, world.problem(FRAME), spread, jax.random.key(0))
    poses = (start, retract(world.character.skeleton, start, found.increment))
    before, after = (limb_errors(world, searches, "l_leg", pose).mean() for pose in poses)
    assert before > 0.03
    assert after < 0.4 * before


def test_limbs_share_a_program_and_so_do_root_and_torso(searches):
    for names in (("l_arm", "r_arm", "l_leg", "r_leg"), ("root", "torso")):
        alike = [searches[name] for name in names]
        assert all(search.sizes is alike[0].sizes for search in alike)
        shapes = [[leaf.shape for leaf in jax.tree.leaves(search.part)] for search in alike]
        assert all(shape == shapes[0] for shape in shapes)
        assert len({len(search.dofs) for search in alike}) == 2
    assert searches["root"].sizes is not searches["l_leg"].sizes


def test_a_search_copies_nothing_to_or_from_the_host(find, monkeypatch):
    """On an accelerator every generation of particles would wait for it. A CPU sees copies to the device only."""
    search = _group_search._search

    def guarded(*args):
        guards.append(len(jax.tree.leaves(args)))
        with jax.transfer_guard("disallow"):
            return search(*args)

    guards: list[int] = []
    monkeypatch.setattr(_group_search, "_search", guarded)
    result = find("l_arm")[2]
    assert guards
    assert np.isfinite(result.energy)
    with pytest.raises(Exception, match="Disallowed"), jax.transfer_guard("disallow"):
        jax.jit(jnp.sin)(np.ones(2))  # the guard is at work
