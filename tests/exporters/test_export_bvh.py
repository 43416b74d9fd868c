"""BVH exports, posed by bvhsdk."""

from dataclasses import replace

import bvhsdk
import numpy as np
import pytest

from jaxmocap.character import BODIES
from jaxmocap.exporters import export
from jaxmocap.exporters._prepare import best_order, euler_angles


def posed(path, frame: int) -> dict[str, np.ndarray]:
    """World places of all joints."""
    read = bvhsdk.ReadFile(str(path))
    return {joint.name: np.asarray(joint.getPosition(frame)) for joint in read.getlistofjoints()}


def expected(motion, frame: int) -> dict[str, np.ndarray]:
    return {body: motion.joints[frame, motion.joint_names.index(joint)] for body, _, joint in BODIES}


@pytest.mark.parametrize(("units", "factor"), [("m", 1), ("cm", 100)])
def test_the_joints_are_the_motion_s(even, tmp_path, units, factor):
    path = export(even, tmp_path / "dance.bvh", units=units)
    assert bvhsdk.ReadFile(str(path)).frametime == pytest.approx(1 / 30, abs=1e-6)
    for frame in (0, 5, 11):
        found = posed(path, frame)
        for body, place in expected(even, frame).items():
            np.testing.assert_allclose(found[body] / factor, place, atol=1e-4)


def test_a_file_with_z_up_is_the_same_motion_stood_up(even, tmp_path):
    lying = posed(export(even, tmp_path / "z.bvh", up="z"), 7)
    for body, (x, y, z) in expected(even, 7).items():
        np.testing.assert_allclose(lying[body], (x, -z, y), atol=1e-4)
    head = next(j for j in bvhsdk.ReadFile(str(tmp_path / "z.bvh")).getlistofjoints() if j.name == "head")
    assert head.offset[2] > 0.1 > abs(head.offset[1])


def test_uneven_times_become_even_ones_and_that_is_said(motion, tmp_path):
    said = []
    path = export(motion, tmp_path / "dance.bvh", say=said.append)
    read = bvhsdk.ReadFile(str(path))
    assert "interpolated to 29.94 frames per second" in said[0]
    assert read.frametime == pytest.approx(1 / 29.94, abs=1e-5)
    assert read.frames == 6


def test_another_frame_rate_lies_on_the_same_curves(even, tmp_path):
    path = export(even, tmp_path / "dance.bvh", frame_rate=60)
    assert bvhsdk.ReadFile(str(path)).frames == 23
    for frame in (0, 4):
        for body, place in expected(even, frame).items():
            np.testing.assert_allclose(posed(path, 2 * frame)[body], place, atol=1e-4)
    between = posed(path, 9)
    for body, place in expected(even, 4).items():
        middle = 0.5 * (place + expected(even, 5)[body])
        np.testing.assert_allclose(between[body], middle, atol=0.004)


def test_an_arm_whose_angles_jump_moves_smoothly(even, tmp_path):
    """The shoulder's other set of angles from frame 5 on: the same motion."""
    from jaxmocap.character import ball_joints, equivalent_angles

    angles, skeleton = even.angles.copy(), even.character.skeleton
    for place, twice in ball_joints(skeleton):
        lower, upper = (np.asarray(limit)[place] for limit in (skeleton.lower, skeleton.upper))
        angles[5:, place] = [equivalent_angles(row, twice, lower, upper) for row in angles[5:, place]]
    jumping = replace(even, angles=angles)
    path = export(jumping, tmp_path / "dance.bvh", frame_rate=120)
    plain = export(even, tmp_path / "plain.bvh", frame_rate=120)
    for frame in (18, 19, 30):
        for body, place in posed(plain, frame).items():
            np.testing.assert_allclose(posed(path, frame)[body], place, atol=1e-4)
    rows = np.array([line.split() for line in path.read_text().split("Frame Time")[1].splitlines()[1:]], float)
    assert np.abs(np.diff(rows, axis=0)[:, 3:]).max() < 20


def test_the_order_keeps_away_from_gimbal_lock_and_angles_go_on_past_half_a_turn():
    from scipy.spatial.transform import Rotation

    swing = Rotation.from_euler("ZXY", np.radians([[0, -40, 10], [30, 80, 20], [60, 89, 30]]))
    order = best_order(swing.as_matrix())
    assert np.abs(swing.as_euler(order)[:, 1]).max() < np.radians(75)
    assert best_order(swing[:1].as_matrix()) == "ZXY"
    turns = Rotation.from_euler("ZXY", np.radians([[20.0 * step, 10, 100] for step in range(40)])).as_matrix()
    angles = euler_angles(turns, "ZXY")
    np.testing.assert_allclose(np.diff(np.degrees(angles[:, 0])), 20, atol=1e-6)
    np.testing.assert_allclose(Rotation.from_euler("ZXY", angles).as_matrix(), turns, atol=1e-9)
