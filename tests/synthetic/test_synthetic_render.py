from itertools import pairwise

import cv2
import numpy as np
import pytest

from jaxmocap.geometry import surface_nets
from jaxmocap.synthetic import Outfit, Scene, Subject, make_scene, render_view
from jaxmocap.synthetic._draw_scene import render_scene
from jaxmocap.synthetic._raster import visible_fragments
from jaxmocap.synthetic._scene import AMBIENT, DIRECT, SUN, _panel

SIZE = (120, 90)
INTRINSICS = np.array([[110.0, 0, 61.0], [0, 112.0, 44.0], [0, 0, 1]])
BOX_SIDES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
BOX_FACES = np.array([(a, b, c) for a, *rest in BOX_SIDES for b, c in pairwise(rest)])


def turned(angle: float) -> np.ndarray:
    return cv2.Rodrigues(angle * np.array([0.3, 0.9, 0.2]))[0]


def box(angle: float) -> np.ndarray:
    corners = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.4, 0.4) for z in (-0.3, 0.3)])
    return corners @ turned(angle).T + [0.1, -0.1, 2.5]


def pixel_centres() -> np.ndarray:
    rows, columns = np.mgrid[: SIZE[1], : SIZE[0]] + 0.5
    return np.stack([columns, rows], axis=-1).reshape(-1, 2)


@pytest.mark.parametrize("angle", [0.0, 0.4, 1.1, 2.0])
def test_a_box_covers_exactly_the_hull_of_its_projected_corners(angle):
    points = box(angle)
    pixels = points @ INTRINSICS.T
    hull = cv2.convexHull((pixels[:, :2] / pixels[:, 2:]).astype(np.float32))
    distance = np.array([cv2.pointPolygonTest(hull, tuple(map(float, p)), True) for p in pixel_centres()])
    covered = np.zeros(SIZE[0] * SIZE[1], bool)
    covered[visible_fragments(points, BOX_FACES, INTRINSICS, SIZE).index] = True
    clear = np.abs(distance) > 1e-3
    np.testing.assert_array_equal(covered[clear], distance[clear] > 0)


def test_a_sphere_covers_its_analytic_outline_within_a_pixel():
    grid = np.linspace(-0.6, 0.6, 29)
    corners = np.stack(np.meshgrid(grid, grid, grid, indexing="ij"), axis=-1)
    vertices, faces = surface_nets(lambda p: np.linalg.norm(p, axis=1) - 0.5, corners)
    centre = np.array([0.3, 0.1, 2.2])
    rays = np.c_[pixel_centres(), np.ones(len(pixel_centres()))] @ np.linalg.inv(INTRINSICS).T
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    distance = np.linalg.norm(np.cross(rays, centre), axis=1)
    covered = np.zeros(len(rays), bool)
    covered[visible_fragments(vertices + centre, faces, INTRINSICS, SIZE).index] = True
    pixel = 2.2 / 110
    assert np.all(covered[distance < 0.5 - pixel])
    assert not np.any(covered[distance > 0.5 + pixel])


def test_interpolated_points_project_to_the_pixel_centre_at_the_stated_depth():
    points = box(0.7)
    fragments = visible_fragments(points, BOX_FACES, INTRINSICS, SIZE)
    surface = fragments.interpolate(BOX_FACES, points)
    pixels = surface @ INTRINSICS.T
    np.testing.assert_allclose(pixels[:, :2] / pixels[:, 2:], pixel_centres()[fragments.index], atol=1e-9)
    np.testing.assert_allclose(1 / surface[:, 2], fragments.inverse_depth, rtol=1e-12)


def test_the_nearer_of_two_triangles_is_seen_whatever_their_order():
    near = np.array([(-1.0, -1, 2), (0, 1, 2), (1, -1, 2)])
    points = np.concatenate([near + [0, 0, 2], near])
    for faces, expected in ((np.array([(0, 1, 2), (3, 4, 5)]), 1), (np.array([(3, 4, 5), (0, 1, 2)]), 0)):
        fragments = visible_fragments(points, faces, INTRINSICS, SIZE)
        middle = fragments.index == 44 * SIZE[0] + 61
        assert fragments.face[middle].tolist() == [expected]
        assert len(np.unique(fragments.index)) == len(fragments.index)


def test_faces_turned_away_or_behind_the_camera_are_not_drawn():
    assert len(visible_fragments(box(0.3), BOX_FACES[:, ::-1], INTRINSICS, SIZE).index) != 0
    triangle = np.array([(-1.0, -1, 2), (0, 1, 2), (1, -1, 2)])
    assert len(visible_fragments(triangle, np.array([(0, 1, 2)]), INTRINSICS, SIZE).index) > 0
    assert len(visible_fragments(triangle, np.array([(0, 2, 1)]), INTRINSICS, SIZE).index) == 0
    assert len(visible_fragments(triangle * (1, 1, -1), np.array([(0, 2, 1)]), INTRINSICS, SIZE).index) == 0


