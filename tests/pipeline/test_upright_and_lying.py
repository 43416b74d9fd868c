"""Tracking with one phone held upright and one lying, from the capture folder to the result."""

import shutil
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap.camera import write_colmap_text
from jaxmocap.capture import Capture, index_video
from jaxmocap.pipeline import track_capture
from jaxmocap.synthetic import make_capture, write_capture

LYING, UPRIGHT, NEAR = (320, 180), (180, 320), 0.75


@pytest.fixture(scope="module")
def mixed(tmp_path_factory) -> Path:
    """A dancer of two films: cam0 lies, and the upright cam1 has her taller than cam0's picture is high."""
    folder = tmp_path_factory.mktemp("mixed")
    lying = make_capture(5, LYING, seed=3)
    wide = float(lying.cameras.intrinsics[0, 0, 0]) / UPRIGHT[0]
    upright = make_capture(5, UPRIGHT, seed=3, focal_per_width=wide, body_fraction=NEAR)
    made, other = write_capture(lying, folder / "mixed"), write_capture(upright, folder / "other")
    for file in (other / "cam1.mp4", *other.glob("keypoints/cam1*"), *other.glob("masks/cam1*")):
        shutil.copy(file, made / file.relative_to(other))
    pairs = [(lying.cameras, 0), (upright.cameras, 1)]
    cameras = replace(
        lying.cameras,
        sizes=(LYING, UPRIGHT),
        intrinsics=jnp.stack([one.intrinsics[n] for one, n in pairs]),
        cam_from_world=jnp.stack([one.cam_from_world[n] for one, n in pairs]),
    )
    shutil.rmtree(made / "cameras")
    write_colmap_text(cameras, made / "cameras")
    return made


@pytest.mark.slow
def test_the_whole_person_is_tracked_and_the_result_is_as_filmed(mixed, tmp_path):
    motion = track_capture(mixed, tmp_path / "result", quality="draft", cache=False)
    with np.load(mixed / "truth.npz") as truth:
        names, joints = truth["joint_names"].tolist(), truth["joints"]
    error = np.linalg.norm(motion.joints - joints[:, [names.index(name) for name in motion.joint_names]], axis=-1)
    assert error.mean() < 0.0105  # 0.0115 where her feet are out of what both pictures have in common
    assert error[:, [motion.joint_names.index(f"{side}_ankle") for side in "lr"]].max() < 0.03
    filmed = Capture.open(mixed).cameras
    assert motion.cameras is not None
    assert motion.cameras.sizes == filmed.sizes == (LYING, UPRIGHT)
    np.testing.assert_array_equal(motion.cameras.cam_from_world, filmed.cam_from_world)
    assert [index_video(tmp_path / "result" / f"overlay_cam{n}.mp4").size for n in (0, 1)] == [LYING, UPRIGHT]
