"""Scoring a limb, which looks at what it changes only, gives the energy of the whole body drawn anew."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scoring import FRAME, TERMS, energy_of, score, score_in

from jaxmocap.appearance import psi
from jaxmocap.character import retract, skin
from jaxmocap.energies import ModelView, SearchEnergy, body_part, covered_cost, uncovered_cost
from jaxmocap.observation import draw

LIMBS = ("l_arm", "r_arm", "l_leg", "r_leg")
EACH = 36


@pytest.fixture(scope="module")
def increments(world):
    """(limb, particle, 39): the truth and random moves of that limb's joints."""
    rng = np.random.default_rng(3)
    moves = np.zeros((len(LIMBS), EACH, 39), np.float32)
    for row, name in enumerate(LIMBS):
        dofs = list(world.character.skeleton.group(name))
        moves[row, 1:, dofs] = rng.normal(size=(len(dofs), EACH - 1)) * np.deg2rad(10)
    return moves


@pytest.fixture(scope="module")
def parts(world):
    """The four limbs padded to one shape."""
    groups = {name: world.character.skeleton.group(name) for name in LIMBS}
    plain = [body_part(world.character, dofs) for dofs in groups.values()]
    faces, vertices = max(p.faces.shape[1] for p in plain), max(p.vertices.shape[0] for p in plain)
    padded = [body_part(world.character, dofs, faces, vertices) for dofs in groups.values()]
    return [eqx.tree_at(lambda p: p.dofs, part, jnp.arange(6)) for part in padded]  # scoring does not read them


@pytest.fixture(scope="module")
def whole(world, increments):
    terms = score(world, increments.reshape(-1, 39))
    return {name: values.reshape(len(LIMBS), EACH) for name, values in terms.items()}


@pytest.mark.parametrize("limb", range(4), ids=LIMBS)
def test_a_limb_scores_like_the_whole_body(world, parts, increments, whole, limb):
    where = (world.character, parts[limb], world.pose(FRAME), world.problem(FRAME))
    scores, _ = score_in(energy_of(world), *where, jnp.asarray(increments[limb]))
    terms = dict(zip(TERMS, np.asarray(scores.terms).T, strict=True))
    for name in TERMS:
        gap = np.abs(terms[name] - whole[name][limb])
        # Compiled apart, the two may round the partner of a pixel to neighbouring pixels: 1 of 4,000 (coarse: 1,000).
        assert np.mean(gap > 1e-5) < 0.06, name
        assert gap.max() < (1.1e-3 if name == "coarse" else 3e-4), name
        assert np.ptp(terms[name]) > 1e-3 or (name == "posture" and "leg" in LIMBS[limb]), name


def test_what_a_particle_draws_leaves_no_trace_in_the_next(world, parts, increments):
    """Not even one that leaves the picture, or that has no pose."""
    moves = np.array(increments[0])
    order = np.random.default_rng(0).permutation(EACH)
    wild = moves[order]
    wild[::3] = 0.0
    wild[0, :3], wild[6, 2], wild[12, 4] = (0.0, 40.0, 0.0), -30.0, np.nan
    where = (energy_of(world), world.character, parts[0], world.pose(FRAME), world.problem(FRAME))
    plain, mixed = (np.asarray(score_in(*where, jnp.asarray(each))[0].terms) for each in (moves, wild))
    kept = np.arange(EACH) % 3 != 0
    np.testing.assert_array_equal(mixed[kept], plain[order][kept])


@pytest.mark.slow
def test_the_driver_of_accelerators_scores_like_that_of_cpus(world, parts, increments):
    where = (world.character, parts[0], world.pose(FRAME), world.problem(FRAME), jnp.asarray(increments[0]))
    found = [score_in(energy_of(world), *where, driver)[0] for driver in ("loop", "scatter")]
    assert int(found[0].needed) == int(found[1].needed)
    gaps = np.abs(np.asarray(found[0].terms) - np.asarray(found[1].terms))
    assert np.mean(gaps > 1e-5) < 0.06
    assert gaps.max() < 1.1e-3


