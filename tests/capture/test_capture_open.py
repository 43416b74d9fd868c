import dataclasses
import gc
import json
import threading
import tracemalloc
from pathlib import Path

import cv2
import numpy as np
import pytest
from small_captures import (
    MATRIX,
    PERSON,
    POSES,
    TOML,
    edit_toml,
    look_at_pose,
    make_video,
    number_of,
    write_keypoints,
    write_mask,
    write_model,
)

from jaxmocap._results import InputError
from jaxmocap.camera import project
from jaxmocap.capture import KEYPOINT_NAMES, Capture
from jaxmocap.capture._picture_steps import Undistortion


def _sentence(folder: Path) -> str:
    with pytest.raises(InputError) as caught:
        Capture.open(folder)
    return str(caught.value)


def test_a_capture_opens_from_its_folder_and_from_its_file_with_all_fields(small: Path):
    for path in (small, small / "capture.toml", str(small)):
        capture = Capture.open(path)
        assert (capture.name, capture.fps, capture.num_frames, capture.up) == ("small", 30.0, 12, "y")
        assert capture.camera_names == ("cam0", "cam1")
        assert capture.sizes == ((64, 48), (64, 48))
        assert capture.selected_frames == (0, 6)
        assert capture.metres_per_unit == 1.0
        assert capture.actor is None
        assert capture.findings == ()
        np.testing.assert_allclose(capture.timestamps, np.round(np.arange(12) / 30, 3), atol=1e-6)
        np.testing.assert_array_equal(capture.video_frames, [np.arange(12)] * 2)


def test_frames_stream_in_lockstep_and_equal_random_access(small: Path):
    capture = Capture.open(small)
    streamed = dict(capture.frames(2, 11))
    assert list(streamed) == list(range(2, 11))
    for frame in (10, 2, 7):
        for camera in range(2):
            assert number_of(streamed[frame][camera]) == frame
            np.testing.assert_array_equal(capture.image(camera, frame), streamed[frame][camera])


def test_images_are_cached_and_protected(small: Path):
    capture = Capture.open(small)
    first = capture.image(0, 3)
    assert capture.image(0, 3) is first
    with pytest.raises(ValueError, match="read-only"):
        first[0, 0] = 0
    for frame in range(12):
        capture.image(0, frame)
    assert capture.image(0, 3) is not first


def test_frames_looked_ahead_at_are_the_same_and_not_decoded_again(small: Path, monkeypatch):
    pairs = ((0, 2), (1, 2), (0, 7), (1, 7))
    plain = [Capture.open(small).image(*pair) for pair in pairs]
    capture = Capture.open(small)
    capture.look_ahead((2, 7))
    assert joined("frames ahead")
    monkeypatch.setattr(Capture, "_read", lambda *_: pytest.fail("decoded again"))
    copy = capture.with_selected_frames((2, 7))
    for pair, image in zip(pairs, plain, strict=True):
        np.testing.assert_array_equal(copy.image(*pair), image)


def test_what_cannot_be_looked_ahead_at_is_told_by_whoever_asks(small: Path):
    capture = Capture.open(small)
    (small / "cam1.mp4").write_bytes(b"no video")
    capture.look_ahead((2,))
    assert joined("frames ahead")
    with pytest.raises(InputError, match=r"cam1\.mp4"):
        capture.image(1, 2)


def joined(name: str) -> bool:
    """Whether there is no thread of that name any more."""
    for thread in threading.enumerate():
        if thread.name == name:
            thread.join(10)
    return all(thread.name != name for thread in threading.enumerate())


def test_streaming_a_long_capture_needs_no_more_memory_than_a_short_one(tmp_path: Path):
    def peak(count: int) -> int:
        folder = tmp_path / str(count)
        folder.mkdir()
        for name in ("cam0", "cam1"):
            make_video(folder / f"{name}.mp4", count, size=(160, 120))
        text = TOML.replace("frames = 12\n", "").replace("selected_frames = [0, 6]\n", "")
        for key in ("cameras", "keypoints", "masks"):
            text = text.replace(f'{key} = "{key}"\n', "")
        (folder / "capture.toml").write_text(text)
        capture = Capture.open(folder)
        gc.collect()
        tracemalloc.start()
        seen = [number_of(images[0]) for _, images in capture.frames()]
        used = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert seen == list(range(count))
        return used

    assert peak(100) < peak(20) + 2 * 160 * 120 * 3


