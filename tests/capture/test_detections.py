"""Keypoints of a detector at any frames of a capture."""

import json

import numpy as np
import pytest

from jaxmocap._results import InputError
from jaxmocap.capture import Capture, Detections


def people(*shifts):
    points = np.stack([np.arange(25.0), np.arange(25.0), np.full(25, 0.5)], 1)
    moved = [(points + [shift, 0, 0]).ravel().tolist() for shift in shifts]
    return json.dumps({"people": [{"pose_keypoints_2d": person} for person in moved]})


@pytest.fixture
def capture(small):
    return Capture.open(small)


@pytest.fixture
def folder(capture, tmp_path):
    folder = tmp_path / "detections"
    folder.mkdir()
    for frame, shifts in ((0, (0.0,)), (2, (0.0, 7.0))):
        own = int(capture.video_frames[1, frame])
        (folder / f"{capture.camera_names[1]}_{own:05d}_keypoints.json").write_text(people(*shifts))
    return folder


def test_everybody_is_found_where_there_is_a_file(capture, folder):
    detections = Detections.open(capture, folder)
    counts = [[len(detections.people(camera, frame)) for frame in range(3)] for camera in range(2)]
    assert counts == [[0, 0, 0], [1, 0, 2]]
    assert detections.people(1, 2)[1][0, 0] == pytest.approx(7.0)


def test_only_the_frames_asked_for_are_used(capture, folder):
    detections = Detections.open(capture, folder, range(1, 3))
    assert [len(detections.people(1, frame)) for frame in range(3)] == [0, 0, 2]


def test_a_folder_without_files_is_refused_in_a_sentence(capture, folder, tmp_path):
    with pytest.raises(InputError, match=r"^detections .*nowhere: there is no such folder; give one with OpenPose"):
        Detections.open(capture, tmp_path / "nowhere")
    with pytest.raises(InputError, match=r"hold no file of capture '.*' in the frames asked for; files are named .*_0"):
        Detections.open(capture, folder, range(1, 2))
