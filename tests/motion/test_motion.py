import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from box_figure import box_character, box_motion

from jaxmocap._results import InputError
from jaxmocap.camera import Cameras
from jaxmocap.character import Pose, landmark_positions, rest_pose, retract, skin
from jaxmocap.motion import Motion, at_times, cameras_at, continuous, turned


@pytest.fixture(scope="module")
def character():
    return box_character()


@pytest.fixture
def motion(character):
    rng = np.random.default_rng(1)
    cameras = Cameras(
        names=("a", "b"),
        sizes=((64, 48), (48, 64)),
        intrinsics=jnp.asarray(rng.random((2, 3, 3)), jnp.float32),
        distortion=jnp.asarray(rng.random((2, 5)), jnp.float32),
        cam_from_world=jnp.asarray(rng.random((2, 6, 4, 4)), jnp.float32),
    )
    return box_motion(
        character,
        status=["ok", "ok", "doubtful", "lost", "ok", "ok"],
        energy={"view_view": np.arange(6.0), "model_view": np.array([0.1, np.nan, 0.3, 0.4, 0.5, 0.6])},
        provenance={"seed": 7, "settings": {"lambda": np.float32(0.5)}, "capture": "Straße"},
        cameras=cameras,
        up="z",
    )


ARRAYS = ("root", "angles", "frames", "timestamps", "joints", "confidence", "status")


def test_saving_and_loading_keeps_every_bit(motion, tmp_path):
    motion.save(tmp_path / "result")
    loaded = Motion.load(tmp_path / "result")
    for name in ARRAYS:
        ours, theirs = getattr(motion, name), getattr(loaded, name)
        assert ours.dtype == theirs.dtype, name
        assert ours.tobytes() == theirs.tobytes(), name
    assert list(loaded.energy) == ["model_view", "view_view"]
    for name, values in motion.energy.items():
        assert values.tobytes() == loaded.energy[name].tobytes()
    before, after = (jax.tree.flatten((m.character, m.cameras)) for m in (motion, loaded))
    assert before[1] == after[1]
    for ours, theirs in zip(before[0], after[0], strict=True):
        assert ours.dtype == theirs.dtype
        assert np.array_equal(ours, theirs)
    assert loaded.provenance == {"seed": 7, "settings": {"lambda": 0.5}, "capture": "Straße"}
    assert loaded.up == "z"
    assert np.array_equal(loaded.vertices(3), motion.vertices(3))


def test_saving_the_same_motion_twice_gives_the_same_bytes(motion, tmp_path):
    for name in "ab":
        motion.save(tmp_path / name)
    assert (tmp_path / "a/motion.npz").read_bytes() == (tmp_path / "b/motion.npz").read_bytes()


def test_numpy_alone_can_pose_the_mesh_from_the_file(motion, character, tmp_path):
    motion.save(tmp_path)
    with np.load(tmp_path / "motion.npz", allow_pickle=False) as stored:
        assert stored["pose"].shape == (6, 39) == (6, len(stored["dof_names"]))
        rebuilt = retract(character.skeleton, rest_pose(character.skeleton), jnp.asarray(stored["pose"][2]))
        assert stored["joints"].shape[1] == len(stored["joint_names"]) == stored["confidence"].shape[1]
        assert sorted(stored["energy_terms"]) == ["model_view", "view_view"]
    assert np.allclose(rebuilt.root, motion.root[2], atol=1e-5)
    assert np.allclose(skin(character, rebuilt), motion.vertices(2), atol=1e-5)


def test_report_tells_the_verdict_of_every_frame(motion, tmp_path):
    motion.save(tmp_path)
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["lost_frames"] == 1
    assert report["doubtful_frames"] == 1
    assert [verdict["status"] for verdict in report["verdicts"]] == motion.status.tolist()
    assert report["verdicts"][1]["energy"] == {"model_view": None, "view_view": 1.0}
    assert report["provenance"]["seed"] == 7


def test_vertices_and_joints_are_those_of_the_pose(motion, character):
    pose = motion.pose(4)
    assert np.allclose(motion.vertices(4), skin(character, pose), atol=1e-6)
    assert np.allclose(motion.joints[4], landmark_positions(character.skeleton, pose), atol=1e-6)
    assert np.allclose(motion.body_transforms[4, 0], pose.root, atol=1e-5)


def test_slicing_keeps_rows_together(motion):
    for part, rows in ((motion[1:4], [1, 2, 3]), (motion[motion.status == "ok"], [0, 1, 4, 5])):
        assert part.frames.tolist() == rows
        assert np.array_equal(part.joints, motion.joints[rows])
        assert np.array_equal(part.energy["view_view"], np.float32(rows))
        assert np.array_equal(part.cameras.cam_from_world, motion.cameras.cam_from_world[:, np.array(rows)])


def test_cameras_at_takes_positions_and_refuses_others(motion):
    assert np.array_equal(cameras_at(motion.cameras, [4, 5]).cam_from_world, motion.cameras.cam_from_world[:, 4:])
    with pytest.raises(InputError, match="Frame 6 has no camera pose"):
        cameras_at(motion.cameras, [5, 6])


def test_arrays_cannot_be_changed(motion):
    with pytest.raises(ValueError, match="read-only"):
        motion.root[0] = 0