def test_stopping_early_closes_the_videos(small: Path):
    stream = Capture.open(small).frames()
    assert next(stream)[0] == 0
    stream.close()
    with pytest.raises(StopIteration):
        next(stream)


@pytest.mark.parametrize(("start", "stop"), [(-1, 3), (0, 13), (5, 4)])
def test_a_range_outside_the_capture_is_an_index_error(small: Path, start: int, stop: int):
    with pytest.raises(IndexError, match="are outside 0:12"):
        next(Capture.open(small).frames(start, stop))


def test_cameras_keypoints_and_masks_agree_with_the_person(small: Path):
    capture = Capture.open(small)
    view = capture.cameras.at(6)
    pixels, _ = project(view.intrinsics, view.cam_from_world, np.float32(PERSON))
    for camera in range(2):
        found = capture.keypoints(camera, 6)
        assert found is not None
        np.testing.assert_allclose(found[:, :2], pixels[camera], atol=1e-3)
        np.testing.assert_allclose(found[:, 2], 0.9)
        mask = capture.mask(camera, 6)
        assert mask is not None
        assert mask.shape == (48, 64)
        assert mask.dtype == bool
        assert mask.sum() == 30 * 15
        assert mask[10, 25]
        assert not mask[9, 25]
        assert capture.keypoints(camera, 5) is None
        assert capture.mask(camera, 5) is None
        assert capture.keypoint_frames(camera) == (0, 6)
    assert KEYPOINT_NAMES[1] == "neck"
    assert KEYPOINT_NAMES[14] == "l_ankle"
    assert len(KEYPOINT_NAMES) == 25


def test_the_most_confident_of_several_people_is_taken_and_nobody_is_none(small: Path):
    timid = np.full((25, 3), 0.3)
    file = small / "keypoints" / "cam0_00000_keypoints.json"
    write_keypoints(file, POSES["cam0"], timid)
    capture = Capture.open(small)
    assert capture.keypoints(0, 0)[0, 2] == 0.9
    file.write_text(json.dumps({"people": []}))
    assert capture.keypoints(0, 0) is None
    file.write_text(json.dumps({"people": [{"pose_keypoints_2d": [0.0] * 75}]}))
    assert capture.keypoints(0, 0) is None


def test_another_keypoint_folder_is_used_by_replacing_the_field(small: Path):
    other = small / "all"
    other.mkdir()
    write_keypoints(other / "cam1_00004_keypoints.json", POSES["cam1"])
    capture = dataclasses.replace(Capture.open(small), keypoints_folder=other)
    assert capture.keypoint_frames(1) == (4,)
    assert capture.keypoints(1, 0) is None


def test_offsets_make_frames_positions_in_the_shared_span_and_files_keep_their_own_numbers(small: Path):
    make_video(small / "cam1.mp4", 10, first=2)  # its first picture is taken when cam0 takes its third
    edit_toml(small, 'video = "cam1.mp4"', 'video = "cam1.mp4"\noffset = 0.067')
    edit_toml(small, "frames = 12", "frames = 10")
    edit_toml(small, "selected_frames = [0, 6]", "selected_frames = [2, 8]")
    write_keypoints(small / "keypoints" / "cam0_00002_keypoints.json", POSES["cam0"])
    poses = dict(POSES, cam1=look_at_pose(20.0))
    write_model(small / "cameras", poses, 12)
    capture = Capture.open(small)
    assert capture.num_frames == 10
    assert capture.selected_frames == (0, 6)
    np.testing.assert_array_equal(capture.video_frames, [np.arange(2, 12), np.arange(10)])
    np.testing.assert_allclose(capture.timestamps, np.round(np.arange(2, 12) / 30, 3), atol=1e-6)
    for frame, images in capture.frames(3, 6):
        assert [number_of(image) for image in images] == [frame + 2, frame + 2]
    assert capture.keypoints(0, 0) is not None
    assert capture.keypoint_frames(0) == (0, 4)
    assert capture.keypoint_frames(1) == (0, 6)


def _distorted(small: Path, distortion: list[float]) -> None:
    sections = []
    for name, pose in POSES.items():
        rotation = cv2.Rodrigues(pose[:3, :3])[0].ravel().tolist()
        sections.append(
            f"[{name}]\nsize = [64, 48]\nmatrix = [[60.0, 0, 31.5], [0, 60.0, 23.5], [0, 0, 1]]\n"
            f"distortions = {distortion}\nrotation = {rotation}\ntranslation = {pose[:3, 3].tolist()}\n"
        )
    (small / "calibration.toml").write_text("\n".join(sections))
    edit_toml(small, 'cameras = "cameras"', 'cameras = "calibration.toml"')


