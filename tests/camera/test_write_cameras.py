"""Writing cameras: every form is read back, and nothing that a form cannot hold is written."""

import os
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import cv2
import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from calibration_files import DISTORTION, INTRINSICS, NAMES, POSES, SIZES, check_rig
from hypothesis import HealthCheck, given, settings, strategies
from scipy.spatial.transform import Rotation

from jaxmocap._results import InputError
from jaxmocap.camera import FORMATS, Cameras, project, read_cameras, write_cameras

PLACES = {
    "colmap": "model",
    "colmap-binary": "model",
    "easymocap": "calib",
    "aniposelib": "rig.toml",
    "pose2sim": "rig.toml",
    "freemocap": "rig.toml",
    "qualisys": "rig.qca.txt",
    "opencv": "rig.yml",
}
STATIC = [form for form in FORMATS if not form.startswith("colmap")]


def _rig(num_frames: int = 3) -> Cameras:
    poses = np.repeat(np.array(POSES, np.float32)[:, None], num_frames, axis=1)
    arrays = (jnp.asarray(array, jnp.float32) for array in (INTRINSICS, DISTORTION, poses))
    return Cameras(NAMES, tuple(SIZES), *arrays)


def _moving() -> Cameras:
    poses = np.array(_rig(4).cam_from_world)
    poses[1, :, 0, 3] += [0.0, 0.1, 0.2, 0.3]
    poses[1, 2, :3, :3] = Rotation.from_rotvec([0, 0, np.radians(12)]).as_matrix() @ poses[1, 2, :3, :3]
    return eqx.tree_at(lambda cameras: cameras.cam_from_world, _rig(4), jnp.asarray(poses))


def _assert_same(found: Cameras, expected: Cameras, tolerance: float = 3e-7) -> None:
    assert found.names == expected.names
    assert found.sizes == expected.sizes
    np.testing.assert_array_equal(found.intrinsics, expected.intrinsics)
    np.testing.assert_array_equal(found.distortion, expected.distortion)
    scale = 1 + np.abs(expected.cam_from_world).max()
    np.testing.assert_allclose(found.cam_from_world, expected.cam_from_world, rtol=0, atol=tolerance * scale)


def test_every_form_has_a_test():
    assert set(PLACES) == set(FORMATS)


@pytest.mark.parametrize("form", FORMATS)
def test_what_is_written_is_read_back(tmp_path: Path, form: str):
    path = write_cameras(_rig(), tmp_path / PLACES[form], form)
    check_rig(read_cameras(path, NAMES, 3, SIZES))
    assert os.listdir(tmp_path) == [PLACES[form]]


@pytest.mark.parametrize("form", [form for form in FORMATS if form != "easymocap"])
def test_names_may_have_blanks_and_letters_of_any_alphabet(tmp_path: Path, form: str):
    cameras = replace(_rig(), names=("Kamera 1 groß.b", "0x1"))
    path = write_cameras(cameras, tmp_path / PLACES[form], form)
    _assert_same(read_cameras(path, cameras.names, 3, SIZES), cameras)


@pytest.mark.parametrize("form", [form for form in FORMATS if form != "easymocap"])
def test_names_that_look_like_numbers_stay_what_they_are(tmp_path: Path, form: str):
    names = ("01", "1e3")
    cameras = replace(_rig(), names=names)
    path = write_cameras(cameras, tmp_path / PLACES[form], form)
    _assert_same(read_cameras(path, names, 3, cameras.sizes), cameras)


