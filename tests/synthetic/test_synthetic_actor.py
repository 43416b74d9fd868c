import numpy as np
import pytest

from jaxmocap.geometry import surface_nets
from jaxmocap.synthetic import Outfit, make_actor
from jaxmocap.synthetic._body import CENTRE_JOINTS, SIDE_JOINTS, side_joint, skin_distance


def signed_volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def undirected_edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    return directed, np.unique(np.sort(directed, axis=1), axis=0)


@pytest.fixture(scope="module")
def actor():
    return make_actor()


@pytest.fixture(scope="module")
def mesh(actor):
    return np.asarray(actor.vertices, float), np.asarray(actor.faces)


def test_surface_nets_of_a_sphere_have_its_area_and_volume():
    grid = np.linspace(-1.3, 1.3, 27)
    corners = np.stack(np.meshgrid(grid, grid, grid, indexing="ij"), axis=-1)
    vertices, faces = surface_nets(lambda p: np.linalg.norm(p, axis=1) - 1, corners)
    np.testing.assert_allclose(np.linalg.norm(vertices, axis=1), 1, atol=1e-4)
    assert signed_volume(vertices, faces) == pytest.approx(4 / 3 * np.pi, rel=0.01)


def test_every_edge_is_shared_by_two_faces_in_opposite_directions(mesh):
    directed, edges = undirected_edges(mesh[1])
    assert len(np.unique(directed, axis=0)) == len(directed) == 2 * len(edges)


def test_the_skin_is_one_sphere_like_surface(mesh):
    vertices, faces = mesh
    _, edges = undirected_edges(faces)
    assert len(vertices) - len(edges) + len(faces) == 2
    assert len(np.unique(faces)) == len(vertices)
    assert 3000 <= len(faces) <= 5000


def test_the_body_has_the_volume_of_a_person(mesh):
    assert 0.06 < signed_volume(*mesh) < 0.08


def test_no_face_is_folded_over(mesh):
    vertices, faces = mesh
    corners = vertices[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outside = corners.mean(axis=1) + 2e-3 * across / np.linalg.norm(across, axis=1, keepdims=True)
    inside = corners.mean(axis=1) - 2e-3 * across / np.linalg.norm(across, axis=1, keepdims=True)
    assert np.all(skin_distance(outside) > skin_distance(inside))


def test_vertices_lie_on_the_signed_distance(mesh):
    assert np.abs(skin_distance(mesh[0])).max() < 1e-3


def test_joints_lie_inside_the_skin():
    centre = [CENTRE_JOINTS[name] for name in ("pelvis", "spine", "thorax", "neck", "head")]
    sides = [
        side_joint(name, side) for side in (1.0, -1.0) for name in SIDE_JOINTS if name not in ("toe", "eye", "ear")
    ]
    assert np.all(skin_distance(np.array([*centre, *sides])) < 0)


def test_weights_are_convex_over_at_most_four_bones(actor):
    weights = np.asarray(actor.weights)
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-6)
    assert weights.min() >= 0
    assert (weights > 0).sum(axis=1).max() <= 4
    assert np.all(weights.max(axis=0) > 0.6)


def test_arms_do_not_move_the_flank_beside_them(actor):
    vertices, weights = np.asarray(actor.vertices), np.asarray(actor.weights)
    flank = (np.abs(vertices[:, 0]) < 0.18) & (vertices[:, 1] > 0.88) & (vertices[:, 1] < 1.12)
    arm = [i for i, name in enumerate(actor.skeleton.body_names) if name.endswith(("upper_arm", "forearm", "hand"))]
    assert flank.sum() > 100
    assert weights[flank][:, arm].max() == 0


def test_neighbouring_vertices_have_similar_weights(actor):
    _, edges = undirected_edges(np.asarray(actor.faces))
    weights = np.asarray(actor.weights)
    assert np.abs(weights[edges[:, 0]] - weights[edges[:, 1]]).max() < 0.6


def test_height_scales_the_same_triangles(actor):
    small = make_actor(1.55)
    np.testing.assert_array_equal(np.asarray(small.faces), np.asarray(actor.faces))
    assert np.ptp(np.asarray(small.vertices)[:, 1]) == pytest.approx(1.55, abs=0.01)
    np.testing.assert_allclose(
        np.asarray(small.skeleton.landmarks), 1.55 / 1.75 * np.asarray(actor.skeleton.landmarks), atol=1e-5
    )


def test_patterned_clothes_vary_within_a_few_centimetres_and_uniform_ones_hardly(mesh):
    vertices = mesh[0]
    chest = (np.abs(vertices[:, 0]) < 0.12) & (vertices[:, 1] > 1.0) & (vertices[:, 1] < 1.35)
    spread = {
        style: Outfit.make(0, style).colours(vertices[chest]).std(axis=0).max() for style in ("patterned", "uniform")
    }
    assert spread["patterned"] > 0.15
    assert spread["uniform"] < 0.04


def test_uniform_clothes_give_arms_the_colour_of_the_torso(mesh):
    outfit = Outfit.make(0, "uniform")
    forearm, chest = np.array([[0.45, 1.17, 0.0]]), np.array([[0.0, 1.2, 0.11]])
    np.testing.assert_allclose(outfit.colours(forearm), outfit.colours(chest), atol=0.12)
    patterned = Outfit.make(0, "patterned")
    assert np.abs(patterned.colours(forearm) - patterned.colours(chest)).max() > 0.12


def test_colours_depend_on_the_seed_alone(mesh):
    np.testing.assert_array_equal(Outfit.make(4).colours(mesh[0]), Outfit.make(4).colours(mesh[0]))
    assert np.any(Outfit.make(4).colours(mesh[0]) != Outfit.make(5).colours(mesh[0]))