def _distort(pixels: np.ndarray, distortion: list[float]) -> np.ndarray:
    """The five-coefficient model written out, for pixels whose first centre is (0.5, 0.5)."""
    k1, k2, p1, p2, k3 = distortion
    x, y = (pixels[:, 0] - 32) / 60, (pixels[:, 1] - 24) / 60
    r = x * x + y * y
    radial = 1 + k1 * r + k2 * r**2 + k3 * r**3
    u = x * radial + 2 * p1 * x * y + p2 * (r + 2 * x * x)
    v = y * radial + p1 * (r + 2 * y * y) + 2 * p2 * x * y
    return np.stack([60 * u + 32, 60 * v + 24], axis=-1)


def test_keypoints_images_and_masks_are_undistorted_alike(small: Path):
    distortion = [-0.3, 0.1, 0.01, -0.02, 0.02]
    _distorted(small, distortion)
    capture = Capture.open(small)
    np.testing.assert_allclose(capture.cameras.intrinsics[0], MATRIX, atol=1e-4)
    ideal = np.random.default_rng(0).uniform([8, 6], [56, 42], (25, 2))
    recorded = _distort(ideal, distortion)
    points = np.concatenate([recorded, np.ones((25, 1))], axis=1)
    points[3] = 0  # not found: stays as it is
    file = small / "keypoints" / "cam0_00000_keypoints.json"
    file.write_text(json.dumps({"people": [{"pose_keypoints_2d": points.ravel().tolist()}]}))
    found = capture.keypoints(0, 0)
    seen = np.arange(25) != 3
    np.testing.assert_allclose(found[seen, :2], ideal[seen], atol=1e-4)
    np.testing.assert_array_equal(found[3], 0)

    # a mask of what the lens makes of a rectangle comes back as the rectangle
    width, height = 64, 48
    fine = np.stack(np.meshgrid(np.arange(0.05, width, 0.1), np.arange(0.05, height, 0.1)), axis=-1).reshape(-1, 2)
    inside = fine[(abs(fine[:, 0] - 30) < 10) & (abs(fine[:, 1] - 20) < 12)]
    mask = np.zeros((height, width), np.uint8)
    x, y = np.floor(_distort(inside, distortion)).astype(int).T
    mask[y, x] = 255
    cv2.imwrite(str(small / "masks" / "cam0_00000.png"), mask)
    truth = np.zeros((height, width), bool)
    truth[8:32, 20:40] = True
    assert (capture.mask(0, 0) != truth).sum() <= 2 * (24 + 20)  # at most the outline

    raw = dataclasses.replace(capture, cameras_path=None).image(0, 4).astype(float)
    image = capture.image(0, 4)
    for x, y in [(12, 30), (40, 25), (52, 40)]:
        u, v = _distort(np.array([[x + 0.5, y + 0.5]]), distortion)[0] - 0.5
        j, i = int(u), int(v)
        a, b = u - j, v - i
        expected = (1 - b) * ((1 - a) * raw[i, j] + a * raw[i, j + 1]) + b * (
            (1 - a) * raw[i + 1, j] + a * raw[i + 1, j + 1]
        )
        np.testing.assert_allclose(image[y, x], expected, atol=3)
    assert (next(capture.frames(4))[1][0] == image).all()


def test_units_scale_the_cameras(small: Path):
    scaled = {name: pose.copy() for name, pose in POSES.items()}
    for pose in scaled.values():
        pose[:3, 3] *= 1000
    write_model(small / "cameras", scaled, 12)
    edit_toml(small, 'units = "metres"', 'units = "millimetres"')
    capture = Capture.open(small)
    np.testing.assert_allclose(capture.cameras.cam_from_world[0, 0], POSES["cam0"], atol=1e-4)


def test_without_cameras_it_opens_and_says_what_to_do_when_they_are_asked_for(small: Path):
    edit_toml(small, 'cameras = "cameras"\n', "")
    capture = Capture.open(small)
    assert number_of(capture.image(1, 5)) == 5
    with pytest.raises(InputError, match=r"small has no cameras: calibrate it first"):
        _ = capture.cameras


def test_a_broken_frames_line_is_ignored_with_a_warning_that_says_so(small: Path):
    edit_toml(small, "frames = 12", "frames = RightToeBase")
    capture = Capture.open(small)
    assert capture.num_frames == 12
    (finding,) = capture.findings
    assert finding.severity == "warning"
    assert finding.where == "capture.toml line 3"
    assert "frames = RightToeBase" in finding.message
    assert "videos" in finding.message