@pytest.mark.parametrize("suffix", [".yml", ".yaml", ".xml", ".json"])
def test_opencv_s_form_goes_by_the_suffix(tmp_path: Path, suffix: str):
    path = write_cameras(_rig(), tmp_path / f"rig{suffix}", "opencv")
    check_rig(read_cameras(path, NAMES, 3, SIZES))
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    section = storage.getNode("camera_01")
    assert section.getNode("name").string() == "right"
    np.testing.assert_allclose(section.getNode("camera_matrix").mat(), [[600, 0, 319.5], [0, 602, 239.5], [0, 0, 1]])


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=strategies.integers(0, 2**31), half_turn=strategies.booleans())
@pytest.mark.parametrize("form", FORMATS)
def test_any_cameras_are_read_back_to_the_last_digits(
    tmp_path_factory: pytest.TempPathFactory, form: str, seed: int, half_turn: bool
):
    rng = np.random.default_rng(seed)
    poses = np.tile(np.eye(4), (2, 1, 1, 1))
    turns = rng.normal(size=(2, 3))
    if half_turn:
        turns *= np.pi / np.linalg.norm(turns, axis=1, keepdims=True)
    poses[:, 0, :3, :3] = Rotation.from_rotvec(turns).as_matrix()
    centres = np.array([[0.0, 0, 0], [3, 1, -2]]) + rng.normal(size=(2, 3))
    poses[:, 0, :3, 3] = -np.einsum("cij,cj->ci", poses[:, 0, :3, :3], centres)
    intrinsics = np.zeros((2, 3, 3))
    intrinsics[:, 2, 2] = 1
    intrinsics[:, [0, 1], [0, 1]] = rng.uniform(300, 3000, (2, 2))
    intrinsics[:, :2, 2] = rng.uniform(100, 2000, (2, 2))
    distortion = rng.normal(size=(2, 5)) * rng.integers(0, 2, (2, 1)) * [0.1, 0.1, 0.01, 0.01, rng.integers(0, 2)]
    arrays = (jnp.asarray(array, jnp.float32) for array in (intrinsics, distortion, poses))
    cameras = Cameras(("28984", "cam_b-2"), ((1088, 1920), (641, 479)), *arrays)
    path = write_cameras(cameras, tmp_path_factory.mktemp("rig") / PLACES[form], form)
    back = read_cameras(path, cameras.names, 1, cameras.sizes)
    _assert_same(back, cameras)


@pytest.mark.parametrize("form", ["colmap", "colmap-binary"])
def test_moving_cameras_keep_a_pose_for_each_frame_of_their_own_videos(tmp_path: Path, form: str):
    cameras = _moving()
    frames = np.array([[2, 3, 4, 5], [0, 1, 1, 2]])
    poses = cameras.cam_from_world.at[1, 2].set(cameras.cam_from_world[1, 1])  # one image shown twice
    cameras = eqx.tree_at(lambda cameras: cameras.cam_from_world, cameras, poses)
    path = write_cameras(cameras, tmp_path / "model", form, frames)
    _assert_same(read_cameras(path, NAMES, 4, SIZES, frames), cameras)
    with pytest.raises(InputError, match="no pose for left frames 0-1"):
        read_cameras(path, NAMES, 4, SIZES)


@pytest.mark.parametrize("form", ["colmap", "colmap-binary"])
def test_one_frame_in_two_poses_is_refused(tmp_path: Path, form: str):
    with pytest.raises(InputError, match="camera right different poses at one of the frames"):
        write_cameras(_moving(), tmp_path / "model", form, np.array([[0, 1, 2, 3], [0, 1, 1, 2]]))
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("form", STATIC)
def test_forms_of_static_cameras_refuse_one_that_moves(tmp_path: Path, form: str):
    words = (
        f"written as {form}, which holds one pose per camera: right moves by up to .* m and 12 degrees; write colmap"
    )
    with pytest.raises(InputError, match=words):
        write_cameras(_moving(), tmp_path / PLACES[form], form)
    assert os.listdir(tmp_path) == []


def test_colmap_reads_the_binary_model(tmp_path: Path):
    write_cameras(_moving(), tmp_path / "model", "colmap-binary")
    (tmp_path / "text").mkdir()
    script = "import sys, pycolmap; pycolmap.Reconstruction(sys.argv[1]).write_text(sys.argv[2])"
    command = [sys.executable, "-c", script, str(tmp_path / "model"), str(tmp_path / "text")]
    subprocess.run(command, check=True, timeout=120)
    _assert_same(read_cameras(tmp_path / "text", NAMES, 4, SIZES), _moving(), 1e-6)


def test_a_written_toml_projects_in_opencv_half_a_pixel_before_ours(tmp_path: Path):
    cameras = _rig(1)
    document = tomllib.loads(write_cameras(cameras, tmp_path / "rig.toml", "pose2sim").read_text())
    points = np.random.default_rng(0).uniform(-1, 1, (5, 3)) + [0, 1, 0]
    for index, section in enumerate((document["cam_00"], document["cam_01"])):
        vectors = np.array(section["rotation"]), np.array(section["translation"])
        theirs = cv2.projectPoints(points, *vectors, np.array(section["matrix"]), np.zeros(4))[0][:, 0]
        ours = project(cameras.intrinsics[index], cameras.cam_from_world[index, 0], jnp.asarray(points, jnp.float32))[0]
        np.testing.assert_allclose(ours - theirs, 0.5, atol=1e-3)


