"""GLB and BVH as Blender imports them, and FBX and .blend as it writes them, without a window."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jaxmocap._results import InputError
from jaxmocap.character import BODIES
from jaxmocap.exporters import blender_command, export

try:
    BLENDER = blender_command()
except InputError:
    BLENDER = []


def with_blender(test):
    return pytest.mark.slow(pytest.mark.skipif(not BLENDER, reason="there is no Blender here")(test))


Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def read_in_blender(path: Path, rate: int, seconds: float) -> dict:
    out = path.with_suffix(".json")
    script = Path(__file__).with_name("read_in_blender.py")
    options = [*(str(script) if "_blender_worker" in word else word for word in BLENDER if word != "--"), "--"]
    own = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run([*options, str(path), str(rate), str(seconds), str(out)], capture_output=True, env=own)
    assert done.returncode == 0, done.stdout.decode()[-2000:] + done.stderr.decode()[-2000:]
    return json.loads(out.read_text())


@with_blender
@pytest.mark.parametrize("frame", [0, 7])
def test_blender_sees_the_actor_and_the_cameras_of_a_glb(even, tmp_path, frame):
    found = read_in_blender(export(even, tmp_path / "dance.glb"), 30, even.timestamps[frame])
    (vertices,) = found["vertices"].values()
    np.testing.assert_allclose(vertices, even.vertices(frame) @ Z_UP.T, atol=1e-4)
    for bone, joint in (("mixamorig:LeftForeArm", "l_elbow"), ("mixamorig:RightFoot", "r_ankle")):
        place = even.joints[frame, even.joint_names.index(joint)]
        np.testing.assert_allclose(found["bones"][bone], Z_UP @ place, atol=1e-4)
    for index, name in enumerate(even.cameras.names):
        camera = found["cameras"][name]
        world_from_cam = np.linalg.inv(np.asarray(even.cameras.cam_from_world[index, frame], float))
        turned = Z_UP @ world_from_cam[:3, :3] @ np.diag([1, -1, -1])
        np.testing.assert_allclose(np.array(camera["pose"])[:3, :3], turned, atol=1e-4)
        np.testing.assert_allclose(np.array(camera["pose"])[:3, 3], Z_UP @ world_from_cam[:3, 3], atol=1e-4)
        _, height = even.cameras.sizes[index]  # Blender leaves the width to the size of the rendered picture
        upright = 2 * np.arctan(height / 2 / float(even.cameras.intrinsics[index, 1, 1]))
        assert camera["angle_y"] == pytest.approx(upright, abs=1e-4)


@with_blender
@pytest.mark.parametrize("frame", [0, 7])
def test_blender_sees_the_joints_of_a_bvh(even, tmp_path, frame):
    found = read_in_blender(export(even, tmp_path / "dance.bvh"), 30, frame / 30)
    for body, _, joint in BODIES:
        place = even.joints[frame, even.joint_names.index(joint)]
        np.testing.assert_allclose(found["bones"][body], Z_UP @ place, atol=1e-4)


@with_blender
@pytest.mark.parametrize(("suffix", "frame"), [(".fbx", 0), (".fbx", 7), (".fbx", 11), (".blend", 7)])
def test_what_blender_writes_it_opens_again_with_the_same_joints_skin_and_cameras(even, tmp_path, suffix, frame):
    found = read_in_blender(export(even, tmp_path / f"dance{suffix}"), 30, frame / 30)
    (vertices,) = found["vertices"].values()
    np.testing.assert_allclose(vertices, even.vertices(frame) @ Z_UP.T, atol=1e-3)
    joints = {"LeftForeArm": "l_elbow", "RightFoot": "r_ankle", "RightHand": "r_wrist", "LeftLeg": "l_knee"}
    for bone, joint in joints.items():
        place = even.joints[frame, even.joint_names.index(joint)]
        np.testing.assert_allclose(found["bones"][f"mixamorig:{bone}"], Z_UP @ place, atol=1e-3)
    for index, (name, (width, height)) in enumerate(zip(even.cameras.names, even.cameras.sizes, strict=True)):
        camera, k = found["cameras"][name], np.asarray(even.cameras.intrinsics[index], float)
        world_from_cam = np.linalg.inv(np.asarray(even.cameras.cam_from_world[index, frame], float))
        turned = Z_UP @ world_from_cam[:3, :3] @ np.diag([1, -1, -1])
        np.testing.assert_allclose(np.array(camera["pose"])[:3, :3], turned, atol=1e-3)
        np.testing.assert_allclose(np.array(camera["pose"])[:3, 3], Z_UP @ world_from_cam[:3, 3], atol=1e-3)
        assert camera["focal"] == pytest.approx(k[0, 0] / width, rel=1e-4)
        shift = [0.5 - k[0, 2] / width, (k[1, 2] - height / 2) / width]
        np.testing.assert_allclose(camera["shift"], shift, atol=1e-4)


@with_blender
@pytest.mark.parametrize("suffix", [".fbx", ".blend"])
def test_a_camera_may_be_called_like_an_object_of_the_actor(even, tmp_path, suffix):
    """Like its mesh; of two objects of one name Blender numbers one."""
    (mesh,) = read_in_blender(export(even, tmp_path / f"own{suffix}"), 30, 0)["vertices"]
    alike = replace(even, cameras=replace(even.cameras, names=(mesh, "right")))
    found = read_in_blender(export(alike, tmp_path / f"dance{suffix}"), 30, 0)
    np.testing.assert_allclose(next(iter(found["vertices"].values())), even.vertices(0) @ Z_UP.T, atol=1e-3)
    assert sorted(found["cameras"]) == sorted([f"{mesh}.001", "right"])
    focal = float(even.cameras.intrinsics[0, 0, 0]) / even.cameras.sizes[0][0]
    assert found["cameras"][f"{mesh}.001"]["focal"] == pytest.approx(focal, rel=1e-4)


@with_blender
def test_blender_writes_a_single_frame(even, tmp_path):
    found = read_in_blender(export(even[4:5], tmp_path / "one.fbx"), 30, 0)
    (vertices,) = found["vertices"].values()
    np.testing.assert_allclose(vertices, even.vertices(4) @ Z_UP.T, atol=1e-3)


def test_a_relative_blender_is_found_from_where_it_is_named(tmp_path, monkeypatch):
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "python").symlink_to(sys.executable)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("JAXMOCAP_BLENDER", "bin/python")
    assert blender_command()[0] == str(tmp_path / "bin" / "python")


def test_without_blender_it_says_where_one_is_looked_for(even, tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("JAXMOCAP_BLENDER", raising=False)
    with pytest.raises(InputError, match=r"Blender, which was not found; install it, or let JAXMOCAP_BLENDER name it"):
        export(even, tmp_path / "dance.fbx")
    monkeypatch.setenv("JAXMOCAP_BLENDER", str(tmp_path / "blender"))
    with pytest.raises(InputError, match="is no program"):
        export(even, tmp_path / "dance.fbx")
    monkeypatch.setenv("JAXMOCAP_BLENDER", sys.executable)  # which has no bpy of its own
    with pytest.raises(InputError, match=r"Blender could not write dance\.fbx"):
        export(even, tmp_path / "dance.fbx")
    assert not (tmp_path / "dance.fbx").exists()
