"""Keypoints that are given to `run`: how they are found, named and refused."""

import json
import shutil

import pytest
from stand_ins import VIDEO, again, make_folder

from jaxmocap._cli import run as command
from jaxmocap._results import InputError
from jaxmocap.capture import Capture
from jaxmocap.pipeline import run

PERSON = [20.0, 20.0, 0.9] * 25
PICTURE = json.dumps({"people": [{"pose_keypoints_2d": PERSON}]})


def test_keypoints_that_were_given_once_are_left_again(clips, done, tmp_path):
    out, given = tmp_path / "dance", tmp_path / "given"
    given.mkdir()
    (given / "left.json").write_text(VIDEO)
    (given / "right_hand.json").write_text(VIDEO)
    again(clips, out)
    again(clips, out, keypoints=given)
    assert Capture.open(out / "capture").keypoints_folder == out / "capture" / "keypoints-2"
    assert again(clips, out)[1][0] == "detect"
    assert Capture.open(out / "capture").keypoints_folder == out / "capture" / "keypoints"


def test_keypoints_that_are_named_like_the_video_are_named_like_its_camera(clips, done, tmp_path):
    given = tmp_path / "given"
    (given / "right hand_json").mkdir(parents=True)
    (given / "right hand_json" / "right hand_00003.json").write_text(PICTURE)
    again(clips[1:], tmp_path / "alone", keypoints=given)
    with pytest.raises(InputError, match=r"--keypoints .*given has no file for camera 'left', .* left\.json"):
        again(clips, tmp_path / "dance", keypoints=given)
    assert not (tmp_path / "dance").exists()
    (given / "left_000000000003_keypoints.json").write_text(PICTURE)
    again(clips, tmp_path / "dance", keypoints=given)
    opened = Capture.open(tmp_path / "dance" / "capture")
    assert [opened.keypoint_frames(camera) for camera in range(2)] == [(3,), (3,)]
    same = [shutil.copy(video, make_folder(tmp_path / name) / "x.mp4") for name, video in zip("ab", clips, strict=True)]
    (given / "x.json").write_text(VIDEO)
    with pytest.raises(InputError, match=r"no file for camera 'cam0', .*a/x\.mp4; cam0_00000_keypoints\.json"):
        again(same, tmp_path / "other", keypoints=given)


@pytest.mark.parametrize("name", ["predictions/right hand.json", "results_right hand.json", "right hand.json"])
def test_a_file_of_a_whole_video_that_is_named_like_it_is_found_in_the_capture(name, clips, done, tmp_path):
    file = tmp_path / "given" / name
    file.parent.mkdir(parents=True)
    file.write_text(VIDEO)
    again(clips[1:], tmp_path / "alone", keypoints=tmp_path / "given")
    assert Capture.open(tmp_path / "alone" / "capture").keypoint_frames(0) == (1,)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("no JSON", r"keypoints .*left\.json is not JSON"),
        (VIDEO.replace("0.9, ", "", 1), r"keypoints .*left\.json is not an OpenPose file"),
        (
            json.dumps([{"frame_id": 1, "instances": [{"keypoints": [[2, 2]] * 18, "keypoint_scores": [0.9] * 18}]}]),
            r"keypoints .*left\.json: a person has 18 points, which looks like COCO \(18 points\); expected",
        ),
        (
            json.dumps([{"frame_id": 1, "instances": []}]),
            r"--keypoints \S+ show nobody in the 12 pictures of camera 'left'",
        ),
        (VIDEO.replace('"frame_id": 1', '"frame_id": 100').replace("[{", '[{"frame_id": 0, "instances": []}, {', 1),
         r"--keypoints \S+ show nobody in the 12 pictures of camera 'left'"),
        (VIDEO.replace("[20, 20]", "[200, 20]"), r"camera 'left' lie as far as 200, 20, outside the 64 x 48 pixels"),
    ],
)  # fmt: skip
def test_keypoints_that_are_none_are_refused_before_anything_is_done(content, words, clips, done, tmp_path, capsys):
    given, out = make_folder(tmp_path / "given"), tmp_path / "dance"
    (given / "right_hand.json").write_text(VIDEO)
    (given / "left.json").write_text(content)
    with pytest.raises(InputError, match=words):
        run(clips, out, height=1.8, keypoints=given)
    assert command(["run", *map(str, clips), "--height", "1.8", "--out", str(out), "--keypoints", str(given)]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert (done, out.exists()) == ([], False)


def test_the_layout_that_the_capture_names_holds_for_keypoints_that_are_given_to_it(clips, done, tmp_path):
    given, out = make_folder(tmp_path / "given"), tmp_path / "dance"
    points = {"keypoints": [[20, 20]] * 30, "keypoint_scores": [0.9] * 30}  # COCO's, and others of a program's own
    for name in ("left", "right_hand"):
        (given / f"{name}.json").write_text(json.dumps([{"frame_id": 1, "instances": [points]}]))
    again(clips, out)
    with pytest.raises(InputError, match="a person has 30 points"):
        again(clips, out, keypoints=given)
    file = out / "capture" / "capture.toml"
    file.write_text('keypoint_layout = "coco17"\n' + file.read_text())
    assert "detect" in again(clips, out, keypoints=given)[1]
