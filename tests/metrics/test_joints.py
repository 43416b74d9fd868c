from dataclasses import replace

import numpy as np
import pytest
from box_figure import box_character, box_motion
from scipy.spatial.transform import Rotation

from jaxmocap._results import InputError
from jaxmocap.metrics import Similarity, accelerations, jitter, joint_errors
from jaxmocap.motion import TAILS

NAMES = ("pelvis", "neck", "l_elbow", "r_knee", "l_hip", "r_hip", "head")


@pytest.fixture(scope="module")
def motion():
    return box_motion(box_character())


def _true(motion, names=NAMES):
    return motion.joints[:, [motion.joint_names.index(name) for name in names]].astype(np.float64)


def test_the_motions_own_joints_have_no_error_whatever_their_order(motion):
    names = NAMES[::-1]
    errors = joint_errors(motion, _true(motion, names), names, joints="all")
    assert set(errors.names) == set(NAMES)
    for distances in (errors.raw, errors.root_aligned, errors.procrustes, errors.offset_corrected, errors.acceleration):
        assert np.allclose(distances, 0, atol=1e-5)


def test_a_shift_is_seen_raw_and_removed_by_root_alignment(motion):
    errors = joint_errors(motion, _true(motion) + [0.3, 0, 0.4], NAMES)
    assert np.allclose(errors.raw, 0.5, atol=1e-5)
    assert np.allclose(errors.root_aligned, 0, atol=1e-5)
    assert errors.correct_keypoints() == 0
    assert joint_errors(motion, _true(motion) + 0.05, NAMES).correct_keypoints() == 1


def test_regions_hold_their_share_of_a_truth_that_scatters_as_the_covariance_says():
    """Also in a world that the result's is turned, scaled and moved to; half the deviation holds less."""
    rng, motion = np.random.default_rng(3), box_motion(box_character(), num_frames=400)
    shape = np.linalg.cholesky(np.array([[4.0, 1.0, 0.0], [1.0, 9.0, -2.0], [0.0, -2.0, 16.0]]) * 1e-4)
    sure = replace(motion, covariance=np.broadcast_to(shape @ shape.T, (*motion.joints.shape, 3)))
    placed = Similarity(1.7, Rotation.random(rng=rng).as_matrix(), np.array([1.0, 2.0, 3.0]))
    tails = np.sqrt(TAILS / rng.chisquare(TAILS, (*_true(motion).shape[:2], 1)))
    true = placed(_true(motion) + tails * rng.standard_normal(_true(motion).shape) @ shape.T)
    errors = joint_errors(sure, true, NAMES, truth_from_world=placed)
    for share in (0.5, 0.9, 0.99):
        assert errors.coverage(share) == pytest.approx(share, abs=0.03)
    narrow = joint_errors(replace(sure, covariance=sure.covariance / 4), true, NAMES, truth_from_world=placed)
    assert narrow.coverage(0.9) < 0.8
    assert np.isnan(joint_errors(motion, true, NAMES).coverage(0.9))


def test_joints_that_are_certain_hold_the_truth_only_where_they_are(motion):
    certain = replace(motion, covariance=np.zeros((*motion.joints.shape, 3), np.float32))
    assert joint_errors(certain, _true(motion), NAMES).coverage(0.9) == 1
    assert joint_errors(certain, _true(motion) + 0.01, NAMES).coverage(0.9) == 0


def test_without_a_pelvis_the_hips_are_the_root(motion):
    names = ("l_hip", "r_hip", "neck")
    errors = joint_errors(motion, _true(motion, names) + 1, names)
    assert np.allclose(errors.root_aligned, 0, atol=1e-5)
    assert joint_errors(motion, _true(motion, ("neck", "head")), ("neck", "head")).root_aligned is None


def test_procrustes_removes_any_similarity_of_each_frame(motion):
    rotations = Rotation.random(6, rng=np.random.default_rng(0)).as_matrix()
    true = np.einsum("tij,tnj->tni", rotations, 1.7 * _true(motion)) + np.arange(6)[:, None, None]
    errors = joint_errors(motion, true, NAMES)
    assert np.allclose(errors.procrustes, 0, atol=1e-5)
    assert errors.raw.mean() > 0.5


def test_procrustes_does_not_remove_a_mirror_image(motion):
    errors = joint_errors(motion, _true(motion) * [-1, 1, 1], NAMES)
    assert errors.procrustes.mean() > 0.02


def test_a_constant_offset_on_the_bone_is_removed_exactly(motion):
    skeleton = motion.character.skeleton
    bodies = [skeleton.landmark_bodies[skeleton.landmark_names.index(name)] for name in NAMES]
    offsets = 0.05 * np.random.default_rng(1).standard_normal((len(NAMES), 3))
    rotations = motion.body_transforms[:, bodies, :3, :3].astype(np.float64)
    errors = joint_errors(motion, _true(motion) + np.einsum("tjik,jk->tji", rotations, offsets), NAMES, joints="all")
    order = [NAMES.index(name) for name in errors.names]
    assert np.allclose(errors.raw, np.linalg.norm(offsets, axis=1)[order], atol=1e-5)
    assert np.allclose(errors.offset_corrected, 0, atol=1e-5)


