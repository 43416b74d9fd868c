"""Scale, gravity, the metric world and the geometry of views, on cameras with known answers."""

import numpy as np
import pytest
from moving_cameras import MATRIX, centres_of, moved_world, paths, project
from scipy.spatial.transform import Rotation

from jaxmocap.calibration import SubjectView, _scale, fit_scale, triangulate_views
from jaxmocap.calibration._world import find_gravity, ground_plane, up_from_cameras, world_from_model
from jaxmocap.camera import describe_views, view_geometry
from jaxmocap.capture import KEYPOINT_NAMES
from jaxmocap.geometry import align_cameras

PERSON = np.array(
    [
        [0, 1.58, 0.1], [0, 1.42, 0], [-0.18, 1.4, 0], [-0.25, 1.13, 0], [-0.28, 0.9, 0.05],
        [0.18, 1.4, 0], [0.25, 1.13, 0], [0.28, 0.9, 0.05], [0, 0.92, 0], [-0.1, 0.92, 0],
        [-0.11, 0.5, 0.02], [-0.12, 0.09, 0], [0.1, 0.92, 0], [0.11, 0.5, 0.02], [0.12, 0.09, 0],
    ]
)  # fmt: skip
SIMILARITY = (0.23, Rotation.from_euler("xyz", [100, 30, 50], degrees=True).as_matrix(), np.array([3.0, -1.0, 2.0]))
BONES = {
    "upper_arm": ("l_shoulder", "l_elbow"),
    "forearm": ("l_elbow", "l_wrist"),
    "thigh": ("l_hip", "l_knee"),
    "shank": ("l_knee", "l_ankle"),
    "shoulders": ("l_shoulder", "r_shoulder"),
    "hips": ("l_hip", "r_hip"),
}


def joint(name: str) -> np.ndarray:
    return PERSON[KEYPOINT_NAMES.index(name)]


LENGTHS = {name: float(np.linalg.norm(joint(a) - joint(b))) for name, (a, b) in BONES.items()}


def view(poses: np.ndarray, model: np.ndarray, noise: float, generator) -> SubjectView:
    """Keypoints of the person in cameras `poses`, which the model has as `model`."""
    keypoints = np.zeros((len(poses), 25, 3))
    for camera, pose in enumerate(poses):
        pixels = project(pose, PERSON) + noise * generator.normal(size=(15, 2))
        keypoints[camera, :15] = np.concatenate([pixels, np.ones((15, 1))], axis=1)
    return SubjectView(np.stack([MATRIX] * len(poses)), model, keypoints)


def square(generator, tilt: float = 0.0) -> np.ndarray:
    """Points of a level square, and of a wall behind it that outnumber them."""
    across, along = generator.uniform(-4, 4, 500), generator.uniform(-3, 2, 500)
    ground = np.column_stack([across, 0.002 * generator.normal(size=500), along])
    ground = ground @ Rotation.from_rotvec([np.radians(tilt), 0, 0]).as_matrix().T
    wall = np.column_stack([generator.uniform(-4, 4, 900), generator.uniform(0, 3, 900), np.full(900, -3.0)])
    return np.concatenate([ground, wall])


def test_exact_keypoints_triangulate_exactly_and_give_the_scale_exactly():
    poses = paths()[:, ::10].swapaxes(0, 1)
    model = moved_world(poses, *SIMILARITY)
    views = [view(p, m, 0.0, np.random.default_rng(0)) for p, m in zip(poses, model, strict=True)]
    scale, rotation, shift = SIMILARITY
    found = triangulate_views(views[0])
    np.testing.assert_allclose(found[:15], scale * PERSON @ rotation.T + shift, atol=1e-9)
    assert np.isnan(found[15:]).all()
    fitted = fit_scale(views, LENGTHS, "actor", 960)
    assert fitted is not None
    assert fitted.num_bones == 4 * 10
    assert fitted.metres_per_unit == pytest.approx(1 / scale, rel=1e-6)


def test_noisy_keypoints_do_not_make_the_person_small():
    """Distances between noisy points are too long, which makes metres per unit too small; solving for both does not."""
    poses = paths()[:, [5, 30]].swapaxes(0, 1)
    model = moved_world(poses, *SIMILARITY)
    ratios, said, naive = [], [], []
    for seed in range(8):
        generator = np.random.default_rng(seed)
        views = [view(p, m, 3.0, generator) for p, m in zip(poses, model, strict=True)]
        fitted = fit_scale(views, LENGTHS, "actor", 960)
        assert fitted is not None
        ratios.append(fitted.metres_per_unit * SIMILARITY[0])
        said.append(fitted.deviation)
        points = [triangulate_views(each) for each in views]
        index = {name: tuple(map(KEYPOINT_NAMES.index, pair)) for name, pair in BONES.items()}
        lengths = [LENGTHS[n] / np.linalg.norm(p[a] - p[b]) for p in points for n, (a, b) in index.items()]
        naive.append(np.median(lengths) * SIMILARITY[0])
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.015)
    assert np.mean(naive) < np.mean(ratios) - 0.005
    assert 0.4 * np.mean(said) < np.std(ratios) < 2 * np.mean(said)


