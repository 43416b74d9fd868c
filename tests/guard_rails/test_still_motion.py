"""A motion that stands still, or has one frame, is scored, interpolated and exported in finite numbers."""

import csv
import json
import struct

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from box_figure import box_character

from jaxmocap.character import rest_pose
from jaxmocap.exporters import export
from jaxmocap.importers import read_motion
from jaxmocap.metrics import foot_skate, jitter, joint_errors
from jaxmocap.motion import Motion, at_times, continuous

CHARACTER = box_character()


def still(count: int) -> Motion:
    poses = jax.tree.map(lambda leaf: jnp.stack([leaf] * count), rest_pose(CHARACTER.skeleton))
    return Motion.from_poses(CHARACTER, poses, np.arange(count), np.arange(count) / 30)


@pytest.fixture(params=[1, 2, 5], ids=lambda count: f"{count} frames")
def motion(request) -> Motion:
    return still(request.param)


def test_it_is_scored(motion):
    skate, shake = foot_skate(motion), jitter(motion)
    assert shake == {"mean": 0.0, "p95": 0.0}
    assert all(value == 0.0 for value in skate.summary().values())
    errors = joint_errors(motion, motion.joints.astype(float), motion.joint_names)
    assert np.nanmax(errors.raw) == 0.0


def test_it_is_continued_and_interpolated(motion):
    same = continuous(motion)
    np.testing.assert_allclose(same.angles, motion.angles)
    between = at_times(motion, np.linspace(motion.timestamps[0], motion.timestamps[-1], len(motion)))
    assert np.isfinite(between.angles).all()
    np.testing.assert_allclose(between.joints, motion.joints, atol=1e-5)


@pytest.mark.parametrize("suffix", [".glb", ".bvh", ".c3d", ".trc", ".mot", ".csv"])
def test_it_is_exported_without_a_number_that_is_none(motion, suffix, tmp_path):
    path = tmp_path / f"still{suffix}"
    export(motion, path)
    if suffix == ".glb":
        data = path.read_bytes()
        size = struct.unpack("<I", data[12:16])[0]
        document = json.loads(data[20 : 20 + size])
        accessors = document["accessors"]
        ends = [value for accessor in accessors for end in ("min", "max") for value in accessor.get(end, ())]
        assert len(ends) > 0
        assert np.isfinite(ends).all()
    elif suffix == ".c3d":
        import ezc3d

        points = ezc3d.c3d(str(path))["data"]["points"]
        assert points.shape[2] == len(motion)
        assert np.isfinite(points[:3]).all()
    elif suffix == ".csv":
        rows = list(csv.reader(path.open()))
        assert len(rows) == len(motion) + 1
        assert "nan" not in path.read_text().lower()
    else:
        words = path.read_text().lower().split()
        assert "nan" not in words
        assert "inf" not in words
    if suffix in (".bvh", ".glb"):
        again = read_motion(path, CHARACTER)
        assert np.isfinite(again.angles).all()
