"""COLMAP models, text and binary: what is read, what is written, and what is refused."""

import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from two_cameras import NAMES, SIZES, drifting_poses, refusal

from jaxmocap.camera import Cameras, ranges, read_cameras, write_colmap_text


def _quaternion(pose: np.ndarray) -> list[float]:
    x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat().tolist()
    return [w, x, y, z]


CAMERA_LINES = ["7 PINHOLE 960 540 900 901 480 270", "9 OPENCV 640 480 600 602 320 240 0.1 -0.2 0.003 0.004"]


def _write_text(folder: Path, poses: np.ndarray, cameras: list[str] = CAMERA_LINES, gap: str = "\n\n") -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "cameras.txt").write_text("# Camera list\n" + "\n".join(cameras) + "\n")
    lines = ["# Image list\n"]
    for camera, name in enumerate(NAMES):
        for frame, pose in enumerate(poses[camera]):
            values = " ".join(map(repr, [*_quaternion(pose), *pose[:3, 3].tolist()]))
            lines.append(f"{len(lines)} {values} {(7, 9)[camera]} {name}/{frame:05d}.jpg{gap}")
    (folder / "images.txt").write_text("".join(lines))
    (folder / "points3D.txt").write_text("")
    return folder


def _write_binary(folder: Path, poses: np.ndarray) -> Path:
    folder.mkdir(exist_ok=True)
    cameras = struct.pack("<Q", 2)
    cameras += struct.pack("<IiQQ4d", 7, 1, 960, 540, 900, 901, 480, 270)
    cameras += struct.pack("<IiQQ8d", 9, 4, 640, 480, 600, 602, 320, 240, 0.1, -0.2, 0.003, 0.004)
    images = struct.pack("<Q", 2 * poses.shape[1])
    for camera, name in enumerate(NAMES):
        for frame, pose in enumerate(poses[camera]):
            images += struct.pack("<I7dI", frame, *_quaternion(pose), *pose[:3, 3], (7, 9)[camera])
            images += f"{name}/{frame:05d}.png".encode() + b"\0"
            images += struct.pack("<Q", 3) + struct.pack("<ddq", 1.0, 2.0, -1) * 3
    (folder / "cameras.bin").write_bytes(cameras)
    (folder / "images.bin").write_bytes(images)
    (folder / "points3D.bin").write_bytes(struct.pack("<Q", 0))
    return folder


def _check_content(cameras: Cameras, poses: np.ndarray) -> None:
    assert cameras.names == NAMES
    assert cameras.sizes == tuple(SIZES)
    np.testing.assert_allclose(cameras.cam_from_world, poses, atol=1e-6)
    np.testing.assert_allclose(cameras.intrinsics[0], [[900, 0, 480], [0, 901, 270], [0, 0, 1]])
    np.testing.assert_allclose(cameras.intrinsics[1], [[600, 0, 320], [0, 602, 240], [0, 0, 1]])
    np.testing.assert_allclose(cameras.distortion, [[0] * 5, [0.1, -0.2, 0.003, 0.004, 0]], atol=1e-7)


@pytest.mark.parametrize("gap", ["\n\n", "\n", "\n1.5 2.5 -1 3.5 4.5 17\n", "\n   \n"])
def test_a_text_model_is_read_whatever_stands_between_its_images(tmp_path: Path, gap: str):
    poses = drifting_poses()
    for path in (_write_text(tmp_path / "m", poses, gap=gap), tmp_path / "m" / "images.txt"):
        _check_content(read_cameras(path, NAMES, 5, SIZES), poses)


def test_a_binary_model_is_read(tmp_path: Path):
    poses = drifting_poses()
    _check_content(read_cameras(_write_binary(tmp_path / "m", poses), NAMES, 5, SIZES), poses)


def test_the_binary_model_goes_before_the_text_model(tmp_path: Path):
    poses = drifting_poses()
    _write_text(tmp_path / "m", drifting_poses(seed=4))
    _check_content(read_cameras(_write_binary(tmp_path / "m", poses), NAMES, 5, SIZES), poses)


