"""A walk around something that stands still: its frames, its cameras, its scale, and what is refused."""

import tomllib
from dataclasses import replace
from pathlib import Path

import cv2
import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_captures import look_at_pose

from jaxmocap._results import InputError
from jaxmocap.calibration import PARTS_OF_HEIGHT
from jaxmocap.camera import Cameras, look_at_point
from jaxmocap.capture import KEYPOINT_NAMES
from jaxmocap.pipeline import FoundKeypoints, _scan_frames, _scan_masks, _scan_views, scan
from jaxmocap.pipeline._scan_frames import frames_of_walk
from jaxmocap.pipeline._scan_masks import person_scale
from jaxmocap.pipeline._scan_views import widest_gap
from jaxmocap.viewers import open_video

SIZE, FOCAL, AWAY = (320, 240), 300.0, 3.0


def around(angles: np.ndarray, height: float = 1.2) -> np.ndarray:
    """cam_from_world of cameras at these degrees around the y axis."""
    return np.stack([look_at_pose(angle, AWAY, height) for angle in angles])


INTRINSICS = np.array([[FOCAL, 0, SIZE[0] / 2], [0, FOCAL, SIZE[1] / 2], [0, 0, 1]])


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    """Twenty-four frames of noise, of which every other one is blurred."""
    rng, file = np.random.default_rng(0), tmp_path_factory.mktemp("video") / "walk.mp4"
    with open_video(file, quality=10) as writer:
        for number in range(24):
            picture = rng.integers(0, 256, (120, 160, 3)).astype(np.uint8)
            writer.write(number / 30, cv2.GaussianBlur(picture, (0, 0), 4.0 if number % 2 else 0.7))
    return file


