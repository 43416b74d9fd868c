"""Whether a capture's own keypoints count beside the pixels when nobody says so."""

import pytest
from small_captures import POSES, write_keypoints

from jaxmocap.capture import Capture
from jaxmocap.pipeline._defaults import chosen_detections


@pytest.fixture
def written(small):
    """The capture of 12 frames with keypoints at the selected frames 0 and 6, and at these frames of these cameras."""

    def write(frames, names=tuple(POSES)) -> Capture:
        for name in names:
            for frame in frames:
                write_keypoints(small / "keypoints" / f"{name}_{frame:05d}_keypoints.json", POSES[name])
        return Capture.open(small)

    return write


def chosen(capture, span=None, unasked=True, say=None):
    return chosen_detections(capture, None, None, span, unasked, say)


def test_keypoints_of_selected_frames_alone_do_not_count(written):
    capture = written([])
    assert capture.selected_frames == (0, 6)
    assert chosen(capture) is None
    assert chosen(capture, (0, 1)) is None
    assert chosen(capture, (6, 7)) is None


def test_those_of_most_other_frames_count_and_it_is_said(written):
    said, capture = [], written(range(1, 9))
    found = chosen(capture, say=said.append)
    assert found.folder == capture.keypoints_folder
    assert all(found.has(camera, frame) for camera in range(2) for frame in range(9))
    assert len(said) == 1
    assert "--photometric" in said[0]
    assert chosen(capture, (7, 12)) is None  # two of five frames


def test_every_camera_must_have_them(written):
    assert chosen(written(range(12), list(POSES)[:1])) is None


def test_where_they_may_not_count_unasked_they_do_not(written):
    assert chosen(written(range(12)), unasked=False) is None