def test_a_binary_model_that_colmap_wrote_from_our_text_model_is_the_same(tmp_path: Path):
    poses = drifting_poses(3)
    write_colmap_text(read_cameras(_write_text(tmp_path / "a", poses), NAMES, 3), tmp_path / "text")
    (tmp_path / "binary").mkdir()
    script = "import sys, pycolmap; pycolmap.Reconstruction(sys.argv[1]).write_binary(sys.argv[2])"
    command = [sys.executable, "-c", script, str(tmp_path / "text"), str(tmp_path / "binary")]
    subprocess.run(command, check=True, timeout=120)
    _check_content(read_cameras(tmp_path / "binary", NAMES, 3, SIZES), poses)


def test_what_is_written_is_read_back(tmp_path: Path):
    import equinox as eqx

    poses = drifting_poses()
    cameras = read_cameras(_write_text(tmp_path / "a", poses), NAMES, 5)
    third = eqx.tree_at(lambda c: c.distortion, cameras, cameras.distortion.at[1, 4].set(0.05))
    write_colmap_text(third, tmp_path / "b", first_frame=10)
    frames = np.tile(np.arange(10, 15), (2, 1))
    back = read_cameras(tmp_path / "b", NAMES, 5, SIZES, frames)
    np.testing.assert_allclose(back.cam_from_world, third.cam_from_world, atol=2e-7)
    np.testing.assert_allclose(back.intrinsics, third.intrinsics)
    np.testing.assert_allclose(back.distortion, third.distortion)


def test_each_camera_takes_the_poses_of_its_own_frames(tmp_path: Path):
    poses = drifting_poses()
    frames = np.array([[1, 2, 3], [0, 2, 2]])
    cameras = read_cameras(_write_text(tmp_path / "m", poses), NAMES, 3, SIZES, frames)
    np.testing.assert_allclose(cameras.cam_from_world[0], poses[0, 1:4], atol=1e-6)
    np.testing.assert_allclose(cameras.cam_from_world[1], poses[1, [0, 2, 2]], atol=1e-6)


def test_cameras_come_in_the_order_asked_for_and_others_are_ignored(tmp_path: Path):
    poses = drifting_poses()
    cameras = read_cameras(_write_text(tmp_path / "m", poses), ("right",), 5, [SIZES[1]])
    np.testing.assert_allclose(cameras.cam_from_world[0], poses[1], atol=1e-6)


@pytest.mark.parametrize(
    ("line", "focal", "distortion"),
    [
        ("SIMPLE_PINHOLE 960 540 900 480 270", 900, [0, 0, 0, 0, 0]),
        ("SIMPLE_RADIAL 960 540 900 480 270 0.1", 900, [0.1, 0, 0, 0, 0]),
        ("RADIAL 960 540 900 480 270 0.1 0.2", 900, [0.1, 0.2, 0, 0, 0]),
        ("FULL_OPENCV 960 540 900 901 480 270 .1 .2 .3 .4 .5 0 0 0", 901, [0.1, 0.2, 0.3, 0.4, 0.5]),
    ],
)
def test_every_supported_camera_model(tmp_path: Path, line: str, focal: float, distortion: list[float]):
    folder = _write_text(tmp_path / "m", drifting_poses(), ["7 " + line, CAMERA_LINES[1]])
    cameras = read_cameras(folder, NAMES, 5, SIZES)
    np.testing.assert_allclose(cameras.intrinsics[0], [[900, 0, 480], [0, focal, 270], [0, 0, 1]])
    np.testing.assert_allclose(cameras.distortion[0], distortion, atol=1e-7)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("7 FULL_OPENCV 960 540 900 900 480 270 .1 0 0 0 0 .1 0 0", ["camera left", "FULL_OPENCV", "k4 k5 k6"]),
        ("7 OPENCV_FISHEYE 960 540 900 900 480 270 .1 0 0 0", ["camera left", "OPENCV_FISHEYE", "not supported"]),
        ("7 FANTASY 960 540 1", ["camera left", "FANTASY", "not supported"]),
        ("7 PINHOLE 960 540 900 480 270", ["cameras.txt line 2", "PINHOLE takes 4 parameters, found 3"]),
        ("7 PINHOLE 960", ["cameras.txt line 2", "expected CAMERA_ID MODEL"]),
        ("7 PINHOLE 960 540 900 nine 480 270", ["cameras.txt line 2", "expected numbers"]),
        ("7 PINHOLE 960.5 540 900 900 480 270", ["cameras.txt line 2", "whole number", "960.5"]),
        ("7 PINHOLE 960 540 0 900 480 270", ["camera left", "focal length is 0"]),
        ("7 PINHOLE 960 540 900 -900 480 270", ["camera left", "mirror the image", "-900"]),
        ("7 PINHOLE 960 540 nan 900 480 270", ["camera left", "finite"]),
        ("7 PINHOLE 960 540 900 900 inf 270", ["camera left", "finite"]),
        ("7 PINHOLE 1920 1080 900 900 480 270", ["camera left", "1920x1080", "video has 960x540"]),
        ("7 PINHOLE 540 960 900 900 270 480", ["camera left", "540x960", "sides are swapped"]),
        ("8 PINHOLE 960 540 900 900 480 270", ["left frame 0", "camera 7", "cameras.txt does not have"]),
    ],
)
def test_intrinsics_that_cannot_be_true_are_refused_by_camera(tmp_path: Path, line: str, words: list[str]):
    sentence = refusal(_write_text(tmp_path / "model", drifting_poses(), [line, CAMERA_LINES[1]]))
    for word in words:
        assert word in sentence


