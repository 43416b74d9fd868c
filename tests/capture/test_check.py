import json
from pathlib import Path

import numpy as np
import pytest
from small_captures import (
    PERSON,
    POSES,
    edit_toml,
    look_at_pose,
    make_video,
    number_of,
    write_keypoints,
    write_mask,
    write_model,
)

from jaxmocap._results import InputError
from jaxmocap.capture import KEYPOINT_NAMES, Capture, Finding, FrameReader, check, check_subject, index_video


def _of(findings: list[Finding], severity: str) -> list[str]:
    return [finding.message for finding in findings if finding.severity == severity]


def _said(findings: list[Finding], severity: str, *words: str) -> bool:
    return any(all(word in message for word in words) for message in _of(findings, severity))


def test_a_faultless_capture_has_only_notes_and_they_are_true(small: Path):
    findings = check(small)
    assert _of(findings, "error") == []
    assert _of(findings, "warning") == []
    assert _said(findings, "note", "cam0 is static")
    assert _said(findings, "note", "person about 1.7")
    assert _said(findings, "note", "directions 24 degrees apart")


def test_frames_that_would_be_selected_are_named(small: Path):
    """Of two frames with the same pose one is enough."""
    assert not _said(check(small), "note", "would be chosen")
    edit_toml(small, "selected_frames = [0, 6]\n", "")
    assert _said(check(small), "note", "none are given; 0 would be chosen", "among 2 frames with good keypoints")


def test_everything_wrong_is_named_in_one_pass_and_errors_come_first(small: Path):
    edit_toml(small, "frames = 12", "frames = 99")
    edit_toml(small, "[0, 6]", "[0, 40]")
    edit_toml(small, 'up = "y"', 'up = "y"\nactor = "body.glb"')
    write_mask(small / "masks" / "cam1_00006.png", size=(32, 48))
    write_mask(small / "masks" / "cam0_00006.png", value=0)
    (small / "keypoints" / "cam1_00006_keypoints.json").write_text('{"people": [{"pose_keypoints_2d": [1, 2, 3]}]}')
    write_model(small / "cameras", POSES, 12, size=(640, 480))
    findings = check(small)
    assert [f.severity for f in findings] == sorted(
        (f.severity for f in findings), key=["error", "warning", "note"].index
    )
    for words in (
        ("frames = 99", "share only 12"),
        ("[40] are outside",),
        ("actor = 'body.glb'",),
        ("cam1_00006.png has 32x48",),
        ("cam0_00006.png is empty",),
        ("cam1_00006_keypoints.json", "3 numbers"),
        ("cameras.txt camera cam0", "640x480", "64x48"),
        ("cameras.txt camera cam1", "640x480", "64x48"),
    ):
        assert _said(findings, "error", *words), words


def test_the_first_error_is_the_sentence_that_opening_raises(small: Path):
    write_model(small / "cameras", POSES, 12, size=(640, 480))
    with pytest.raises(InputError) as caught:
        Capture.open(small)
    assert str(caught.value) in _of(check(small), "error")


def test_a_missing_video_does_not_hide_what_is_wrong_with_the_others(small: Path):
    (small / "cam0.mp4").unlink()
    make_video(small / "cam1.mp4", black=range(12))
    findings = check(small)
    assert _said(findings, "error", "cam0.mp4 does not exist")
    assert _said(findings, "error", "cam1.mp4 is black in all 12 decoded frames")


def test_no_video_at_all_still_reports_every_one(small: Path):
    for name in POSES:
        (small / f"{name}.mp4").write_bytes(b"nothing")
    assert len(_of(check(small), "error")) == 2


def test_a_missing_configuration_is_a_finding(tmp_path: Path):
    (finding,) = check(tmp_path)
    assert finding.severity == "error"
    assert "capture.toml does not exist" in finding.message


def test_all_mistakes_of_the_configuration_are_listed(small: Path):
    edit_toml(small, "fps = 30", "fpps = 30")
    edit_toml(small, 'up = "y"', 'up = "w"')
    findings = check(small)
    assert _said(findings, "error", "'fpps'")
    assert _said(findings, "error", "up = 'w'")


def test_black_frames_are_named(small: Path):
    make_video(small / "cam0.mp4", black=(3, 4, 9))
    (finding,) = [f for f in check(small) if "black" in f.message]
    assert (finding.severity, finding.where) == ("warning", "cam0 frames 3-4, 9")