def test_fewer_frames_than_the_videos_are_used_with_a_warning(small: Path):
    edit_toml(small, "frames = 12", "frames = 9")
    capture = Capture.open(small)
    assert capture.num_frames == 9
    assert "cam0.mp4 has 12" in capture.findings[0].message


def test_repeated_selected_frames_are_used_once_with_a_warning(small: Path):
    edit_toml(small, "[0, 6]", "[6, 0, 6]")
    capture = Capture.open(small)
    assert capture.selected_frames == (0, 6)
    assert "[6] more than once" in capture.findings[0].message


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("fps = 30", "fpps = 30", ["capture.toml", "'fpps'", "did you mean 'fps'"]),
        ("fps = 30", "colour = 30", ["'colour'", "expected one of name, fps"]),
        ('name = "cam1"\n', 'name = "cam1"\nvidoe = "x"\n', ["'camera.1.vidoe'", "did you mean 'video'"]),
        ('video = "cam1.mp4"\n', "", ["'camera.1.video' is missing"]),
        ('units = "metres"', 'units = "feet"', ["units = 'feet'", "'metres'"]),
        ('up = "y"', 'up = "w"', ["up = 'w'", "'x', 'y' or 'z'"]),
        ("fps = 30", "fps = -1", ["fps = -1", "greater than 0"]),
        ("fps = 30", "fps = nan", ["fps = nan"]),
        ("frames = 12", "frames = 'many'", ["frames = 'many'", "integer"]),
        ("frames = 12", "frames = 13", ["frames = 13", "share only 12", "cam0.mp4 has 12"]),
        ("fps = 30", "fps = = 30", ["capture.toml line 2", "fps = = 30"]),
        ("[0, 6]", "[0, 12]", ["[12] are outside", "0 to 11"]),
        ("[0, 6]", "[-1, 6]", ["[-1] are outside"]),
        ("[0, 6]", "[]", ["selected_frames is empty"]),
        ('name = "cam1"', 'name = "cam0"', ["two cameras have the name 'cam0'"]),
        ('video = "cam1.mp4"', 'video = "cam0.mp4"', ["two cameras have the video 'cam0.mp4'"]),
        ('video = "cam1.mp4"', 'video = "../cam1.mp4"', ["'../cam1.mp4'", "outside the capture folder"]),
        ('video = "cam1.mp4"', 'video = "a/../../cam1.mp4"', ["outside the capture folder"]),
        ('video = "cam1.mp4"', 'video = "/etc/passwd"', ["'/etc/passwd'", "outside the capture folder"]),
        ('video = "cam1.mp4"', "video = 'C:\\\\cam1.mp4'", ["outside the capture folder"]),
        ('name = "cam1"', 'name = "../cam1"', ["camera.1.name = '../cam1'", "not a usable camera name"]),
        ('video = "cam1.mp4"', 'video = "cam7.mp4"', ["cam7.mp4 does not exist"]),
        ('up = "y"', 'up = "y"\nactor = "body.glb"', ["actor = 'body.glb'", "does not exist"]),
        ('masks = "masks"', 'masks = "mask"', ["masks = 'mask'", "folder that does not exist"]),
        ('keypoints = "keypoints"', 'keypoints = "cam0.mp4"', ["keypoints = 'cam0.mp4'", "folder"]),
        ('cameras = "cameras"', 'cameras = "model"', ["cameras = 'model'", "does not exist"]),
        ('cameras = "cameras"', 'cameras = "masks"', ["masks/ holds no COLMAP model", "cam0_00000.png"]),
        ('name = "cam1"', 'name = "cam9"', ["cameras/images.txt has no images of cam9", "cam0, cam1"]),
    ],
)
def test_each_mistake_in_the_configuration_is_one_sentence_with_its_name(
    small: Path, old: str, new: str, words: list[str]
):
    edit_toml(small, old, new)
    sentence = _sentence(small)
    for word in words:
        assert word in sentence
    assert "\n" not in sentence


def test_a_folder_without_a_configuration_is_refused(tmp_path: Path):
    assert str(tmp_path / "capture.toml") in _sentence(tmp_path)


def test_a_video_and_a_result_are_no_captures(small: Path, tmp_path: Path):
    assert "cam0.mp4 is no capture: a folder with a capture.toml" in _sentence(small / "cam0.mp4")
    (tmp_path / "result").mkdir()
    (tmp_path / "result" / "motion.npz").write_bytes(b"")
    assert "holds a result; the capture that it was made of" in _sentence(tmp_path / "result")