def upright_camera(x: float = 0.0) -> np.ndarray:
    """At (x, 1, 0), looking along -z."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = -pose[:3, :3] @ [x, 1.0, 0.0]
    return pose


def test_the_ground_lies_at_its_ray_plane_distance():
    scene = Scene((_panel((-20, 0, -20), (40, 0, 0), (0, 0, 40), np.full((8, 8, 3), 0.5, np.float32)),))
    light, inverse_depth = render_scene(scene, INTRINSICS, upright_camera(), SIZE)
    rows = np.arange(50, 90)
    np.testing.assert_allclose(inverse_depth[rows, 60], (rows + 0.5 - 44.0) / 112.0, rtol=1e-4)
    np.testing.assert_allclose(light[80, 60], 0.25 * (AMBIENT + DIRECT * SUN[1]), rtol=0.01)


def test_walls_at_two_depths_shift_by_focal_times_baseline_over_depth():
    patch = np.zeros((64, 64, 3), np.float32)
    patch[16:48, 16:48] = 1
    walls = {
        2.0: Scene((_panel((-0.5, 1.5, -2), (1, 0, 0), (0, -1, 0), patch),)),
        4.0: Scene((_panel((-0.5, 1.5, -4), (1, 0, 0), (0, -1, 0), patch),)),
    }
    for depth, scene in walls.items():
        columns = []
        for x in (0.0, 0.2):
            light, inverse_depth = render_scene(scene, INTRINSICS, upright_camera(x), SIZE)
            white = np.where(inverse_depth > 0.1, light[..., 0], 0)
            columns.append((white.sum(axis=0) * (np.arange(SIZE[0]) + 0.5)).sum() / white.sum())
        assert columns[0] - columns[1] == pytest.approx(110 * 0.2 / depth, abs=0.15)


def test_nearer_panels_hide_farther_ones_whatever_their_order():
    near = _panel((-0.5, 1.5, -2), (1, 0, 0), (0, -1, 0), np.full((8, 8, 3), 0.9, np.float32))
    far = _panel((-2, 3, -4), (4, 0, 0), (0, -4, 0), np.full((8, 8, 3), 0.1, np.float32))
    first, second = (
        render_scene(Scene(panels), INTRINSICS, upright_camera(), SIZE) for panels in ((near, far), (far, near))
    )
    np.testing.assert_array_equal(first[0], second[0])
    assert first[1][44, 61] == pytest.approx(0.5, rel=1e-5)


def test_the_square_shows_depths_from_two_to_more_than_ten_metres():
    pose = upright_camera()
    pose[:3, 3] = -pose[:3, :3] @ [0, 1.4, 4.0]
    _, inverse_depth = render_scene(make_scene(0), INTRINSICS, pose, SIZE)
    depth = 1 / inverse_depth
    assert depth.min() < 3.5
    assert np.percentile(depth, 90) > 9


@pytest.fixture(scope="module")
def subject_and_vertices(small_capture):
    rest = np.asarray(small_capture.character.vertices)
    return Subject(rest, np.asarray(small_capture.character.faces), Outfit.make(0)), np.asarray(rest, float)


def test_only_the_mask_and_its_shadow_on_the_ground_differ_from_the_empty_scene(small_capture, subject_and_vertices):
    subject, vertices = subject_and_vertices
    intrinsics = np.asarray(small_capture.cameras.intrinsics[0], float)
    pose = np.asarray(small_capture.cameras.cam_from_world[0, 0], float)
    rendered = render_view(make_scene(1), subject, vertices, intrinsics, pose, small_capture.size)
    np.testing.assert_array_equal(rendered.mask, rendered.ids >= 0)
    fine = intrinsics * np.array([[2.0], [2.0], [1.0]])
    empty, _ = render_scene(make_scene(1), fine, pose, (384, 216))
    changed = np.abs(rendered.light - cv2.resize(empty, small_capture.size, interpolation=cv2.INTER_AREA)).max(axis=2)
    around = cv2.dilate(rendered.mask.astype(np.uint8), np.ones((3, 3))) > 0
    wall = np.zeros_like(around)
    wall[: small_capture.size[1] // 3] = True
    assert np.all(changed[~around & wall] == 0)
    assert np.mean(changed[rendered.mask] > 0.01) > 0.9
    assert np.mean(changed[~around & ~wall] > 0.05) > 0.005


def test_a_panel_before_the_actor_hides_it(small_capture, subject_and_vertices):
    subject, vertices = subject_and_vertices
    board = _panel((-1, 0.9, 1.0), (2, 0, 0), (0, -0.9, 0), np.full((8, 8, 3), 0.5, np.float32))
    pose = upright_camera()
    pose[:3, 3] = -pose[:3, :3] @ [0, 0.9, 4.0]
    rendered = render_view(Scene((board,)), subject, vertices, INTRINSICS, pose, SIZE)
    assert rendered.mask[: 44 - 1].any()
    assert not rendered.mask[44 + 1 :].any()