def test_a_cut_off_video_names_itself(small: Path):
    edit_toml(small, "frames = 12\n", "")
    make_video(small / "cam0.mp4", 60)
    data = (small / "cam0.mp4").read_bytes()
    (small / "cam0.mp4").write_bytes(data[: len(data) // 2])
    assert _said(check(small), "error", "cam0.mp4", "cannot be opened")


def test_an_mp4_whose_index_promises_more_frames_than_it_holds_is_cut_off(small: Path):
    import av

    moved = small / "moved.mp4"
    make_video(small / "long.mp4", 60)
    with (
        av.open(str(small / "long.mp4")) as source,
        av.open(str(moved), "w", options={"movflags": "faststart"}) as target,
    ):
        stream = target.add_stream_from_template(source.streams.video[0])
        for packet in source.demux(video=0):
            if packet.dts is not None:
                packet.stream = stream
                target.mux(packet)
    with av.open(str(moved)) as whole:
        places = sorted(packet.pos for packet in whole.demux(video=0) if packet.size)
    (small / "cam0.mp4").write_bytes(moved.read_bytes()[: places[18]])  # before the 19th of 60 pictures
    assert _said(check(small), "error", "cam0.mp4 is cut off", "42 of its frames")
    with pytest.raises(InputError, match=r"cam0\.mp4 is cut off"):
        Capture.open(small)


def test_a_video_that_begins_inside_its_file_is_whole(small: Path):
    """An edit list that begins behind a key frame leaves pictures before it out, but they are in the file."""
    edit_toml(small, "frames = 12\n", "")
    content = bytearray(make_video(small / "cam0.mp4", 60).read_bytes())
    at = content.find(b"elst") + 16  # its one entry: duration, then where it begins
    unit = index_video(small / "cam0.mp4").pts[1]
    content[at : at + 4] = int(45 * unit).to_bytes(4, "big")
    (small / "cam0.mp4").write_bytes(content)
    index = index_video(small / "cam0.mp4")
    assert 10 < index.num_frames < 20
    assert number_of(FrameReader(index).read(0)) == 60 - index.num_frames
    assert not _said(check(small), "error", "cut off")


def test_timestamps_that_contradict_fps_are_named_and_a_variable_rate_is_noted(small: Path):
    make_video(small / "cam0.mp4", milliseconds=[0, 40, 80, 120, 160, 200, 260, 300, 340, 380, 420, 460])
    edit_toml(small, "frames = 12\n", "")
    findings = check(small)
    assert _said(findings, "warning", "fps = 30", "cam0.mp4", "23.91")
    assert _said(findings, "note", "cam0.mp4 has a variable frame rate, 40.0 to 60.0 ms")


def test_videos_of_different_length_are_named_unless_synchronised(small: Path):
    make_video(small / "cam1.mp4", 8)
    edit_toml(small, "frames = 12", "frames = 8")
    assert _said(check(small), "warning", "cam0.mp4 12", "cam1.mp4 8", "jaxmocap sync")
    edit_toml(small, 'video = "cam1.mp4"', 'video = "cam1.mp4"\noffset = 0.1')
    edit_toml(small, "[0, 6]", "[3, 6]")
    assert not _said(check(small), "warning", "jaxmocap sync")


def test_keypoints_missing_at_a_selected_frame_several_people_and_stray_files_are_named(small: Path):
    folder = small / "keypoints"
    (folder / "cam1_00006_keypoints.json").unlink()
    write_keypoints(folder / "cam0_00000_keypoints.json", POSES["cam0"], np.full((25, 3), 0.2))
    (folder / "cam0_000000000006_keypoints.json").write_text('{"people": []}')
    (folder / "cam1_00003_keypoints.json").write_text(json.dumps({"people": []}))
    findings = check(small)
    assert _said(findings, "warning", "missing at the selected frame 6 of cam1", "cam1_00006_keypoints.json")
    assert _said(findings, "warning", "cam0_00000_keypoints.json show 2 people")
    assert _said(findings, "warning", "cam0_000000000006_keypoints.json is ignored", "cam0_00000_keypoints.json")
    assert _said(findings, "warning", "cam1_00003_keypoints.json show nobody")


def test_an_inverted_and_a_missing_mask_are_named(small: Path):
    import cv2

    cv2.imwrite(str(small / "masks" / "cam0_00000.png"), np.full((48, 64), 255, np.uint8))
    (small / "masks" / "cam1_00006.png").unlink()
    findings = check(small)
    assert _said(findings, "warning", "cam0_00000.png covers 100%", "inverted")
    assert _said(findings, "warning", "missing at the selected frame 6 of cam1", "cam1_00006.png")


def _retake(small: Path, poses: dict[str, np.ndarray], points: np.ndarray = PERSON) -> None:
    """The model and keypoints of the same person from other cameras."""
    write_model(small / "cameras", poses, 12)
    for frame in (0, 6):
        for name, pose in poses.items():
            write_keypoints(small / "keypoints" / f"{name}_{frame:05d}_keypoints.json", pose, points=points)


def test_a_narrow_view_angle_is_a_warning_with_its_price(small: Path):
    _retake(small, {"cam0": look_at_pose(-2.5), "cam1": look_at_pose(2.5)})
    assert _said(check(small), "warning", "directions 5.0 degrees apart", "23 times as much")


def test_a_keypoint_on_which_the_cameras_disagree_is_named_with_its_frame(small: Path):
    wrong = PERSON.copy()
    wrong[4] += [0.0, 5.0, 0.0]
    write_keypoints(small / "keypoints" / "cam1_00006_keypoints.json", POSES["cam1"], points=wrong)
    (finding,) = [f for f in check(small) if "do not agree" in f.message]
    assert (finding.severity, finding.where) == ("warning", "frame 6")
    assert "r_wrist" in finding.message
    assert "l_wrist" not in finding.message


@pytest.mark.parametrize(
    ("scale", "severity", "words"),
    [
        (2.0, "warning", ("3.4", "scale")),
        (0.01, "error", ("another unit",)),
        (100.0, "error", ('units = "centimetres"',)),
    ],
)
def test_a_person_of_the_wrong_size_is_named_with_the_likely_unit(
    small: Path, scale: float, severity: str, words: tuple[str, ...]
):
    poses = {name: pose.copy() for name, pose in POSES.items()}
    for pose in poses.values():
        pose[:3, 3] *= scale
    write_model(small / "cameras", poses, 12)
    assert _said(check(small), severity, *words)


def test_cameras_that_look_away_from_the_person_are_called_mirrored(small: Path):
    away = {name: np.diag([-1.0, 1.0, -1.0, 1.0]) @ pose for name, pose in POSES.items()}
    write_model(small / "cameras", away, 12)
    for frame in (0, 6):
        for name in POSES:
            write_keypoints(small / "keypoints" / f"{name}_{frame:05d}_keypoints.json", away[name])
    assert _said(check(small), "error", "frame 0 lie behind cam0, cam1")


def test_a_world_with_one_axis_reversed_is_called_mirrored(small: Path):
    for axis in range(3):
        reverse = np.diag([-1.0 if i == axis else 1.0 for i in (0, 1, 2, 3)])
        image = np.diag([-1.0, 1.0, 1.0, 1.0])  # keeps every rotation a rotation
        write_model(small / "cameras", {name: image @ pose @ reverse for name, pose in POSES.items()}, 12)
        assert _said(check(small), "error", "point backwards", "mirrored")


def test_left_and_right_exchanged_in_all_keypoints_is_named(small: Path):
    other = {"l": "r", "r": "l"}
    exchanged = [KEYPOINT_NAMES.index(other.get(n[0], n[0]) + n[1:] if n[1] == "_" else n) for n in KEYPOINT_NAMES]
    _retake(small, POSES, PERSON[exchanged])
    assert _said(check(small), "error", "left and right are exchanged")


def test_only_the_frames_asked_for_tell_whether_the_person_is_right(small: Path):
    other = {"l": "r", "r": "l"}
    exchanged = [KEYPOINT_NAMES.index(other.get(n[0], n[0]) + n[1:] if n[1] == "_" else n) for n in KEYPOINT_NAMES]
    for name, pose in POSES.items():
        write_keypoints(small / "keypoints" / f"{name}_00006_keypoints.json", pose, points=PERSON[exchanged])
    capture = Capture.open(small)
    assert _of(check_subject(capture, capture.cameras, (0,)), "error") == []
    assert _said(check_subject(capture, capture.cameras, (6,)), "error", "left and right are exchanged")


def test_a_camera_that_jumps_for_one_frame_is_named(small: Path):
    write_model(small / "cameras", POSES, 12)
    file = small / "cameras" / "images.txt"
    lines = file.read_text().splitlines()
    words = lines[2 * 5].split()
    assert words[9] == "cam0/00005.png"
    lines[2 * 5] = " ".join([*words[:5], "1.5", *words[6:]])
    file.write_text("\n".join(lines) + "\n")
    (finding,) = [f for f in check(small) if "jumps" in f.message]
    assert finding.where == "cam0 frame 5-6"
    assert "calibrate again" in finding.message
    assert not [f for f in check(small, (6, 12)) if "jumps" in f.message]
    assert _said(check(small, (6, 99)), "error", "frames 6:99 were asked for, and the capture has 12")
    fits = {"frame": list(range(12)), "residual": [0.03] * 12, "rotation_deviation": [0.05] * 12}
    table = {name: fits | {"how": ["registered"] * 12} for name in ("cam0", "cam1")}
    (small / "cameras" / "uncertainty.json").write_text(json.dumps(table))
    assert _said(check(small), "warning", "jumps by up to 1.50 m")  # as nobody moves, whatever the background says
    lines[2 * 5] = " ".join([*words[:5], repr(float(words[5]) + 0.12), *words[6:]])
    file.write_text("\n".join(lines) + "\n")
    assert not [f for f in check(small) if "jumps" in f.message]
    assert _said(check(small), "note", "the background fits its poses there, so it was quick")


def test_a_capture_without_cameras_and_keypoints_says_what_is_next(small: Path):
    edit_toml(small, 'cameras = "cameras"\n', "")
    edit_toml(small, 'keypoints = "keypoints"\n', "")
    findings = check(small)
    assert _of(findings, "error") == []
    assert _said(findings, "warning", "run jaxmocap calibrate")
    assert _said(findings, "note", "there are no keypoints")


def test_the_real_captures_have_no_errors(data: Path):
    street = check(data / "street")
    assert _of(street, "error") == []
    if "RightToeBase" in (data / "street" / "capture.toml").read_text():
        assert _said(street, "warning", "frames = RightToeBase")
    assert _said(street, "note", "directions 31 degrees")
    balance = check(data / "balance")
    assert _of(balance, "error") == []
    assert _said(balance, "note", "cam01 is static")
