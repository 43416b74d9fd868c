"""GLB and BVH as Blender imports them, without a window."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from jaxmocap.character import BODIES
from jaxmocap.exporters import export

BLENDER = shutil.which("blender")
pytestmark = [pytest.mark.slow, pytest.mark.skipif(BLENDER is None, reason="Blender is not installed")]
Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def read_in_blender(path: Path, rate: int, seconds: float) -> dict:
    out = path.with_suffix(".json")
    script = Path(__file__).with_name("read_in_blender.py")
    options = [str(BLENDER), "-b", "--factory-startup", "-noaudio", "--python-exit-code", "3", "-P", str(script), "--"]
    own = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run([*options, str(path), str(rate), str(seconds), str(out)], capture_output=True, env=own)
    assert done.returncode == 0, done.stdout.decode()[-2000:] + done.stderr.decode()[-2000:]
    return json.loads(out.read_text())


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


@pytest.mark.parametrize("frame", [0, 7])
def test_blender_sees_the_joints_of_a_bvh(even, tmp_path, frame):
    found = read_in_blender(export(even, tmp_path / "dance.bvh"), 30, frame / 30)
    for body, _, joint in BODIES:
        place = even.joints[frame, even.joint_names.index(joint)]
        np.testing.assert_allclose(found["bones"][body], Z_UP @ place, atol=1e-4)
