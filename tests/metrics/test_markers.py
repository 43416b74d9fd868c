import numpy as np
import pytest
from box_figure import box_character, box_motion
from scipy.spatial.transform import Rotation

from jaxmocap._results import InputError
from jaxmocap.metrics import Similarity, marker_error, marker_statistics
from jaxmocap.metrics._surface import triangle_frames

CHARACTER = box_character()
BODIES = ("head", "l_hand", "r_forearm", "r_shank")  # boxes that touch no other
FIRST_FACES = np.array([12 * CHARACTER.skeleton.body_names.index(body) for body in BODIES])
FACES = FIRST_FACES + [0, 3, 7, 10]
BARYCENTRIC = np.array([[0.2, 0.3, 0.5], [0.6, 0.2, 0.2], [0.1, 0.1, 0.8], [1 / 3, 1 / 3, 1 / 3]])


@pytest.fixture(scope="module")
def motion():
    return box_motion(CHARACTER)


def _corners(motion):
    faces = np.asarray(CHARACTER.faces)[FACES]
    return np.stack([motion.vertices(index)[faces] for index in range(len(motion))]).astype(np.float64)


def _markers(motion, stand_off=0.0):
    """Points on the boxes, moved outwards by `stand_off` along the face normals."""
    corners = _corners(motion)
    return np.einsum("tmkd,mk->tmd", corners, BARYCENTRIC) + stand_off * triangle_frames(corners)[..., 2]


def test_markers_on_the_skin_have_no_error(motion):
    errors = marker_error(CHARACTER, motion, _markers(motion))
    assert np.allclose(errors.distances, 0, atol=1e-5)
    assert np.allclose(errors.offset_corrected, 0, atol=1e-5)
    assert np.allclose(errors.realigned, 0, atol=1e-5)


def test_a_stand_off_is_the_error_and_the_corrected_variant_removes_exactly_it(motion):
    errors = marker_error(CHARACTER, motion, _markers(motion, 0.013))
    assert np.allclose(errors.distances, 0.013, atol=1e-5)
    assert np.allclose(errors.offset_corrected, 0, atol=1e-5)


def test_attachment_is_decided_in_the_first_frame_alone(motion):
    markers = _markers(motion)
    shift = np.zeros_like(markers)
    shift[1:, 2] = [0.3, 0.0, 0.4]
    errors = marker_error(CHARACTER, motion, markers + shift)
    assert errors.distances[0].max() < 1e-5
    assert np.allclose(errors.distances[1:, 2], 0.5, atol=1e-5)
    assert np.allclose(errors.per_frame, [0, *[0.125] * 5], atol=1e-5)
    statistics = marker_statistics(errors.distances)
    assert statistics == pytest.approx({"mean": 12.5 * 5 / 6, "min": 0, "max": 12.5, "p95": 50}, abs=1e-3)


def test_unseen_markers_are_left_out_of_their_frame(motion):
    markers = _markers(motion, 0.01)
    markers[3, 1] = np.nan
    markers[0, 0] = np.nan
    errors = marker_error(CHARACTER, motion, markers)
    assert errors.faces[0] == -1
    assert np.isnan(errors.distances[:, 0]).all()
    assert np.isnan(errors.distances[3, 1])
    assert np.allclose(errors.per_frame, 0.01, atol=1e-5)


def test_markers_at_twice_the_rate_are_matched_by_time(motion):
    markers = _markers(motion)
    times = np.arange(11) / 60
    doubled = np.empty((11, *markers.shape[1:]))
    doubled[::2] = markers
    doubled[1::2] = (markers[1:] + markers[:-1]) / 2
    errors = marker_error(CHARACTER, motion, doubled, times)
    assert errors.distances.max() < 1e-5
    late = marker_error(CHARACTER, motion[::2], doubled, times)
    assert late.distances.max() < 1e-5
    between = marker_error(CHARACTER, motion, markers[:, :] * 0 + np.arange(6)[:, None, None], motion.timestamps)
    assert np.isfinite(between.distances).all()


def test_a_known_similarity_between_the_worlds_changes_nothing_but_the_unit(motion):
    placed = Similarity(2.0, Rotation.from_rotvec([1, 2, 3]).as_matrix(), np.array([4.0, 5.0, 6.0]))
    plain = marker_error(CHARACTER, motion, _markers(motion, 0.02))
    moved = marker_error(CHARACTER, motion, placed(_markers(motion, 0.02)), truth_from_world=placed)
    assert np.allclose(moved.distances, 2 * plain.distances, atol=1e-5)
    assert np.array_equal(moved.faces, plain.faces)


def test_a_sequence_moved_as_one_is_found_by_realignment_only(motion):
    errors = marker_error(CHARACTER, motion, _markers(motion) + np.array([0.0, 0.0, 0.02]))
    assert errors.distances.mean() > 0.005
    realigned = marker_error(CHARACTER, motion, np.concatenate([_markers(motion)[:1], _markers(motion)[1:] + 0.1]))
    assert realigned.realigned[1:].mean() < 0.5 * realigned.distances[1:].mean()


@pytest.mark.parametrize(
    ("markers", "sentence"),
    [
        (np.zeros((5, 4, 3)), "5 rows of markers for 6 frames"),
        (np.zeros((6, 4)), r"shape \(6, 4\)"),
        (np.full((6, 4, 3), np.nan), "No marker is seen in frame 0"),
    ],
)
def test_markers_that_cannot_be_used_are_refused(motion, markers, sentence):
    with pytest.raises(InputError, match=sentence):
        marker_error(CHARACTER, motion, markers)
