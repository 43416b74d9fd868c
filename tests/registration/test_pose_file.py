"""Poses given by hand: the file and what it does to a pose."""

import json

import numpy as np
import pytest

from jaxmocap._results import InputError
from jaxmocap.character import pose_vector
from jaxmocap.registration import apply_overrides, read_pose_file


def write(tmp_path, text):
    path = tmp_path / "pose.json"
    path.write_text(text if isinstance(text, str) else json.dumps(text), encoding="utf-8")
    return path


def test_a_pose_file_maps_frames_to_degrees_of_freedom(tmp_path):
    path = write(tmp_path, {"0": {"root_ty": 0.1, "l_elbow_flex": 30}, "12": {"neck_axial": -5.5}, "7": {}})
    assert read_pose_file(path) == {0: {"root_ty": 0.1, "l_elbow_flex": 30.0}, 12: {"neck_axial": -5.5}, 7: {}}


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("{", r"the pose file .*pose\.json cannot be read as JSON \(Expecting property name"),
        ("[1, 2]", r"must map frames to degrees of freedom, like .*; its top level is list\.$"),
        ("3", r"its top level is int\.$"),
        ({"first": {"root_ty": 0}}, r"must map frames .*; found the entry 'first'\.$"),
        ({"-1": {"root_ty": 0}}, r"found the entry '-1'\.$"),
        ({"0.5": {}}, r"found the entry '0\.5'\.$"),
        ({"0": [1, 2]}, r"found the entry '0'\.$"),
        ({"3": {"root_ty": "high"}}, r"gives root_ty at frame 3 the value 'high'; a number is expected\.$"),
        ({"3": {"root_ty": None}}, r"gives root_ty at frame 3 the value None; a number is expected\.$"),
        ({"3": {"root_ty": True}}, r"gives root_ty at frame 3 the value True; a number is expected\.$"),
        ('{"3": {"root_ty": NaN}}', r"gives root_ty at frame 3 the value nan; a number is expected\.$"),
        ('{"3": {"root_ty": 1e999}}', r"gives root_ty at frame 3 the value inf; a number is expected\.$"),
    ],
)
def test_anything_else_is_refused_in_a_sentence(tmp_path, text, sentence):
    with pytest.raises(InputError, match=sentence):
        read_pose_file(write(tmp_path, text))


SUPERSCRIPT, HUGE = '{"\u00b2": {}}', '{"0": {"root_ty": 1' + "0" * 400 + "}}"


@pytest.mark.parametrize("text", [SUPERSCRIPT, HUGE], ids=["superscript", "huge"])
def test_numbers_that_cannot_be_converted_are_refused_in_a_sentence(tmp_path, text):
    with pytest.raises(InputError):
        read_pose_file(write(tmp_path, text))


def test_missing_and_binary_files_are_refused_in_a_sentence(tmp_path):
    with pytest.raises(InputError, match=r"nowhere\.json does not exist"):
        read_pose_file(tmp_path / "nowhere.json")
    with pytest.raises(InputError, match="does not exist"):
        read_pose_file(tmp_path)
    (tmp_path / "binary.json").write_bytes(b"\xff\xfe\x00{")
    with pytest.raises(InputError, match="cannot be read as JSON"):
        read_pose_file(tmp_path / "binary.json")


def test_overrides_set_single_degrees_of_freedom(world):
    skeleton, pose = world.character.skeleton, world.pose(0)
    values = {"root_ty": 0.9, "root_ry": 20.0, "l_elbow_flex": 30.0}
    moved, indices = apply_overrides(world.character, pose, values)
    assert [skeleton.dof_names[i] for i in indices] == list(values)
    before, after = np.asarray(pose_vector(skeleton, pose)), np.asarray(pose_vector(skeleton, moved))
    np.testing.assert_allclose(after[indices], [0.9, np.deg2rad(20), np.deg2rad(30)], atol=2e-6)
    others = np.delete(np.arange(39), indices)
    np.testing.assert_allclose(after[others], before[others], atol=2e-6)


def test_no_overrides_leave_the_pose(world):
    moved, indices = apply_overrides(world.character, world.pose(0), {})
    assert indices == []
    np.testing.assert_allclose(moved.angles, world.pose(0).angles, atol=1e-6)
    np.testing.assert_allclose(moved.root, world.pose(0).root, atol=2e-6)


def test_unknown_names_and_angles_beyond_their_limits_are_refused(world):
    with pytest.raises(
        InputError, match=r"sets 'l_wing', which is no degree of freedom; the names are root_tx, root_ty"
    ):
        apply_overrides(world.character, world.pose(0), {"l_wing": 0.0})
    skeleton = world.character.skeleton
    upper = np.rad2deg(float(skeleton.upper[skeleton.dof_names.index("l_knee_flex") - 6]))
    with pytest.raises(
        InputError, match=rf"sets l_knee_flex = {upper + 1:g} degrees, outside its limits .* to {upper:.0f}\.$"
    ):
        apply_overrides(world.character, world.pose(0), {"l_knee_flex": upper + 1})
    moved, (index,) = apply_overrides(world.character, world.pose(0), {"l_knee_flex": upper})
    np.testing.assert_allclose(moved.angles[index - 6], np.deg2rad(upper), atol=1e-5)
