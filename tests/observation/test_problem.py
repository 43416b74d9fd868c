"""A frame as arrays: what is in them, at which pixels, and what a coarser copy sees."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap.camera import project
from jaxmocap.character import skin
from jaxmocap.geometry import facing_cosine
from jaxmocap.observation import Observations, build_problem, full_image_ids, surface_of
from jaxmocap.observation._rectangle import Rectangle
from jaxmocap.render import face_ids

FRAME = 2


def test_arrays_are_those_of_the_rectangle(world):
    problem, rectangle = world.problem(FRAME), world.rectangle(FRAME)
    assert problem.num_cameras == 2
    assert problem.size == (rectangle.height, rectangle.width)
    np.testing.assert_array_equal(problem.origins, rectangle.origins)
    assert float(problem.area) == pytest.approx(rectangle.area)
    for camera, image in enumerate(world.truth.images[FRAME]):
        np.testing.assert_allclose(problem.image[camera], rectangle.crop(image, camera) / 255.0, atol=1e-6)
    np.testing.assert_allclose(problem.intrinsics, world.cameras.at(FRAME).intrinsics)
    np.testing.assert_allclose(problem.cam_from_world, world.cameras.at(FRAME).cam_from_world)
    np.testing.assert_allclose(
        problem.projection, np.asarray(problem.intrinsics) @ np.asarray(problem.cam_from_world)[:, :3]
    )


def test_labels_are_the_nearest_palette_colours(world):
    problem, palette = world.problem(FRAME), np.asarray(world.appearance.palette.colours)
    rng = np.random.default_rng(0)
    for camera, row, column in zip(
        rng.integers(0, 2, 60), *(rng.integers(0, n, 60) for n in problem.size), strict=True
    ):
        colour = np.asarray(problem.image[camera, row, column])
        distance = np.linalg.norm(palette - colour, axis=1)
        assert distance[int(problem.labels[camera, row, column])] < distance.min() + 0.03


def test_background_is_near_where_it_shows_and_far_where_the_person_stands(world):
    background, masks = np.asarray(world.problem(FRAME).background), world.masks(FRAME)
    assert np.all((background >= 0) & (background <= 1.0 + 1e-3))
    assert np.median(background[~masks]) < 0.1
    assert background[masks].mean() > 0.5 > 3 * background[~masks].mean()


def test_without_a_background_every_pixel_is_foreign(world):
    appearance = replace(world.appearance, settings=replace(world.appearance.settings, behind="none"))
    observations = Observations(world.capture, world.cameras, world.character, appearance, world.key_poses)
    problem = observations.problem(world.shown(FRAME), world.rectangle(FRAME), world.pose(FRAME))
    assert np.all(np.asarray(problem.background) == 1.0)
    np.testing.assert_array_equal(problem.edges.mask, world.problem(FRAME).edges.mask)
    nothing = observations.background.start()
    given = world.shown(FRAME), world.rectangle(FRAME), world.pose(FRAME)
    assert observations.background.learn(nothing, *given) is nothing


def test_true_surface_looks_like_its_model(world):
    """psi_f of the face seen in each pixel at the true pose, in a frame the models were not fitted at."""
    problem = world.problem(FRAME)
    ids, _ = face_ids(
        jnp.asarray(world.vertices(FRAME)), world.character.faces, problem.intrinsics, problem.cam_from_world,
        problem.origins, *problem.size,
    )  # fmt: skip
    table, labels = np.asarray(problem.surface.colour_distance, np.float32), np.asarray(problem.labels)
    rng, shuffled = np.random.default_rng(0), []
    for camera in range(2):
        seen = np.asarray(ids[camera]) >= 0
        face = np.asarray(ids[camera])[seen]
        own = table[camera][face, labels[camera][seen]]
        other = table[camera][rng.permutation(face), labels[camera][seen]]
        shuffled.append((own.mean(), other.mean()))
    assert all(own < 0.45 * other for own, other in shuffled)


def test_depth_range_holds_the_body(world):
    problem = world.problem(FRAME)
    for camera in range(2):
        _, depth = project(
            problem.intrinsics[camera], problem.cam_from_world[camera], jnp.asarray(world.vertices(FRAME))
        )
        low, high = 1 / np.asarray(problem.depth_range[camera])[::-1]
        assert low < depth.min() - 0.7
        assert high > depth.max() + 0.7


def test_a_surface_without_appearance_is_neutral_everywhere(world):
    surface = surface_of(world.character, None, 3)
    faces = len(world.character.faces)
    np.testing.assert_array_equal(surface.colour_distance, np.ones((3, faces, 1)))
    assert not surface.has_colour.any()
    problem = build_problem(
        list(world.truth.images[0]),
        world.rectangle(0),
        world.cameras,
        0,
        world.vertices(0),
        surface_of(world.character, None, 2),
    )
    np.testing.assert_array_equal(problem.labels, 0)
    np.testing.assert_array_equal(problem.background, 1)


@pytest.mark.parametrize("step", [2, 4])
def test_coarser_pixels_are_every_step_th_pixel_and_project_to_their_centres(world, step):
    fine, coarse = world.problem(FRAME), world.problem(FRAME).coarser(step)
    first = step // 2
    for name in ("image", "labels", "background"):
        np.testing.assert_array_equal(
            getattr(coarse, name), np.asarray(getattr(fine, name))[:, first::step, first::step]
        )
    np.testing.assert_array_equal(coarse.edges.mask, np.asarray(fine.edges.mask)[:, first::step, first::step])
    points = jnp.asarray(world.vertices(FRAME)[::20])
    for camera in range(2):
        here, _ = project(fine.intrinsics[camera], fine.cam_from_world[camera], points)
        there, _ = project(coarse.intrinsics[camera], coarse.cam_from_world[camera], points)
        # Index (first + step i) of the fine rectangle has its centre at + 0.5, and is index i of the coarse one.
        local = np.asarray(here) - np.asarray(fine.origins[camera])[::-1] - 0.5
        expected = (local - first) / step
        found = np.asarray(there) - np.asarray(coarse.origins[camera])[::-1] - 0.5
        np.testing.assert_allclose(found, expected, atol=2e-3)
    assert float(coarse.area) == pytest.approx(float(fine.area) / step**2)
    assert fine.coarser(1) is fine


def test_a_coarser_drawing_is_every_second_pixel_of_the_fine_one(world):
    vertices, faces = jnp.asarray(world.vertices(FRAME)), world.character.faces
    drawn = []
    for problem in (world.problem(FRAME), world.problem(FRAME).coarser(2)):
        ids, _ = face_ids(vertices, faces, problem.intrinsics, problem.cam_from_world, problem.origins, *problem.size)
        drawn.append(np.asarray(ids))
    same = drawn[0][:, 1::2, 1::2] == drawn[1]
    assert (~same).sum() <= 2e-3 * (drawn[1] >= 0).sum()


def test_whole_images_show_the_true_mask(world):
    ids = full_image_ids(world.character, jnp.asarray(world.vertices(1)), world.cameras, 1)
    for camera in range(2):
        assert ids[camera].shape == world.truth.masks[1, camera].shape
        assert ((ids[camera] >= 0) != world.truth.masks[1, camera]).sum() <= 3


def test_facing_cosine_of_known_triangles():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    faces = np.array([[0, 1, 2], [0, 2, 1], [1, 1, 1]])
    centre = vertices[:3].mean(0)
    np.testing.assert_allclose(facing_cosine(vertices[faces], centre + [0, 0, 5])[:2], [1, -1], atol=1e-12)
    np.testing.assert_allclose(facing_cosine(vertices[faces], centre + [3, 0, 4])[:2], [0.8, -0.8], atol=1e-12)
    assert facing_cosine(vertices[faces], np.array([0, 0, 5.0]))[2] == 0


def test_frames_are_streamed_in_order_with_their_times(world):
    shown = list(world.observations().frames(range(1, 3)))
    assert [s.frame for s in shown] == [1, 2]
    np.testing.assert_allclose([s.timestamp for s in shown], world.truth.timestamps[1:])
    for s in shown:
        for camera, image in enumerate(s.images):
            error = [np.abs(image - world.truth.images[f, camera].astype(float)).mean() for f in range(3)]
            assert int(np.argmin(error)) == s.frame
            assert error[s.frame] < 6  # compressed


def test_the_same_frame_gives_the_same_problem_whatever_was_seen_before(world):
    fresh, used = world.observations(), world.observations()
    used.problem(world.shown(1), world.rectangle(1), world.pose(1))
    first = fresh.problem(world.shown(0), world.rectangle(0), world.pose(0))
    second = used.problem(world.shown(0), world.rectangle(0), world.pose(0))
    np.testing.assert_array_equal(first.background, second.background)
    np.testing.assert_array_equal(first.labels, second.labels)


def test_edges_of_a_problem_have_unit_gradients(world):
    edges = world.problem(FRAME).edges
    mask = np.asarray(edges.mask)
    assert mask.any()
    np.testing.assert_allclose(np.linalg.norm(np.asarray(edges.gradient), axis=-1)[mask], 1, atol=1e-3)


def test_given_edges_and_labels_are_taken(world):
    rectangle = Rectangle(np.array([[0, 0], [0, 0]]), 8, 12, 96.0)
    edges = [(np.eye(8, 12, dtype=bool), np.ones((8, 12, 2), np.float32))] * 2
    labels, background = [np.full((8, 12), 7)] * 2, [np.full((8, 12), 0.25)] * 2
    problem = build_problem(
        list(world.truth.images[0]), rectangle, world.cameras, 0, np.asarray(skin(world.character, world.pose(0))),
        surface_of(world.character, None, 2), labels, background, edges,
    )  # fmt: skip
    np.testing.assert_array_equal(problem.edges.mask[1], np.eye(8, 12, dtype=bool))
    np.testing.assert_array_equal(problem.labels, 7)
    np.testing.assert_array_equal(problem.background, 0.25)