def test_freemocap_and_qualisys_are_written_in_millimetres(tmp_path: Path):
    import xml.etree.ElementTree as ElementTree

    section = tomllib.loads(write_cameras(_rig(), tmp_path / "rig.toml", "freemocap").read_text())["cam_01"]
    assert section["world_position"] == pytest.approx([4000, 1000, 500])
    assert section["translation"] == pytest.approx([500, 1000, 4000])
    np.testing.assert_allclose(section["world_orientation"], np.array(POSES[1])[:3, :3].T)
    camera = ElementTree.parse(write_cameras(_rig(), tmp_path / "rig.qca.txt", "qualisys")).findall("cameras/camera")[1]
    place, optics, field = (camera.find(tag).attrib for tag in ("transform", "intrinsic", "fov_video"))
    assert [float(place[axis]) for axis in "xyz"] == pytest.approx([4000, 1000, 500])
    assert [float(place[f"r1{column}"]) for column in (1, 2, 3)] == pytest.approx([0, 0, -1])
    assert float(optics["centerPointU"]) == 319.5 * 64
    assert float(optics["radialDistortion1"]) == pytest.approx(0.1)
    assert (field["right"], field["bottom"]) == ("639", "479")


def _changed(where, value) -> Cameras:
    return eqx.tree_at(where, _rig(), value)


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize(
    ("cameras", "words"),
    [
        (_changed(lambda c: c.intrinsics, _rig().intrinsics.at[1, 0, 0].set(np.nan)), "camera right.* finite"),
        (_changed(lambda c: c.intrinsics, _rig().intrinsics.at[1, 0, 0].set(0)), "camera right.* focal length is 0"),
        (_changed(lambda c: c.intrinsics, _rig().intrinsics.at[1, 0, 1].set(2)), "camera right has skew 2"),
        (_changed(lambda c: c.cam_from_world, _rig().cam_from_world.at[0, :, 0, 0].set(-1)), "camera left.* mirrored"),
        (
            _changed(lambda c: c.cam_from_world, _rig().cam_from_world.at[0, 1, 1, 3].set(np.inf)),
            "camera left.* finite",
        ),
        (replace(_rig(), names=("a", "a")), "two have one name, among a, a"),
        (replace(_rig(), sizes=((0, 0), SIZES[1])), "camera left has the size 0x0"),
    ],
)
def test_cameras_that_cannot_be_true_are_not_written(tmp_path: Path, form: str, cameras: Cameras, words: str):
    with pytest.raises(InputError, match=words):
        write_cameras(cameras, tmp_path / PLACES[form], form)
    assert os.listdir(tmp_path) == []


def test_places_where_nothing_can_be_written_are_refused(tmp_path: Path):
    with pytest.raises(InputError, match="'anipose'; expected one of colmap"):
        write_cameras(_rig(), tmp_path / "a", "anipose")
    with pytest.raises(InputError, match=r"rig\.txt cannot hold freemocap cameras; expected a file name with \.toml"):
        write_cameras(_rig(), tmp_path / "rig.txt", "freemocap")
    (tmp_path / "file").write_text("mine")
    with pytest.raises(InputError, match=r"cannot be written to .*(Not a directory|File exists)"):
        write_cameras(_rig(), tmp_path / "file" / "rig.toml", "freemocap")
    (tmp_path / "file").unlink()
    with pytest.raises(InputError, match="'a b' cannot be written for EasyMocap"):
        write_cameras(replace(_rig(), names=("a b", "c")), tmp_path / "calib", "easymocap")
    with pytest.raises(InputError, match=r"frames has shape \(2, 2\); expected a number .* per frame, \(2, 3\)"):
        write_cameras(_rig(), tmp_path / "model", "colmap", np.array([[0, 1], [0, 1]]))
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").write_text("mine")
    for form in ("colmap", "colmap-binary", "easymocap"):
        with pytest.raises(InputError, match="full exists already"):
            write_cameras(_rig(), tmp_path / "full", form)
    assert (tmp_path / "full" / "mine").read_text() == "mine"
    assert os.listdir(tmp_path) == ["full"]


@pytest.mark.parametrize("form", FORMATS)
def test_an_interrupted_write_leaves_nothing_behind(tmp_path: Path, form: str, monkeypatch: pytest.MonkeyPatch):
    def fail(path):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("jaxmocap._files._atomic._flush", fail)
    with pytest.raises(InputError, match="No space left on device"):
        write_cameras(_rig(), tmp_path / PLACES[form], form)
    assert os.listdir(tmp_path) == []
