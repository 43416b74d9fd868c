import jax
import numpy as np
import pytest

from jaxmocap.character import landmark_positions, skin
from jaxmocap.synthetic import dance, filming_distance, handheld_paths, intrinsics_of, make_actor, stand
from jaxmocap.synthetic._motion import ground_path

TIMES = np.arange(240) / 30


@pytest.fixture(scope="module")
def actor():
    return make_actor()


@pytest.fixture(scope="module")
def poses(actor):
    return dance(actor.skeleton, TIMES)


@pytest.fixture(scope="module")
def joints(actor, poses):
    positions = jax.jit(jax.vmap(landmark_positions, (None, 0)))(actor.skeleton, poses)
    return dict(zip(actor.skeleton.landmark_names, np.asarray(positions).transpose(1, 0, 2), strict=True))


@pytest.mark.parametrize("scale", [0.0, 1.0, 1.2])
def test_joint_angles_stay_inside_their_limits(actor, scale):
    angles = np.asarray(dance(actor.skeleton, TIMES, scale).angles)
    assert np.all(angles > np.asarray(actor.skeleton.lower))
    assert np.all(angles < np.asarray(actor.skeleton.upper))


def test_hands_reach_about_two_and_a_half_metres_per_second(joints):
    speed = max(np.linalg.norm(np.diff(joints[name], axis=0) * 30, axis=1).max() for name in ("l_wrist", "r_wrist"))
    assert 1.5 < speed < 2.7


def test_motion_is_smooth_at_thirty_frames_per_second(joints):
    for positions in joints.values():
        assert np.abs(np.diff(positions, n=2, axis=0)).max() < 0.03


def test_feet_stand_on_the_ground_at_every_instant(actor, poses):
    vertices = jax.jit(jax.vmap(skin, (None, 0)))(actor, jax.tree.map(lambda leaf: leaf[::5], poses))
    assert np.abs(np.asarray(vertices)[:, :, 1].min(axis=1)).max() < 0.012


def test_one_knee_is_lifted_high_once(joints):
    higher = joints["l_knee"][:, 1] - joints["r_knee"][:, 1]
    assert higher.max() > 0.18
    assert np.ptp(np.flatnonzero(higher > 0.15)) < 30


def test_no_scale_is_no_motion(actor):
    poses = dance(actor.skeleton, TIMES[:5], 0.0)
    np.testing.assert_allclose(np.asarray(poses.angles), np.asarray(poses.angles)[:1].repeat(5, 0), atol=1e-6)


def test_cameras_are_twenty_five_to_thirty_degrees_apart():
    targets = ground_path(TIMES)
    for count in (2, 3):
        paths = handheld_paths(TIMES, targets, filming_distance((480, 270)), count)
        centres = -np.einsum("ctji,ctj->cti", paths[..., :3, :3], paths[..., :3, 3])
        rays = targets + [0, 1.0, 0] - centres
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        angles = np.degrees(np.arccos(np.sum(rays[:-1] * rays[1:], axis=-1)))
        assert np.all((angles > 20) & (angles < 34))
        assert 25 < angles.mean() < 30


def test_the_actor_fills_three_quarters_of_the_height():
    size = (480, 270)
    intrinsics = intrinsics_of(size)
    assert intrinsics[0, 0] == pytest.approx(0.95 * 480)
    for path in handheld_paths(np.zeros(1), np.zeros((1, 3)), filming_distance(size), 3, shake=0.0):
        head_and_feet = np.array([[0, 1.75, 0], [0, 0, 0]]) @ path[0, :3, :3].T + path[0, :3, 3]
        pixels = head_and_feet @ intrinsics.T
        rows = pixels[:, 1] / pixels[:, 2]
        assert rows[1] - rows[0] == pytest.approx(0.75 * 270, rel=0.05)
        assert rows.min() > 0.05 * 270
        assert rows.max() < 0.98 * 270


def test_hands_shake_by_centimetres_and_about_a_degree():
    targets = np.zeros((240, 3))
    distance = filming_distance((480, 270))
    still, held = (handheld_paths(TIMES, targets, distance, 2, seed=2, shake=shake) for shake in (0.0, 1.0))
    assert np.abs(np.diff(still, axis=1)).max() < 1e-12
    relative = held[..., :3, :3] @ np.swapaxes(still[..., :3, :3], -1, -2)
    angle = np.degrees(np.arccos(np.clip((np.trace(relative, axis1=-2, axis2=-1) - 1) / 2, -1, 1)))
    assert 0.3 < angle.mean() < 4
    centres = -np.einsum("ctji,ctj->cti", held[..., :3, :3], held[..., :3, 3])
    jumps = np.linalg.norm(np.diff(centres, axis=1), axis=-1)
    assert 0.001 < jumps.mean() < 0.02
    np.testing.assert_allclose(
        held[..., :3, :3] @ np.swapaxes(held[..., :3, :3], -1, -2),
        np.broadcast_to(np.eye(3), (2, 240, 3, 3)),
        atol=1e-12,
    )


def test_somebody_who_stands_sways_about_the_pose_at_rest(actor):
    times = np.linspace(0, 30, 90)
    bodies = np.asarray(jax.jit(jax.vmap(skin, (None, 0)))(actor, stand(actor.skeleton, times, 0.03, seed=1)))
    rest = np.asarray(actor.vertices)
    away = np.linalg.norm(bodies - rest, axis=-1)
    head, feet = rest[:, 1] > 1.5, rest[:, 1] < 0.05
    assert np.sqrt((away[:, head] ** 2).mean()) == pytest.approx(0.03, rel=0.3)
    assert np.sqrt((away[:, feet] ** 2).mean()) < 0.003
    assert np.linalg.norm(bodies.mean(axis=0) - rest, axis=1).max() < 0.003
    assert np.linalg.norm(np.diff(bodies, axis=0), axis=-1).max() < 0.04  # in a third of a second
    np.testing.assert_allclose(
        skin(actor, jax.tree.map(lambda leaf: leaf[5], stand(actor.skeleton, times, 0.0))), rest, atol=1e-6
    )