def _edit_images(folder: Path, old: str, new: str) -> None:
    text = (folder / "images.txt").read_text()
    assert old in text
    (folder / "images.txt").write_text(text.replace(old, new))


def test_missing_frames_are_listed_by_camera_in_ranges(tmp_path: Path):
    folder = _write_text(tmp_path / "cameras", drifting_poses(20))
    for frame in (3, 12, 13, 14):
        _edit_images(folder, f"left/{frame:05d}.jpg", f"left/{frame + 100:05d}.jpg")
    _edit_images(folder, "right/00019.jpg", "right/00119.jpg")
    sentence = refusal(folder, 20)
    assert "cameras/images.txt has no pose for left frames 3, 12-14, nor for right frame 19" in sentence


def test_a_model_counted_from_one_is_recognised(tmp_path: Path):
    folder = _write_text(tmp_path / "m", drifting_poses())
    for frame in range(4, -1, -1):
        _edit_images(folder, f"/{frame:05d}.jpg", f"/{frame + 1:05d}.jpg")
    assert "no pose for left frame 0" in refusal(folder)
    assert "number the images from 0" in refusal(folder)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("right/", "third/", ["images.txt has no images of right", "left, third"]),
        ("left/00002.jpg", "left/frame2.jpg", ["left/frame2.jpg", "not named by its frame"]),
        ("left/00002.jpg", "left/00001.jpg", ["two poses for left frame 1"]),
        (" 7 left/00002.jpg", " 9 left/00002.jpg", ["left several sets of intrinsics", "cameras 7, 9"]),
        (" 7 left/00002.jpg", " 8 left/00002.jpg", ["left frame 2", "camera 8"]),
        (" 7 left/00002.jpg", " seven left/00002.jpg", ["images.txt line", "whole number", "seven"]),
        (" 7 left/00002.jpg", "", ["images.txt line 6", "found 8 words"]),
    ],
)
def test_image_lists_that_do_not_fit_are_refused(tmp_path: Path, old: str, new: str, words: list[str]):
    folder = _write_text(tmp_path / "m", drifting_poses())
    _edit_images(folder, old, new)
    sentence = refusal(folder)
    for word in words:
        assert word in sentence


def test_images_of_one_camera_with_equal_intrinsics_under_two_numbers_are_accepted(tmp_path: Path):
    folder = _write_text(tmp_path / "m", drifting_poses(), [*CAMERA_LINES, CAMERA_LINES[0].replace("7", "8", 1)])
    _edit_images(folder, " 7 left/00002.jpg", " 8 left/00002.jpg")
    assert read_cameras(folder, NAMES, 5, SIZES).num_frames == 5


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("0.9 0 0 0 0 0 4", ["left frame 1", "length 0.9", "expected 1"]),
        ("nan 0 0 0 0 0 4", ["left frame 1", "length nan"]),
        ("1 0 0 0 0 inf 4", ["left frame 1", "translation", "not finite"]),
        ("1 0 0 zero 0 0 4", ["images.txt line 4", "expected numbers"]),
    ],
)
def test_poses_that_are_no_poses_are_refused_by_camera_and_frame(tmp_path: Path, row: str, words: list[str]):
    folder = _write_text(tmp_path / "m", drifting_poses())
    lines = (folder / "images.txt").read_text().splitlines()
    lines[3] = f"2 {row} 7 left/00001.jpg"
    (folder / "images.txt").write_text("\n".join(lines))
    sentence = refusal(folder)
    for word in words:
        assert word in sentence