def test_the_jacobian_is_that_of_finite_differences(monkeypatch):
    poses = paths()[:, ::40].swapaxes(0, 1)
    generator = np.random.default_rng(0)
    problems: list = []

    def record(*problem, **_):
        problems.append(problem)
        raise StopIteration

    views = [view(p, p, 3.0, generator) for p in poses]
    monkeypatch.setattr(_scale, "minimise", record)
    with pytest.raises(StopIteration):
        fit_scale(views, LENGTHS, "actor", 960)
    ((problem, initial),) = problems
    at = initial + 0.01 * generator.normal(size=initial.shape)
    found = problem.jacobian(at).toarray()
    for column in range(len(at)):
        step = 1e-6 * np.eye(len(at))[column]
        expected = (problem.residuals(at + step) - problem.residuals(at - step)) / 2e-6
        np.testing.assert_allclose(found[:, column], expected, rtol=1e-4, atol=1e-4)


def test_keypoints_at_every_frame_take_no_longer_than_a_few_dozen():
    """A thousand frames used to make tens of thousands of unknowns with dense finite differences."""
    poses = np.concatenate([paths().swapaxes(0, 1)] * 20)
    generator = np.random.default_rng(0)
    fitted = fit_scale([view(p, p, 1.0, generator) for p in poses], LENGTHS, "actor", 960)
    assert fitted is not None
    assert fitted.num_frames == _scale.MOST_INSTANTS
    assert fitted.metres_per_unit == pytest.approx(1.0, abs=0.005)


def test_too_few_bones_give_no_scale():
    poses = paths()[:, 0]
    one = view(poses, poses, 0.0, np.random.default_rng(0))
    one.keypoints[1, 3:, 2] = 0
    assert fit_scale([one], LENGTHS, "actor", 960) is None


@pytest.mark.parametrize("turned", [np.eye(3), SIMILARITY[1]])
def test_up_is_at_right_angles_to_the_cameras_x_axes(turned):
    model = moved_world(paths().reshape(-1, 4, 4), 0.23, turned, np.ones(3))
    error = np.degrees(np.arccos(up_from_cameras(model) @ turned @ [0, 1, 0]))
    assert error < 0.5
    one_way = model[[0, 0, 0]]  # no yaw: level by the one camera
    assert np.degrees(np.arccos(up_from_cameras(one_way) @ turned @ [0, 1, 0])) < 20


def test_the_ground_is_preferred_to_a_larger_wall():
    generator = np.random.default_rng(0)
    scale, rotation, shift = SIMILARITY
    model = moved_world(paths().reshape(-1, 4, 4), *SIMILARITY)
    found = find_gravity(model, scale * square(generator) @ rotation.T + shift, 4 * scale)
    assert found.source == "ground"
    assert found.ground is not None
    assert 400 < found.ground.count < 600
    assert np.degrees(np.arccos(found.up @ rotation @ [0, 1, 0])) < 0.2
    assert not found.warnings


def test_sloping_ground_is_warned_of_and_a_steep_plane_is_no_ground():
    generator = np.random.default_rng(0)
    poses = paths().reshape(-1, 4, 4)
    sloping = find_gravity(poses, square(generator, 4.0), 4.0)
    assert sloping.source == "ground"
    assert any("cameras" in warning for warning in sloping.warnings)
    assert ground_plane(square(generator, 20.0), centres_of(poses), np.array([0.0, 1.0, 0.0]), 4.0) is None
    given = find_gravity(poses, square(generator, 4.0), 4.0, given=np.array([0.0, 2.0, 0.0]))
    np.testing.assert_allclose(given.up, [0, 1, 0])


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_the_world_is_metric_upright_and_under_the_person(axis):
    generator = np.random.default_rng(0)
    scale, rotation, shift = SIMILARITY
    true = paths().reshape(-1, 4, 4)
    model = moved_world(true, *SIMILARITY)
    gravity = find_gravity(model, scale * square(generator) @ rotation.T + shift, 4 * scale)
    person = scale * PERSON @ rotation.T + shift
    world = world_from_model(model, 1 / scale, gravity, axis, person, person[[11, 14]])
    points, poses = world(person), world.cameras(model)
    up = "xyz".index(axis)
    across = [i for i in range(3) if i != up]
    np.testing.assert_allclose(points[:, up], PERSON[:, 1], atol=0.02)
    assert np.abs(np.median(points, axis=0)[across]).max() < 0.05
    ahead = centres_of(poses[0]) @ ([0, -1, 0] if axis == "z" else [0, 0, 1])
    assert ahead == pytest.approx(np.linalg.norm(centres_of(poses[0])[across]), rel=1e-3)
    for pose, old in zip(poses[::9], model[::9], strict=True):
        inside = world(person) @ pose[:3, :3].T + pose[:3, 3]
        np.testing.assert_allclose(inside * scale, person @ old[:3, :3].T + old[:3, 3], atol=1e-9)
    assert align_cameras(poses, true).scale == pytest.approx(1.0, abs=1e-9)


def test_depth_gets_worse_as_the_cameras_come_together():
    errors = {}
    for angle in (5.0, 50.0):
        half = np.radians(angle / 2)
        poses = np.array([[[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, 4], [0, 0, 0, 1]]
                          for c, s in ((np.cos(half), np.sin(half)), (np.cos(half), -np.sin(half)))])  # fmt: skip
        found = view_geometry(np.full(2, FOCAL := 900.0), poses, np.zeros(3))
        assert found.angle == pytest.approx(angle)
        assert found.across == pytest.approx(4 / FOCAL / np.sqrt(2))
        assert found.depth == pytest.approx(4 / FOCAL / np.sqrt(2) / np.sin(half))
        errors[angle] = found.depth
        assert f"{angle:.0f} degrees" in describe_views(found)
    assert 9 < errors[5.0] / errors[50.0] < 11
