"""The covariance of joints is that of what a linear fit would find again and again."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import chi2

from jaxmocap.character import Pose, landmark_positions, retract
from jaxmocap.synthetic import make_actor
from jaxmocap.verdict import FrameResult, UncertaintySettings, joint_covariances, usual_deviations

PLAIN = UncertaintySettings(
    correlated=1.0, free_root=1e3, free_angle=1e3, particles=0.0, scale=1.0, doubt=0.0, floor=0.0
)


@pytest.fixture(scope="module")
def skeleton():
    return make_actor().skeleton


def pose_of(skeleton, seed=0):
    rng = np.random.default_rng(seed)
    return Pose(jnp.eye(4), jnp.asarray(0.2 * rng.standard_normal(33), jnp.float32))


def result(skeleton, pose, hessian=None, deviation=None, energy=True, frame=0):
    landmarks = len(skeleton.landmark_names)
    deviation = np.zeros(39) if deviation is None else deviation
    known = {"model_view": 0.1} if energy else {}
    return FrameResult(
        frame, 0.0, pose, known, np.ones(landmarks), "ok", deviation, hessian, {}, np.zeros(4), np.ones(4)
    )


def moves(skeleton, pose):
    return np.asarray(
        jax.jacfwd(lambda step: landmark_positions(skeleton, retract(skeleton, pose, step)))(jnp.zeros(39)), np.float64
    )


def test_it_is_what_repeated_fits_scatter_by(skeleton):
    """Rows that measure landmarks with noise of 1; the fit's scatter over 4,000 draws, to a tenth."""
    pose, rng = pose_of(skeleton), np.random.default_rng(1)
    rows = np.concatenate([moves(skeleton, pose).reshape(-1, 39) / 0.01, np.eye(39) * 5.0])
    found = np.linalg.lstsq(rows, rng.standard_normal((len(rows), 4000)), rcond=None)[0]
    scattered = np.einsum("jad,dn->jan", moves(skeleton, pose), found)
    expected = np.einsum("jan,jbn->jab", scattered, scattered) / 4000
    (covariance,) = joint_covariances(skeleton, [result(skeleton, pose, rows.T @ rows)], PLAIN)
    size = np.trace(expected, axis1=1, axis2=2)[:, None, None]
    np.testing.assert_allclose(covariance / size, expected / size, atol=0.1)
    (wider,) = joint_covariances(skeleton, [result(skeleton, pose, rows.T @ rows)], PLAIN._replace(correlated=4.0))
    np.testing.assert_allclose(wider / size, 4 * covariance / size, rtol=0.02, atol=1e-3)


def test_what_nothing_tells_stays_free(skeleton):
    """Everything but the left elbow is known: its wrist may be anywhere on a circle, and no other joint moves."""
    elbow = skeleton.dof_names.index("l_elbow_flex")
    known = np.diag(np.where(np.arange(39) == elbow, 0.0, 1e8))
    settings = PLAIN._replace(free_angle=0.5)
    pose = pose_of(skeleton)
    (covariance,) = joint_covariances(skeleton, [result(skeleton, pose, known)], settings)
    deviation = np.sqrt(np.trace(covariance, axis1=1, axis2=2))
    lever = np.linalg.norm(moves(skeleton, pose)[:, :, elbow], axis=1)
    np.testing.assert_allclose(deviation, 0.5 * lever, atol=2e-3)
    wrist = skeleton.landmark_names.index("l_wrist")
    assert deviation[wrist] > 0.08
    assert deviation[skeleton.landmark_names.index("r_wrist")] < 2e-3


def test_particles_and_the_floor_add_up(skeleton):
    deviation = np.zeros(39)
    deviation[0] = 0.03
    settings = PLAIN._replace(particles=2.0, floor=0.01)
    known = 1e8 * np.eye(39)
    (covariance,) = joint_covariances(skeleton, [result(skeleton, pose_of(skeleton), known, deviation)], settings)
    expected = np.diag([0.06**2 + 0.01**2, 0.01**2, 0.01**2])
    np.testing.assert_allclose(covariance, np.broadcast_to(expected, covariance.shape), atol=2e-6)


def test_a_joint_that_is_doubted_is_less_sure(skeleton):
    whole = result(skeleton, pose_of(skeleton), 1e6 * np.eye(39))
    confidence = np.ones(len(skeleton.landmark_names))
    confidence[3] = 0.5
    settings = PLAIN._replace(scale=2.0, doubt=4.0)
    plain, doubted = (
        joint_covariances(skeleton, [replace(whole, confidence=c)], s)[0]
        for c, s in ((confidence, PLAIN), (confidence, settings))
    )
    np.testing.assert_allclose(doubted[3], (2 * 3) ** 2 * plain[3], rtol=1e-5)
    np.testing.assert_allclose(doubted[4], 2**2 * plain[4], rtol=1e-5)