def test_the_sharpest_frames_of_their_time_are_taken(video, tmp_path):
    files, guess, scale = frames_of_walk(video, tmp_path, views=6)
    numbers = [int(file.stem.removeprefix("frame")) for file in files]
    assert all(number % 2 == 0 for number in numbers)
    assert [number // 4 for number in numbers] == list(range(6))
    assert guess == pytest.approx(0.9 * 160)
    assert scale == 1
    assert cv2.imread(str(files[0])).shape == (120, 160, 3)


def test_a_known_focal_length_is_in_pixels_of_the_video(video, monkeypatch):
    """Frames of 160 by 120 pixels are made half as large, and the focal length with them."""
    told = {}

    def place(files, size, **options):
        told.update(options, size=size, shown=cv2.imread(str(files[0])).shape)
        raise InputError("seen enough")

    monkeypatch.setattr(_scan_frames, "LONGEST", 80)
    monkeypatch.setattr(_scan_views, "calibrate_pictures", place)
    for given, guess in ((150.0, 75.0), (None, 0.9 * 80)):
        with pytest.raises(InputError, match="seen enough"):
            scan(video, height=1.7, focal=given)
        assert (told["size"], told["shown"]) == ((80, 60), (60, 80, 3))
        assert told["guess"] == pytest.approx(guess)
        assert told["focal"] == (pytest.approx(75) if given else None)


def test_a_walk_that_is_short_or_dark_is_refused(tmp_path):
    for name, frames, light in (("short", 8, 128), ("dark", 16, 3)):
        with open_video(tmp_path / f"{name}.mp4") as writer:
            for number in range(frames):
                writer.write(number / 30, np.full((120, 160, 3), light, np.uint8))
    with pytest.raises(InputError, match=r"short\.mp4 has 8 frames; at least 12"):
        scan(tmp_path / "short.mp4", height=1.7)
    with pytest.raises(InputError, match=r"dark\.mp4 is too dark"):
        scan(tmp_path / "dark.mp4", height=1.7)


def test_the_widest_gap_of_a_lap_is_measured():
    assert widest_gap(around(np.arange(0, 360, 20))) == pytest.approx(20, abs=0.1)
    assert widest_gap(around(np.arange(0, 200, 20))) == pytest.approx(180, abs=0.5)


def standing(height: float, sway: float = 0.0):
    """Cameras around a person of this height, keypoints of arms and legs, and a person who moves from view to view."""
    parts = {name: part * height for name, part in PARTS_OF_HEIGHT.items()}
    points = {
        "l_hip": (0.1, 0.9, 0),
        "r_hip": (-0.1, 0.9, 0),
        "l_shoulder": (0.18, 1.4, 0),
        "r_shoulder": (-0.18, 1.4, 0),
    }
    for side, sign in (("l", 1), ("r", -1)):
        points[f"{side}_knee"] = np.array(points[f"{side}_hip"]) - [0, parts["thigh"], 0]
        points[f"{side}_ankle"] = points[f"{side}_knee"] - [0, parts["shank"], 0]
        points[f"{side}_elbow"] = np.array(points[f"{side}_shoulder"]) + parts["upper_arm"] * np.array(
            [0.6 * sign, -0.8, 0]
        )
        points[f"{side}_wrist"] = points[f"{side}_elbow"] + parts["forearm"] * np.array([0.6 * sign, -0.8, 0])
    poses, keypoints = around(np.arange(0, 360, 30)), np.zeros((12, 25, 3))
    rng = np.random.default_rng(0)
    for view, pose in enumerate(poses):
        moved = sway * rng.standard_normal(3)
        for name, point in points.items():
            image = INTRINSICS @ (pose[:3, :3] @ (np.asarray(point) + moved) + pose[:3, 3])
            keypoints[view, KEYPOINT_NAMES.index(name)] = [*(image[:2] / image[2]), 0.9]
    poses[:, :3, 3] *= 0.4  # the world's unit is two and a half metres
    arrays = jax.device_put((np.tile(INTRINSICS, (12, 1, 1)), np.zeros((12, 5)), poses[:, None]))
    arrays = [np.asarray(array, np.float32) for array in arrays]
    names = tuple(f"view{view}" for view in range(12))
    return Cameras(names, (SIZE,) * 12, *jax.device_put(arrays)), keypoints


def test_the_persons_height_tells_the_scale_of_the_cameras():
    assert person_scale(*standing(1.72), 1.72) == pytest.approx(2.5, rel=0.01)


def test_a_person_who_does_not_stand_still_is_refused():
    with pytest.raises(InputError, match=r"did not stand still: joints are \d+ cm"):
        person_scale(*standing(1.72, sway=0.25), 1.72)


def test_people_who_are_taken_for_one_are_told_from_one_who_moves():
    cameras, keypoints = standing(1.72, sway=0.25)
    with pytest.raises(InputError, match=r"several people are seen in 2 of 12 pictures \(first b\.png\), and those"):
        person_scale(cameras, keypoints, 1.72, ["b.png", "c.png"])
    person_scale(*standing(1.72), 1.72, ["b.png", "c.png"])


def test_pictures_in_which_nobody_is_found_are_left_out_unless_they_are_half_of_them():
    _, keypoints = standing(1.72)
    files, heard = [Path(f"{view}.jpg") for view in range(12)], []
    keypoints[[3, 7], :, 2] = 0
    assert _scan_masks._showing(files, keypoints, heard.append) == [0, 1, 2, 4, 5, 6, 8, 9, 10, 11]
    assert heard == ["Nobody is found in 3.jpg, 7.jpg: left out."]
    keypoints[1:7, :, 2] = 0
    with pytest.raises(InputError, match=r"nobody is found in 7 of 12 pictures \(first 1\.jpg\); show the whole"):
        _scan_masks._showing(files, keypoints, heard.append)


def test_the_person_in_the_middle_of_what_the_cameras_look_at_is_followed(tmp_path, monkeypatch):
    """By a lens that distorts, in pictures beside whose middle the person is."""
    cameras, _ = standing(1.72)
    lenses = np.tile([0.1, 0, 0, 0, 0], (12, 1)).astype(np.float32)
    asked, heard = {}, []
    notes = {name: ["2 people: the one chosen"] if name in ("view3", "view8") else [] for name in cameras.names}

    def find(folder, person, say, **_):
        asked.update(person)
        for sentence in ("view3: the person is looked for at (1, 2)", "Weights of a detector, licence X"):
            say(sentence)
        return FoundKeypoints({}, {"cameras": {name: {"notes": one} for name, one in notes.items()}})

    monkeypatch.setattr(_scan_masks, "detect", find)
    moved = np.array(cameras.cam_from_world)
    moved[..., 0, 3] += 0.1 * np.resize([1, -1], 12)[:, None]
    crooked = replace(cameras, distortion=jax.device_put(lenses), cam_from_world=jax.device_put(moved))
    middle = look_at_point(moved[:, 0].astype(float))
    crowded = _scan_masks._detect(tmp_path, crooked, None, heard.append, lambda *_: None)
    for pose, (name, pixel) in zip(moved[:, 0], asked.items(), strict=True):
        x, y, z = pose[:3, :3] @ middle + pose[:3, 3]
        longer = 1 + 0.1 * (x**2 + y**2) / z**2
        at = longer * FOCAL / z * np.array([x, y]) + np.array(SIZE) / 2
        np.testing.assert_allclose(pixel, at, atol=0.1, err_msg=name)
    assert max(abs(pixel[0] - SIZE[0] / 2) for pixel in asked.values()) > 5
    assert crowded == [3, 8]
    assert heard[0].startswith("Weights")
    assert heard[1].startswith("Several people are seen in 2 of 12 pictures; the one in the middle")
    assert len(heard) == 2


@pytest.mark.parametrize(("count", "taken"), [(4, 4), (16, 16), (17, 9), (40, 14)])
def test_a_body_is_measured_in_some_of_many_views(count, taken, tmp_path):
    sections = [f'\n[[camera]]\nname = "view{number:02d}"\nvideo = "{number}.png"\n' for number in range(count)]
    (tmp_path / "capture.toml").write_text('name = "scan"\nkeypoints = "keypoints"\n' + "".join(sections))
    few = tomllib.loads(_scan_masks._measured_views(tmp_path / "capture.toml").read_text())
    assert few["keypoints"] == "keypoints"
    assert len(few["camera"]) == taken
    assert few["camera"][0]["name"] == "view00"
    assert int(few["camera"][-1]["name"][4:]) > 0.7 * count - 1


def test_a_person_whose_limbs_are_not_seen_tells_no_scale():
    cameras, keypoints = standing(1.72)
    with pytest.raises(InputError, match="not seen well enough in two pictures"):
        person_scale(cameras, np.zeros_like(keypoints), 1.72)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({}, "say it with --height, or give --masks"),
        ({"height": 18.0}, "18"),
        ({"height": 1.7, "masks": "masks"}, "--masks goes with a folder of pictures"),
        ({"height": 1.7, "cameras": "model"}, "--cameras goes with a folder of pictures"),
        ({"height": 1.7, "focal": 2.0}, "--focal is 2; a focal length in pixels"),
    ],
)
def test_options_that_do_not_fit_are_refused(video, options, sentence):
    with pytest.raises(InputError, match=sentence):
        scan(video, **options)


def test_views_that_look_from_above_have_a_lap_too():
    poses = around(np.arange(0, 360, 30), height=2.5)
    turned = poses.copy()
    turned[:, :3, :3] = poses[:, :3, :3] @ Rotation.from_rotvec([0.4, 0.2, -0.7]).as_matrix()
    assert widest_gap(turned) == pytest.approx(30, abs=0.1)