def test_a_capture_without_cameras_in_it_is_refused(small: Path):
    (small / "capture.toml").write_text('name = "x"\n')
    assert "'camera' is missing; expected one [[camera]] section per video" in _sentence(small)


def test_poses_missing_in_the_model_are_listed(small: Path):
    write_model(small / "cameras", POSES, 9)
    assert "cameras/images.txt has no pose for cam0 frames 9-11, nor for cam1 frames 9-11" in _sentence(small)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("{", ["cam0_00000_keypoints.json", "not JSON"]),
        ('{"persons": []}', ["cam0_00000_keypoints.json", "not an OpenPose file"]),
        ('{"people": [{"pose_keypoints_2d": ' + str([1.0] * 54) + "}]}", ["54 numbers", "COCO (18 points)", "75"]),
        ('{"people": [{"pose_keypoints_2d": ' + str([1.0] * 74) + "}]}", ["74 numbers", "BODY_25"]),
        ('{"people": [{"pose_keypoints_2d": ' + str([1.0] * 74 + ["x"]) + "}]}".replace("'", '"'), ["cam0_00000"]),
        ('{"people": [{"pose_keypoints_2d": [NaN' + ", 1.0" * 74 + "]}]}", ["cam0_00000", "not finite"]),
    ],
)
def test_keypoint_files_that_cannot_be_read_are_refused_by_name(small: Path, content: str, words: list[str]):
    (small / "keypoints" / "cam0_00000_keypoints.json").write_text(content)
    with pytest.raises(InputError) as caught:
        Capture.open(small).keypoints(0, 0)
    for word in words:
        assert word in str(caught.value)


def test_masks_of_another_size_or_kind_are_refused_by_name(small: Path):
    capture = Capture.open(small)
    write_mask(small / "masks" / "cam1_00006.png", size=(32, 48))
    with pytest.raises(InputError, match=r"cam1_00006\.png has 32x48 pixels, but its video has 64x48"):
        capture.mask(1, 6)
    (small / "masks" / "cam1_00006.png").write_bytes(b"no image")
    with pytest.raises(InputError, match=r"cam1_00006\.png cannot be read as an image"):
        capture.mask(1, 6)


@pytest.mark.parametrize("value", [255, 1])
def test_masks_may_be_black_and_white_or_zero_and_one(small: Path, value: int):
    write_mask(small / "masks" / "cam0_00000.png", value=value)
    assert Capture.open(small).mask(0, 0).sum() == 30 * 15


def test_the_real_captures_open(data: Path):
    plaza = Capture.open(data / "plaza")
    assert (plaza.num_frames, plaza.num_cameras, plaza.selected_frames) == (100, 2, (0, 50))
    assert plaza.findings == ()
    assert plaza.actor == data / "plaza" / "actor.glb"
    street = Capture.open(data / "street")
    assert (street.num_frames, street.num_cameras) == (35, 3)
    assert street.cameras.cam_from_world.shape == (3, 35, 4, 4)
    if "RightToeBase" in (data / "street" / "capture.toml").read_text():
        assert [finding.where for finding in street.findings] == ["capture.toml line 3"]
    balance = Capture.open(data / "balance")
    assert (balance.num_frames, balance.up, balance.fps) == (100, "z", 60.0)
    np.testing.assert_allclose(balance.cameras.intrinsics[0, :2, 2], [281.9921581881694, 478.2048834630837], atol=1e-3)
    assert np.asarray(balance.cameras.distortion).all(axis=0).tolist() == [True, True, True, True, False]
    assert balance.image(0, 99).shape == (960, 540, 3)
    raw = Capture.open(data / "plaza_raw")
    assert raw.cameras_path is None
    assert [index.num_frames for index in raw.indices] == [100, 96]


def test_a_mask_found_in_the_undistorted_image_goes_back_to_where_the_video_has_it():
    matrix = np.array([[300.0, 0, 160], [0, 300.0, 120], [0, 0, 1]])
    lens = Undistortion(matrix, np.array([-0.25, 0.08, 0.001, -0.002, 0.0]), (320, 240))
    recorded = np.zeros((240, 320), bool)
    recorded[30:200, 40:150] = True
    back = lens.recorded_mask(lens.mask(recorded))
    assert not np.array_equal(lens.mask(recorded), recorded)
    assert (back != recorded).sum() < 0.01 * recorded.sum()