def test_a_start_and_a_frame_passed_over_take_what_the_nearest_frame_tells(skeleton):
    pose, known = pose_of(skeleton), 1e6 * np.eye(39)
    unseen = replace(result(skeleton, pose, energy=False), confidence=np.zeros(len(skeleton.landmark_names)))
    frames = [result(skeleton, pose), result(skeleton, pose, known), unseen, unseen]
    settings = PLAIN._replace(free_root=0.3, free_angle=0.3, scale=0.1, doubt=4.0)
    first, second, *over = joint_covariances(skeleton, frames, settings)
    np.testing.assert_array_equal(first, second)
    for third in over:
        np.testing.assert_allclose(third, 25 * second, rtol=1e-2, atol=1e-7)


def test_the_usual_deviation_is_that_of_half_of_the_landmarks_along_one_axis(skeleton):
    pose = pose_of(skeleton)
    results = [result(skeleton, pose, scale * np.eye(39)) for scale in (1e4, 1e2)]
    each = np.sqrt(np.trace(joint_covariances(skeleton, results), axis1=-2, axis2=-1) / 3)  # of full confidence
    results = [replace(one, confidence=0.5 * one.confidence) for one in results]
    found = usual_deviations(skeleton, results)
    np.testing.assert_allclose(found, np.median(each, axis=1), rtol=1e-5)
    assert found[0] < 0.5 * found[1]
    assert usual_deviations(skeleton, [result(skeleton, pose)]) is None


def test_a_limb_that_no_view_shows_is_free_itself_and_no_doubt_about_the_rest(skeleton):
    pose, arm = pose_of(skeleton), list(skeleton.group("l_arm"))
    known = 1e6 * np.eye(39)
    hidden = known.copy()
    hidden[arm, arm] = 0.0
    seen, unseen = joint_covariances(skeleton, [result(skeleton, pose, h) for h in (known, hidden)])
    deviation = np.sqrt(np.trace(unseen, axis1=1, axis2=2) / 3)
    wrist, knee = (skeleton.landmark_names.index(name) for name in ("l_wrist", "l_knee"))
    assert deviation[wrist] > 0.1
    np.testing.assert_allclose(unseen[knee], seen[knee], rtol=1e-3)
    for confidence in (0.0, 1.0):  # what nothing tells is as free, however sure the pixels are
        of = replace(result(skeleton, pose, hidden), confidence=np.full(len(skeleton.landmark_names), confidence))
        (again,) = joint_covariances(skeleton, [of])
        np.testing.assert_allclose(again[wrist], unseen[wrist], rtol=0.05)
    one, other = usual_deviations(skeleton, [result(skeleton, pose, h) for h in (known, hidden)])
    assert other < 1.2 * one


def test_a_hessian_that_is_not_finite_tells_nothing_and_spoils_nothing(skeleton):
    pose, known = pose_of(skeleton), 1e6 * np.eye(39)
    broken = known.copy()
    broken[3, 4] = np.nan
    found = joint_covariances(skeleton, [result(skeleton, pose, known), result(skeleton, pose, broken)], PLAIN)
    assert np.isfinite(found).all()
    np.testing.assert_array_equal(found[1], found[0])


def test_how_far_a_body_is_from_the_person_is_in_it(skeleton):
    """With exact pictures, errors of 1 cm along each axis are as large as a misfit of 1 cm says."""
    pose, rng = pose_of(skeleton), np.random.default_rng(3)
    known = [result(skeleton, pose, 1e8 * np.eye(39))]
    away = 0.01 * rng.standard_normal((4000, 3))
    distances = []
    for misfit in (0.01, 0.0):
        covariance = joint_covariances(skeleton, known, UncertaintySettings(floor=0.0), misfit=misfit)[0, 0]
        distances.append(np.einsum("na,ab,nb->n", away, np.linalg.inv(covariance.astype(float)), away))
    assert np.mean(distances[0] <= chi2.ppf(0.5, 3)) == pytest.approx(0.5, abs=0.03)
    assert np.mean(distances[0] <= chi2.ppf(0.9, 3)) == pytest.approx(0.9, abs=0.03)
    assert np.median(distances[1]) > 100 * np.median(distances[0])


def test_it_is_positive_definite_however_little_is_known(skeleton):
    rng = np.random.default_rng(2)
    rows = rng.standard_normal((3, 39)) * 1e3
    (covariance,) = joint_covariances(skeleton, [result(skeleton, pose_of(skeleton), rows.T @ rows)])
    assert (np.linalg.eigvalsh(covariance) > 0.005**2).all()
    np.testing.assert_allclose(covariance, np.swapaxes(covariance, -1, -2), atol=1e-7)