@pytest.mark.parametrize(("factor", "unit"), [(1000, "millimetres"), (100, "centimetres")])
def test_other_units_are_recognised_and_cured_by_the_setting(tmp_path: Path, factor: float, unit: str):
    poses = drifting_poses()
    poses[..., :3, 3] *= factor
    folder = _write_text(tmp_path / "m", poses)
    assert f'looks like {unit}: set units = "{unit}"' in refusal(folder)
    assert "left and right" in refusal(folder)
    cured = read_cameras(folder, NAMES, 5, SIZES, metres_per_unit=1 / factor)
    np.testing.assert_allclose(cured.cam_from_world, drifting_poses(), atol=1e-5)


def test_metres_called_millimetres_are_recognised(tmp_path: Path):
    assert 'looks like metres: set units = "metres"' in refusal(
        _write_text(tmp_path / "m", drifting_poses()), metres_per_unit=0.001
    )


def test_a_world_whose_origin_is_kilometres_away_is_refused(tmp_path: Path):
    poses = drifting_poses()
    poses[..., :3, 3] -= np.einsum("ctij,j->cti", poses[..., :3, :3], [4e6, 0, 0])
    assert "from the world's origin" in refusal(_write_text(tmp_path / "m", poses))


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin"])
def test_a_binary_model_cut_anywhere_is_called_truncated(tmp_path: Path, name: str):
    folder = _write_binary(tmp_path / "m", drifting_poses(2))
    whole = (folder / name).read_bytes()
    for length in [0, 4, *range(8, len(whole), 7)]:
        (folder / name).write_bytes(whole[:length])
        sentence = refusal(folder, 2)
        assert name in sentence
        assert "truncated" in sentence


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin"])
def test_an_absurd_count_is_refused_before_memory_is_taken(tmp_path: Path, name: str):
    import tracemalloc

    folder = _write_binary(tmp_path / "m", drifting_poses(2))
    whole = (folder / name).read_bytes()
    (folder / name).write_bytes(struct.pack("<Q", 2**60) + whole[8:])
    tracemalloc.start()
    assert f"announces {2**60}" in refusal(folder, 2)
    assert tracemalloc.get_traced_memory()[1] < 2_000_000
    tracemalloc.stop()


def test_an_absurd_number_of_points_in_one_image_is_refused(tmp_path: Path):
    folder = _write_binary(tmp_path / "m", drifting_poses(2))
    data = (folder / "images.bin").read_bytes()
    at = data.index(b"left/00000.png\0") + 15
    (folder / "images.bin").write_bytes(data[:at] + struct.pack("<Q", 2**62) + data[at + 8 :])
    assert "points in image left/00000.png" in refusal(folder, 2)


def test_an_unknown_camera_model_number_is_refused(tmp_path: Path):
    folder = _write_binary(tmp_path / "m", drifting_poses(2))
    data = (folder / "cameras.bin").read_bytes()
    (folder / "cameras.bin").write_bytes(data[:12] + struct.pack("<i", 99) + data[16:])
    assert "camera 7 has the unknown model number 99" in refusal(folder, 2)


def test_binary_rubbish_in_a_text_model_is_refused(tmp_path: Path):
    folder = _write_text(tmp_path / "m", drifting_poses())
    (folder / "images.txt").write_bytes(bytes(range(128, 256)) * 20)
    assert "not UTF-8" in refusal(folder)


def test_frame_numbers_are_said_as_ranges():
    assert ranges([14, 12, 13, 3]) == "3, 12-14"
    assert ranges([5]) == "5"