def _with(motion, name, row, value):
    values = getattr(motion, name).copy()
    values[row] = value
    return {name: values}


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda m: _with(m, "root", 2, np.nan), r"root holds a number that is not finite, at \(2, 0, 0\)"),
        (lambda m: _with(m, "angles", 1, np.inf), "angles holds a number that is not finite"),
        (lambda m: _with(m, "root", 3, 2 * np.eye(4)), "root at frame 3 is not a rigid transform"),
        (lambda m: _with(m, "timestamps", 3, 0.0), "timestamps do not increase"),
        (lambda m: _with(m, "frames", 1, 0), "frames do not increase"),
        (lambda m: {"status": np.full(6, "fine")}, "status holds 'fine'; one of ok, doubtful, lost"),
        (lambda m: {"angles": m.angles[:5]}, r"angles has shape \(5, 33\); \(6, 33\) was expected"),
        (lambda m: {"energy": {"smooth": np.zeros(4)}}, r"energy_smooth has shape \(4,\)"),
        (lambda m: {"cameras": cameras_at(m.cameras, [0, 1])}, "cam_from_world has shape"),
        (lambda m: {"up": "w"}, "vertical axis is 'w'"),
    ],
)
def test_impossible_motions_are_refused_in_a_sentence(motion, change, sentence):
    with pytest.raises(InputError, match=sentence):
        replace(motion, **change(motion))


def test_a_motion_needs_a_frame(character):
    none = Pose(root=jnp.zeros((0, 4, 4)), angles=jnp.zeros((0, 33)))
    with pytest.raises(InputError, match="at least one frame"):
        Motion.from_poses(character, none, [], [])


def test_contacts_are_those_of_the_frames_that_are_left(motion, tmp_path):
    spans = [{"landmark": "l_heel", "first": 1, "last": 3}, {"landmark": "r_toe", "first": 5, "last": 5}]
    spans.append({"landmark": "l_toe", "first": 3, "last": 4})
    standing = replace(motion, provenance={"contacts": spans})
    for kept in (standing, Motion.load(standing.save(tmp_path)), turned(standing, "y"), continuous(standing)):
        assert kept.contacts == (("l_heel", 1, 3), ("r_toe", 5, 5), ("l_toe", 3, 4))
    assert kept.contacts[0].landmark == "l_heel"
    assert kept.foot_contact.T.tolist() == [[0, 1, 1, 1, 1, 0], [0, 0, 0, 0, 0, 1]]
    assert standing[2:5].contacts == (("l_heel", 2, 3), ("l_toe", 3, 4))
    assert standing[[0, 2, 4]].contacts == (("l_heel", 2, 2), ("l_toe", 4, 4))
    assert standing[:1].contacts == ()
    assert not standing[:1].foot_contact.any()


def test_contacts_that_were_not_looked_for_are_not_none_found(motion, tmp_path):
    """Nor are those of results written before contacts were known, whose provenance lacks them."""
    none_found, not_looked_for = (replace(motion, provenance={"contacts": told}, cameras=None) for told in ([], None))
    times = motion.timestamps[0] + np.arange(11) / 60
    older = replace(motion, cameras=None)
    for name, one in {"found": none_found, "looked for": not_looked_for, "older": older}.items():
        kept = Motion.load(one.save(tmp_path / name))
        for each in (one, kept, kept[1:3], at_times(kept, times)):
            assert each.contacts == (() if one is none_found else None)
            assert (each.foot_contact is None) == (one is not none_found)
    assert not none_found.foot_contact.any()
    assert json.loads((tmp_path / "looked for" / "report.json").read_text())["provenance"]["contacts"] is None


def test_contacts_at_other_times_begin_and_end_when_they_did(motion):
    spans = [{"landmark": "l_heel", "first": 1, "last": 3}, {"landmark": "r_toe", "first": 4, "last": 4}]
    standing = replace(motion, provenance={"contacts": spans, "seed": 7}, cameras=None)
    begin = standing.timestamps[0]
    finer = at_times(standing, begin + np.arange(11) / 60)
    assert finer.contacts == (("l_heel", 2, 6), ("r_toe", 8, 8))
    assert finer.provenance["seed"] == 7
    assert at_times(standing, begin + np.arange(4) / 20).contacts == (("l_heel", 1, 2),)  # none falls into 4 / 30 s
    assert at_times(standing[4:], standing.timestamps[4:]).contacts == (("r_toe", 0, 0),)
    assert at_times(standing[[0, 5]], standing.timestamps[[0, 5]]).contacts == ()
    assert "contacts" not in at_times(replace(motion, cameras=None), standing.timestamps).provenance


def test_a_single_frame_is_shown_at_its_time_and_at_no_others(motion):
    one = replace(motion, cameras=None)[[2]]
    assert at_times(one, one.timestamps).frames.tolist() == [0]
    with pytest.raises(InputError, match=r"has one frame, at .* 3 times cannot be interpolated"):
        at_times(one, np.repeat(one.timestamps, 3))


def test_what_lies_between_a_lost_frame_and_the_next_is_not_trusted(motion):
    spans = [{"part": "left arm", "first": 5, "last": 5, "why": "hidden"}]
    risks = {"frames": motion.frames.tolist(), "frame": [0.0] * 6}
    lost = replace(motion, provenance={"lost": spans, "risks": risks}, status=np.full(6, "ok"), cameras=None)
    finer = at_times(lost, lost.timestamps[0] + np.arange(11) / 60)
    assert finer.trusted.tolist() == [True] * 9 + [False] * 2
    assert at_times(lost, lost.timestamps[:4]).provenance == {"lost": []}