def test_exact_shading_is_the_definition_and_near_the_palette(world, parts, increments):
    """Of a limb, and of all pixels by NumPy."""
    energy = SearchEnergy((ModelView(), ModelView(shading="exact")))
    problem, pose, moves = world.problem(FRAME), world.pose(FRAME), jnp.asarray(increments[0, :12])
    scores, _ = score_in(energy, world.character, parts[0], pose, problem, moves)
    palette, exact = np.asarray(scores.terms).T
    assert 0 < np.abs(palette - exact).max() < 0.004
    assert np.ptp(exact) > 5 * np.abs((palette - palette.mean()) - (exact - exact.mean())).max()
    _, ids, _ = draw(world.character, retract(world.character.skeleton, pose, moves[3]), problem)
    ids = np.asarray(ids)
    foreground = np.stack(
        [
            psi(
                world.appearance.foreground.camera(c),
                ids[c],
                np.asarray(problem.image[c]),
                world.appearance.settings.colour,
            )
            for c in range(2)
        ]
    )
    background = np.asarray(problem.background)
    cost = np.where(ids >= 0, covered_cost(foreground, background), uncovered_cost(background))
    assert exact[3] == pytest.approx(cost.sum() / float(problem.area), rel=1e-3)


def test_exact_shading_needs_colour_models(world):
    problem = world.problem(FRAME)
    bare = eqx.tree_at(lambda p: p.surface.clusters, problem, None)
    part = body_part(world.character, world.character.skeleton.group("l_arm"))
    with pytest.raises(ValueError, match="colour models"):
        score_in(
            SearchEnergy((ModelView(shading="exact"),)), world.character, part, world.pose(FRAME), bare,
            jnp.zeros((2, 39)),
        )  # fmt: skip


def test_a_part_holds_the_faces_its_joints_move(world):
    """Moving the joints moves the part's vertices as it moves the mesh, and no vertex of a face outside it."""
    character, pose = world.character, world.pose(FRAME)
    dofs = character.skeleton.group("l_arm")
    part = body_part(character, dofs)
    delta = np.zeros(39, np.float32)
    delta[list(dofs)] = 0.4
    moved_pose = retract(character.skeleton, pose, jnp.asarray(delta))
    before, after = np.asarray(skin(character, pose)), np.asarray(skin(character, moved_pose))
    moved = np.linalg.norm(after - before, axis=1) > 1e-5
    faces, moves = np.asarray(character.faces), np.asarray(part.moves)
    assert not moved[faces[~moves]].any()
    assert moved[faces[moves]].any(1).mean() > 0.99
    numbers = np.asarray(part.face_numbers)
    np.testing.assert_array_equal(numbers, np.flatnonzero(moves))
    posed = np.asarray(part.posed(character, moved_pose))
    np.testing.assert_allclose(posed[np.asarray(part.faces).T], after[faces[numbers]], atol=1e-5)


def test_a_root_joint_moves_every_face(world):
    assert np.asarray(body_part(world.character, (4,)).moves).all()


def test_padding_adds_faces_without_area(world):
    plain = body_part(world.character, world.character.skeleton.group("r_arm"))
    count = plain.faces.shape[1]
    padded = body_part(
        world.character, world.character.skeleton.group("r_arm"), count + 10, plain.vertices.shape[0] + 5
    )
    assert padded.faces.shape[1] == count + 10
    assert padded.vertices.shape[0] == plain.vertices.shape[0] + 5
    np.testing.assert_array_equal(padded.faces[:, count:], 0)
    np.testing.assert_array_equal(padded.faces[:, :count], plain.faces)


def test_a_part_without_faces_is_refused(world):
    still = eqx.tree_at(
        lambda c: c.weights,
        world.character,
        jnp.asarray(np.eye(18, dtype=np.float32)[[0]].repeat(world.character.vertices.shape[0], 0)),
    )
    with pytest.raises(ValueError, match="no face of the mesh depends on the DoFs \\['l_elbow_flex'\\]"):
        body_part(still, (world.character.skeleton.dof_names.index("l_elbow_flex"),))
