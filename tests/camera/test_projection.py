import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxmocap.camera import Cameras, View, pixel_rays, project, triangulate


def _rig(seed: int = 0, num_cameras: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Cameras about 4 m from the origin, looking at it from directions 20 degrees apart."""
    rng = np.random.default_rng(seed)
    intrinsics = np.zeros((num_cameras, 3, 3))
    poses = np.tile(np.eye(4), (num_cameras, 1, 1))
    for index in range(num_cameras):
        intrinsics[index] = [[900 + 10 * index, 1.5, 480], [0, 905, 270 + index], [0, 0, 1]]
        turn = Rotation.from_euler("yxz", [np.radians(20) * index, 0.1 * rng.normal(), 0.1 * rng.normal()])
        poses[index, :3, :3] = turn.as_matrix()
        poses[index, :3, 3] = [0.1, -0.2, 4.0]
    return intrinsics, poses


def _numpy_project(intrinsics: np.ndarray, pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    rows = (intrinsics @ (pose[:3, :3] @ points.T + pose[:3, 3:])).T
    return rows[:, :2] / rows[:, 2:]


def _points(count: int = 12) -> np.ndarray:
    return np.random.default_rng(1).uniform(-1, 1, (count, 3))


def test_projection_equals_numpy_in_every_camera():
    intrinsics, poses = _rig()
    points = _points()
    pixels, depth = project(jnp.asarray(intrinsics), jnp.asarray(poses), jnp.asarray(points))
    for index in range(3):
        expected = _numpy_project(intrinsics[index], poses[index], points)
        np.testing.assert_allclose(pixels[index], expected, atol=2e-3)
        np.testing.assert_allclose(
            depth[index], (points @ poses[index, :3, :3].T + poses[index, :3, 3])[:, 2], atol=1e-5
        )


def test_a_point_on_the_axis_falls_on_the_middle_of_the_image_between_pixels():
    # 4x2 pixels: the middle of the image is the corner between four pixels, whose centres are at +-0.5
    intrinsics = jnp.array([[10.0, 0, 2.0], [0, 10.0, 1.0], [0, 0, 1]])
    pixels, depth = project(intrinsics, jnp.eye(4), jnp.array([[0.0, 0, 5.0], [-0.75, -0.25, 5.0]]))
    np.testing.assert_allclose(pixels, [[2.0, 1.0], [0.5, 0.5]], atol=1e-6)
    np.testing.assert_allclose(depth, [5.0, 5.0])


def test_a_point_behind_the_camera_has_negative_depth_and_finite_pixels_and_gradient():
    intrinsics, poses = _rig(num_cameras=1)
    points = jnp.array([[0.0, 0, -8.0], [-0.1, 0.2, -4.0]])
    pixels, depth = project(jnp.asarray(intrinsics[0]), jnp.asarray(poses[0]), points)
    assert depth[0] < 0
    assert np.isfinite(pixels).all()
    gradient = jax.grad(lambda p: project(jnp.asarray(intrinsics[0]), jnp.eye(4), p)[0].sum())(jnp.zeros((1, 3)))
    assert np.isfinite(gradient).all()


def test_rays_pass_through_the_projected_points_and_start_at_the_centre():
    intrinsics, poses = map(jnp.asarray, _rig())
    points = jnp.asarray(_points())
    pixels, _ = project(intrinsics, poses, points)
    centre, direction = pixel_rays(intrinsics, poses, pixels)
    np.testing.assert_allclose(jnp.linalg.norm(direction, axis=-1), 1.0, atol=1e-5)
    offset = points[None] - centre[:, None]
    assert float(jnp.min(jnp.sum(offset * direction, axis=-1))) > 0
    np.testing.assert_allclose(jnp.cross(offset, direction), 0.0, atol=2e-5)


@pytest.mark.parametrize("refinements", [0, 3])
def test_triangulation_returns_the_points(refinements: int):
    intrinsics, poses = map(jnp.asarray, _rig())
    points = jnp.asarray(_points())
    pixels, _ = project(intrinsics, poses, points)
    found = triangulate(View(intrinsics, poses), pixels, jnp.ones((3, 12)), refinements)
    np.testing.assert_allclose(found, points, atol=5e-5)


def test_triangulation_stays_exact_two_kilometres_from_the_origin():
    intrinsics, poses = _rig()
    moved = poses.copy()
    far = np.array([2048.0, 0.0, -1024.0])
    moved[:, :3, 3] -= poses[:, :3, :3] @ far
    pixels = np.stack([_numpy_project(k, p, _points()) for k, p in zip(intrinsics, poses, strict=True)])
    found = triangulate(View(jnp.asarray(intrinsics), jnp.asarray(moved)), jnp.asarray(pixels), jnp.ones((3, 12)))
    np.testing.assert_allclose(found - far, _points(), atol=5e-3)  # a float32 kilometre resolves about 0.1 mm


@pytest.mark.nans
def test_unseen_pixels_are_ignored_and_points_seen_once_are_nan():
    intrinsics, poses = map(jnp.asarray, _rig())
    points = jnp.asarray(_points())
    pixels, _ = project(intrinsics, poses, points)
    pixels = pixels.at[2, :6].set(jnp.nan)
    weights = jnp.ones((3, 12)).at[2, :6].set(0.0).at[1, 0].set(0.0)
    found = triangulate(View(intrinsics, poses), pixels, weights)
    assert np.isnan(found[0]).all()
    np.testing.assert_allclose(found[1:], points[1:], atol=5e-5)


def test_triangulation_minimises_the_weighted_reprojection_error():
    from scipy.optimize import least_squares

    intrinsics, poses = _rig()
    rng = np.random.default_rng(3)
    points = _points(4)
    pixels = np.stack([_numpy_project(k, p, points) for k, p in zip(intrinsics, poses, strict=True)])
    pixels += 3 * rng.normal(size=pixels.shape)
    weights = rng.uniform(0.2, 1.0, (3, 4))
    found = triangulate(View(jnp.asarray(intrinsics), jnp.asarray(poses)), jnp.asarray(pixels), jnp.asarray(weights), 5)
    for index in range(4):

        def residual(point: np.ndarray, index: int = index) -> np.ndarray:
            error = [_numpy_project(k, p, point[None])[0] for k, p in zip(intrinsics, poses, strict=True)]
            return (np.sqrt(weights[:, index, None]) * (np.asarray(error) - pixels[:, index])).ravel()

        # the skew of 1.5 makes the plane's axes and the pixels' differ by a part in 600
        np.testing.assert_allclose(found[index], least_squares(residual, points[index]).x, atol=2e-4)


def _numeric(function, argument: np.ndarray, step: float) -> np.ndarray:
    gradient = np.zeros_like(argument)
    for index in np.ndindex(argument.shape):
        forward, backward = argument.copy(), argument.copy()
        forward[index] += step
        backward[index] -= step
        gradient[index] = (function(forward) - function(backward)) / (2 * step)
    return gradient


def test_projection_gradients_equal_finite_differences():
    intrinsics, poses = _rig(num_cameras=2)
    points = _points(3)
    mix = np.random.default_rng(5).normal(size=(2, 3, 2))
    with jax.enable_x64(True):

        def score(k, p, x):
            return jnp.sum(mix * project(jnp.asarray(k), jnp.asarray(p), jnp.asarray(x))[0])

        arguments = (intrinsics, poses, points)
        gradients = jax.grad(score, argnums=(0, 1, 2))(*map(jnp.asarray, arguments))
        for index in range(3):
            rest = list(arguments)

            def one(value, index: int = index, rest: list = rest):
                return float(score(*rest[:index], value, *rest[index + 1 :]))

            np.testing.assert_allclose(gradients[index], _numeric(one, arguments[index], 1e-5), rtol=1e-5, atol=1e-4)


def test_triangulation_gradient_equals_finite_differences_and_is_finite_for_unseen_points():
    intrinsics, poses = _rig()
    with jax.enable_x64(True):
        view = View(jnp.asarray(intrinsics), jnp.asarray(poses))
        pixels = np.asarray(project(view.intrinsics, view.cam_from_world, jnp.asarray(_points(2)))[0]) + 1.0
        weights = jnp.ones((3, 2)).at[0, 1].set(0.0)

        def score(value):
            return jnp.sum(triangulate(view, jnp.asarray(value), weights)[0] * jnp.array([1.0, -2.0, 0.5]))

        gradient = jax.grad(score)(jnp.asarray(pixels))
        assert np.isfinite(gradient).all()
        np.testing.assert_allclose(gradient, _numeric(lambda v: float(score(v)), pixels, 1e-3), rtol=1e-4, atol=1e-9)


def test_cameras_give_views_and_centres():
    intrinsics, poses = _rig()
    moving = np.stack([poses, poses], axis=1)
    moving[:, 1, :3, 3] = moving[:, 1, :3, 3] + [0, 0, 1.0]
    cameras = Cameras(
        ("a", "b", "c"), ((960, 540),) * 3, jnp.asarray(intrinsics), jnp.zeros((3, 5)), jnp.asarray(moving)
    )
    assert (cameras.num_cameras, cameras.num_frames) == (3, 2)
    np.testing.assert_allclose(cameras.at(1).cam_from_world, moving[:, 1], atol=1e-6)
    expected = np.linalg.inv(moving)[..., :3, 3]
    np.testing.assert_allclose(cameras.centres(), expected, atol=1e-5)
    with pytest.raises(IndexError, match=r"frame 2 is outside 0\.\.1"):
        cameras.at(2)
    traced = jax.jit(lambda c, t: c.at(t).cam_from_world)(cameras, 1)
    np.testing.assert_allclose(traced, moving[:, 1], atol=1e-6)
