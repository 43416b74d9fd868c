"""Camera files of aniposelib and Pose2Sim, in TOML."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from two_cameras import NAMES, SIZES, drifting_poses, refusal

from jaxmocap.camera import project, read_cameras


def _toml(path: Path, poses: np.ndarray, **changes: str) -> Path:
    """Two static cameras; `changes` replace the values of the first."""
    sections = ["[metadata]\nerror = 0.0\n"]
    for camera, name in enumerate(NAMES):
        width, height = SIZES[camera]
        values = {
            "name": f'"{name}"',
            "size": f"[{width}.0, {height}.0]",
            "matrix": "[[900.0, 0.0, 479.5], [0.0, 901.0, 269.5], [0.0, 0.0, 1.0]]",
            "distortions": "[0.1, -0.2, 0.003, 0.004]",
            "rotation": str(cv2.Rodrigues(poses[camera, 0, :3, :3])[0].ravel().tolist()),
            "translation": str(poses[camera, 0, :3, 3].tolist()),
            "fisheye": "false",
        } | (changes if camera == 0 else {})
        lines = [f"{key} = {value}" for key, value in values.items() if value]
        sections.append(f"[cam_{camera}]\n" + "\n".join(lines) + "\n")
    path.write_text("\n".join(sections))
    return path


def test_a_static_calibration_is_read_and_repeated_over_the_frames(tmp_path: Path):
    poses = drifting_poses()
    cameras = read_cameras(_toml(tmp_path / "c.toml", poses), NAMES, 4, SIZES)
    np.testing.assert_allclose(cameras.cam_from_world, np.repeat(poses[:, :1], 4, axis=1), atol=1e-6)
    np.testing.assert_allclose(cameras.intrinsics[0], [[900, 0, 480], [0, 901, 270], [0, 0, 1]])
    np.testing.assert_allclose(cameras.distortion[0], [0.1, -0.2, 0.003, 0.004, 0], atol=1e-7)
    assert cameras.sizes == tuple(SIZES)


def test_projection_through_a_toml_equals_opencv_plus_half_a_pixel(tmp_path: Path):
    poses = drifting_poses()
    cameras = read_cameras(_toml(tmp_path / "c.toml", poses), NAMES, 1, SIZES)
    points = np.random.default_rng(2).uniform(-1, 1, (6, 3))
    matrix = np.array([[900.0, 0, 479.5], [0, 901.0, 269.5], [0, 0, 1]])
    rotation = cv2.Rodrigues(poses[0, 0, :3, :3])[0]
    expected = cv2.projectPoints(points, rotation, poses[0, 0, :3, 3], matrix, np.zeros(5))[0][:, 0] + 0.5
    view = cameras.at(0)
    np.testing.assert_allclose(
        project(view.intrinsics[0], view.cam_from_world[0], np.float32(points))[0], expected, atol=2e-3
    )


def test_sections_are_found_by_title_where_they_have_no_name(tmp_path: Path):
    path = _toml(tmp_path / "c.toml", drifting_poses(), name="")
    path.write_text(path.read_text().replace("[cam_0]", "[left]"))
    assert read_cameras(path, NAMES, 1, SIZES).names == NAMES


@pytest.mark.parametrize("form", ["nested", "flat"])
def test_rotation_matrices_are_understood(tmp_path: Path, form: str):
    poses = drifting_poses()
    matrix = poses[0, 0, :3, :3]
    path = _toml(tmp_path / "c.toml", poses, rotation=str((matrix if form == "nested" else matrix.ravel()).tolist()))
    np.testing.assert_allclose(read_cameras(path, NAMES, 1, SIZES).cam_from_world[0, 0], poses[0, 0], atol=1e-6)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"rotation": "[[1, 0, 0], [0, 1, 0], [0, 0, -1]]"}, ["camera left", "determinant -1", "mirrored"]),
        ({"rotation": "[[1, 0, 0], [0, 1.1, 0], [0, 0, 1]]"}, ["camera left", "not orthonormal"]),
        ({"rotation": "[[1, 0, 0], [0, nan, 0], [0, 0, 1]]"}, ["camera left", "rotation is not finite"]),
        ({"rotation": "[nan, 0, 0]"}, ["camera left", "rotation is not finite"]),
        ({"rotation": "[1, 0]"}, ["camera left", "rotation has shape 2", "expected 3 or"]),
        ({"rotation": ""}, ["camera left has no rotation"]),
        ({"translation": "[inf, 0, 0]"}, ["translation is not finite"]),
        ({"translation": '["a", 0, 0]'}, ["camera left", "translation is not an array of numbers"]),
        ({"matrix": "[[-900, 0, 480], [0, 900, 270], [0, 0, 1]]"}, ["camera left", "mirror the image"]),
        ({"matrix": "[[0, 0, 480], [0, 900, 270], [0, 0, 1]]"}, ["camera left", "focal length is 0"]),
        ({"matrix": "[[900, 0, 0], [0, 900, 0], [480, 270, 1]]"}, ["camera left", "transposed"]),
        ({"matrix": "[[900, 3, 480], [0, 900, 270], [0, 0, 1]]"}, ["camera left", "[[fx, 0, cx]"]),
        ({"distortions": "[0.1, 0, 0, 0, 0, 0.2, 0, 0]"}, ["camera left", "beyond k1 k2 p1 p2 k3"]),
        ({"distortions": "[0.1, nan, 0, 0]"}, ["camera left", "finite"]),
        ({"size": "[1920, 1080]"}, ["camera left", "1920x1080", "960x540"]),
        ({"size": "[960.5, 540]"}, ["camera left", "size must be two whole numbers"]),
        ({"fisheye": "true"}, ["camera left", "fisheye"]),
        ({"name": '"links"'}, ["c.toml has no camera called left", "links, right"]),
        ({"translation": "[90000, 0, 4000]"}, ["left and right", "looks like millimetres"]),
    ],
)
def test_calibrations_that_cannot_be_true_are_refused_by_camera(tmp_path: Path, changes: dict, words: list[str]):
    sentence = refusal(_toml(tmp_path / "c.toml", drifting_poses(), **changes))
    for word in words:
        assert word in sentence


def test_files_that_hold_no_cameras_are_refused_by_name(tmp_path: Path):
    (tmp_path / "c.toml").write_text("this is [not TOML")
    assert "c.toml is neither a COLMAP model nor a TOML calibration" in refusal(tmp_path / "c.toml")
    (tmp_path / "c.npz").write_bytes(bytes(range(256)))
    assert "c.npz is neither" in refusal(tmp_path / "c.npz")
    assert "holds no COLMAP model" in refusal(tmp_path)
    assert "none.toml does not exist" in refusal(tmp_path / "none.toml")
    (tmp_path / "e.toml").write_text("[a]\nx = 1\n")
    assert "e.toml has no camera called left, right; its cameras are: none" in refusal(tmp_path / "e.toml")