def test_an_offset_fixed_in_the_world_is_not_a_bones_offset(motion):
    errors = joint_errors(motion, _true(motion) + [0.1, 0, 0], NAMES)
    assert errors.offset_corrected.mean() > 0.01


def test_similar_worlds_give_the_same_errors_in_the_truths_unit(motion):
    placed = Similarity(0.5, Rotation.from_rotvec([1, 2, 3]).as_matrix(), np.array([4.0, 5.0, 6.0]))
    true = _true(motion) + 0.1 * np.random.default_rng(2).standard_normal((6, len(NAMES), 3))
    plain = joint_errors(motion, true, NAMES)
    moved = joint_errors(motion, placed(true), NAMES, truth_from_world=placed)
    for name in ("raw", "root_aligned", "procrustes", "offset_corrected", "acceleration"):
        assert np.allclose(getattr(moved, name), 0.5 * getattr(plain, name), atol=1e-4), name


def test_joints_the_truth_does_not_know_are_left_out(motion):
    true = _true(motion) + [0, 0.1, 0]
    true[2, 1, 0] = np.nan
    errors = joint_errors(motion, true, NAMES)
    assert np.isnan(errors.raw).sum() == 1
    assert np.isnan(errors.raw[2, errors.names.index("neck")])
    assert np.nanmean(errors.raw) == pytest.approx(0.1, abs=1e-5)
    assert np.isfinite(errors.offset_corrected).sum() == errors.raw.size - 1


def test_points_on_the_surface_are_compared_only_when_asked_for(motion):
    names = ("neck", "nose", "l_big_toe")
    assert joint_errors(motion, _true(motion, names), names, joints="all").names == ("neck",)
    assert joint_errors(motion, _true(motion, names), names, joints=("nose", "neck")).names == ("nose", "neck")


def test_a_spine_that_another_rig_puts_elsewhere_is_reported_and_not_scored(motion):
    names = ("pelvis", "spine", "neck", "l_knee", "nose")
    moved = np.array([[0.05, 0, 0], [0, 0.07, 0], [0.01, 0, 0], [0, 0.03, 0], [0, 0, 0.2]])
    errors = joint_errors(motion, _true(motion, names) + moved, names)
    assert errors.by_name() == pytest.approx({"neck": 0.01, "l_knee": 0.03}, abs=1e-6)
    assert errors.raw.mean() == pytest.approx(0.02, abs=1e-6)
    assert errors.left_out == pytest.approx({"pelvis": 0.05, "spine": 0.07, "nose": 0.2}, abs=1e-6)
    everything = joint_errors(motion, _true(motion, names) + moved, names, joints="all")
    assert everything.raw.mean() == pytest.approx(0.04, abs=1e-6)
    assert everything.left_out == pytest.approx({"nose": 0.2}, abs=1e-6)


@pytest.mark.parametrize(
    ("names", "wanted", "sentence"),
    [
        (("tail", "wing"), "comparable", r"joints \(tail, wing\) .* have no name in common"),
        (("neck", "wing"), ("wing",), "skeleton has no joint 'wing'"),
        (("neck", "wing"), ("head",), "truth has no joint 'head'; it has neck, wing"),
        (("pelvis", "head"), "comparable", "have only pelvis, head in common, .* Score them with joints 'all'"),
        (("neck", "head"), "head", "joints to score are 'head'; 'comparable', 'all' or a list of names was expected"),
    ],
)
def test_unknown_names_are_refused(motion, names, wanted, sentence):
    with pytest.raises(InputError, match=sentence):
        joint_errors(motion, np.zeros((6, 2, 3)), names, joints=wanted)


def test_wrong_shapes_are_refused(motion):
    with pytest.raises(InputError, match=r"shape \(5, 7, 3\); \(6, 7, 3\) was expected"):
        joint_errors(motion, _true(motion)[:5], NAMES)


def test_acceleration_of_a_falling_point_at_uneven_times():
    times = np.array([0.0, 0.1, 0.25, 0.3, 0.7])
    positions = (times[:, None, None] ** 2 * [0, -9.81 / 2, 0]) + times[:, None, None] * [3, 0, 1]
    assert np.allclose(accelerations(positions, times), [0, -9.81, 0])


def test_a_single_frame_has_no_jitter(motion):
    assert jitter(motion[:1]) == {"mean": 0, "p95": 0}
    assert jitter(motion, 2.0)["mean"] == pytest.approx(2 * jitter(motion)["mean"])
