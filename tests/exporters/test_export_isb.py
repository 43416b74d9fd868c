"""ISB joint angles of poses whose angles are known, to 0.1 degrees, and the figures of a walk that is known."""

import csv
import json
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxmocap.character import Pose, angles_at_rest, build_skeleton
from jaxmocap.exporters import EXPORTERS, export, gait, isb_angles
from jaxmocap.motion import Motion
from jaxmocap.synthetic import dance, make_actor

ACTOR = make_actor()
HANGING = {f"{side}_shoulder_abd": -90.0 for side in "lr"}
"""Degrees from the neutral body, whose arms are straight out: arms hang, palms to the thighs."""


def posed(*poses: dict[str, float], root: Rotation | None = None, character=ACTOR) -> Motion:
    """Poses given by their degrees from the neutral body."""
    skeleton = character.skeleton
    angles = np.tile(-angles_at_rest(skeleton), (len(poses), 1))
    for row, pose in zip(angles, poses, strict=True):
        for name, degrees in pose.items():
            row[skeleton.angle_names.index(name)] += np.radians(degrees)
    roots = np.tile(np.eye(4), (len(poses), 1, 1))
    roots[:, :3, :3] = np.eye(3) if root is None else root.as_matrix()
    stacked = Pose(jnp.asarray(roots, jnp.float32), jnp.asarray(angles, jnp.float32))
    return Motion.from_poses(character, stacked, np.arange(len(poses)), np.arange(len(poses)) / 30)


def angles_of(motion: Motion, frame: int = 0) -> dict[str, float]:
    found = isb_angles(motion)
    return dict(zip(found.names, found.degrees[frame], strict=True))


def test_the_anatomical_position_has_no_angle_but_those_of_pronation():
    """Arms of the hanging pose are a quarter turn short of palms forward."""
    for name, degrees in angles_of(posed(HANGING)).items():
        if "shoulder_plane" in name or "shoulder_internal" in name or name.startswith("pelvis_rotation"):
            continue  # of a hanging arm only the sum of both is known
        expected = 90.0 if name.endswith("pronation") else 0.0
        assert degrees == pytest.approx(expected, abs=0.1), name


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"hip_flex": 40}, {"hip_flexion": 40}),
        ({"hip_abd": 25}, {"hip_adduction": -25}),
        ({"hip_flex": 40, "hip_abd": 25, "hip_int": 15}, {"hip_flexion": 40, "hip_adduction": -25}),
        ({"hip_int": 15}, {"hip_internal_rotation": 15}),
        ({"knee_flex": 70}, {"knee_flexion": 70, "knee_adduction": 0, "knee_internal_rotation": 0}),
        ({"ankle_dorsi": -30}, {"ankle_dorsiflexion": -30}),
        ({"ankle_inv": 20}, {"ankle_inversion": 20, "ankle_dorsiflexion": 0}),
        ({"shoulder_abd": 45}, {"shoulder_elevation": 45, "shoulder_plane_of_elevation": 0}),
        ({"shoulder_flex": 60}, {"shoulder_elevation": 60, "shoulder_plane_of_elevation": 90}),
        ({"shoulder_flex": 60}, {"shoulder_internal_rotation": -90}),
        ({"shoulder_abd": 45, "shoulder_axial": 30}, {"shoulder_internal_rotation": 30}),
        ({"elbow_flex": 100}, {"elbow_flexion": 100, "elbow_carrying_angle": 0, "elbow_pronation": 90}),
        ({"elbow_flex": 50, "forearm_pron": -90}, {"elbow_flexion": 50, "elbow_pronation": 0}),
        ({"forearm_pron": 60}, {"elbow_pronation": 150}),
    ],
)
def test_a_limb_s_known_angles_come_back_on_both_sides_with_the_same_sign(given, expected):
    for side in "lr":
        pose = HANGING | {f"{side}_{name}": HANGING.get(f"{side}_{name}", 0) + value for name, value in given.items()}
        found = angles_of(posed(pose, root=Rotation.from_euler("yx", [40, 10], degrees=True)))
        for name, value in expected.items():
            assert found[f"{side}_{name}"] == pytest.approx(value, abs=0.1), (side, name)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"lumbar_flex": 30}, {"thorax_extension": -30, "thorax_lateral_bend": 0, "thorax_rotation": 0}),
        ({"lumbar_flex": 20, "thorax_flex": 15}, {"thorax_extension": -35}),
        ({"lumbar_lat": 15}, {"thorax_lateral_bend": 15, "thorax_rotation": 0}),
        ({"lumbar_axial": 25}, {"thorax_rotation": 25}),
        ({"neck_flex": 20}, {"neck_extension": -20}),
        ({"neck_axial": -50}, {"neck_rotation": -50}),
    ],
)
def test_the_trunk_s_known_angles_come_back(given, expected):
    found = angles_of(posed(HANGING | given))
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, abs=0.1), name


def test_the_pelvis_turns_in_the_laboratory():
    """At rest the actor faces z, which is a quarter turn to the right of x."""
    for rotation, obliquity, tilt in ((0, 0, 0), (30, 10, 20), (-120, -5, -15)):
        about = Rotation.from_euler("YXZ", [rotation, -obliquity, -tilt], degrees=True)
        turn = about * Rotation.from_euler("y", 90, degrees=True)  # from facing z to facing x, as the laboratory does
        found = angles_of(posed(HANGING, root=turn))
        assert found["pelvis_rotation"] == pytest.approx(rotation, abs=0.1)
        assert found["pelvis_obliquity"] == pytest.approx(obliquity, abs=0.1)
        assert found["pelvis_tilt"] == pytest.approx(tilt, abs=0.1)


def test_a_wrist_that_bends_has_angles_and_one_that_does_not_has_none():
    places = dict(zip(ACTOR.skeleton.landmark_names, np.asarray(ACTOR.skeleton.landmarks), strict=True))
    bending = replace(ACTOR, skeleton=build_skeleton(places, "wrist7"))
    for name, isb in (("wrist_flex", "wrist_flexion"), ("wrist_dev", "wrist_ulnar_deviation")):
        for side in "lr":
            found = angles_of(posed(HANGING | {f"{side}_{name}": 20, f"{side}_forearm_pron": 30}, character=bending))
            assert found[f"{side}_{isb}"] == pytest.approx(20, abs=0.1), (side, name)
            assert found[f"{side}_elbow_pronation"] == pytest.approx(120, abs=0.1)
    assert not any("wrist" in name for name in isb_angles(posed(HANGING)).names)


def test_an_arm_that_swings_past_hanging_and_a_body_that_turns_twice_make_no_jumps():
    swing = np.radians(40) * np.sin(np.linspace(0, 4 * np.pi, 120))
    poses = [HANGING | {"l_shoulder_flex": float(np.degrees(value))} for value in swing]
    motion = posed(*poses)
    turns = Rotation.from_euler("y", np.linspace(0, 4 * np.pi, 120)[:, None]).as_matrix()
    root = np.array(motion.root)
    root[:, :3, :3] = turns
    motion = replace(motion, root=root)
    found = isb_angles(motion)
    assert np.abs(np.diff(found.degrees, axis=0)).max() < 15
    elevation = found.degrees[:, found.names.index("l_shoulder_elevation")]
    np.testing.assert_allclose(np.abs(elevation), np.degrees(np.abs(swing)), atol=0.1)
    rotation = found.degrees[:, found.names.index("pelvis_rotation")]
    assert np.ptp(rotation) == pytest.approx(720, abs=0.1)


def test_deviations_are_those_the_places_leave():
    """Joints a centimetre off: a knee is known to a degree or two. How the bone of a straight arm turns, or a hand, no
    joint tells; how that of a bent one does, the wrist."""
    arm = HANGING | {"l_shoulder_abd": -40, "l_knee_flex": 80}
    motion = posed(arm | {"l_elbow_flex": 90}, arm | {"l_elbow_flex": 1})
    one, ten = (
        isb_angles(replace(motion, covariance=np.broadcast_to(metres**2 * np.eye(3), (*motion.joints.shape, 3))))
        for metres in (0.001, 0.01)
    )
    bent, straight = (dict(zip(ten.names, row, strict=True)) for row in ten.deviations)
    at = dict(zip(motion.joint_names, motion.joints[0].astype(float), strict=True))
    bone = np.linalg.norm(at["l_ankle"] - at["l_knee"])
    assert 0.2 * np.degrees(0.01 / bone) < bent["l_knee_flexion"] < 3 * np.degrees(0.01 / bone)
    assert bent["l_shoulder_internal_rotation"] < 5
    assert straight["l_shoulder_internal_rotation"] > 30
    assert straight["l_elbow_pronation"] == pytest.approx(np.degrees(0.8), rel=0.02)  # as free as it is
    assert np.isnan([bent["l_knee_adduction"], bent["l_ankle_internal_rotation"]]).all()  # no joint of ours does that
    knee = one.names.index("r_knee_flexion")
    assert ten.deviations[0, knee] == pytest.approx(10 * one.deviations[0, knee], rel=0.05)


def test_the_files_say_how_angles_are_defined(even, tmp_path):
    covariance = np.broadcast_to(1e-4 * np.eye(3), (*even.joints.shape, 3))
    text = export(replace(even, covariance=covariance), tmp_path / "dance.isb.csv").read_text()
    notes, lines = ([line for line in text.splitlines() if line.startswith("#") == noted] for noted in (True, False))
    assert any("l_knee: l_shank in l_thigh, Z-X-Y: flexion (-Z) + shank backwards" in line for line in notes)
    assert any("palms forward" in line for line in notes)
    rows, found = list(csv.DictReader(lines)), isb_angles(even)
    assert len(rows) == len(even)
    knee = found.names.index("l_knee_flexion")
    np.testing.assert_allclose([float(row["l_knee_flexion_deg"]) for row in rows], found.degrees[:, knee], atol=1e-3)
    joints = [even.joint_names.index(f"l_{name}") for name in ("hip", "knee", "ankle")]
    shown = [float(row["l_knee_flexion_confidence"]) for row in rows]
    np.testing.assert_allclose(shown, even.confidence[:, joints].min(axis=1), atol=1e-3)
    assert all(0 < float(row["l_knee_flexion_sd_deg"]) < 10 for row in rows)
    head, body = export(even, tmp_path / "dance.isb.mot").read_text().split("endheader\n")
    assert "Wu 2005, thorax to humerus" in head
    names, *table = (line.split("\t") for line in body.splitlines())
    assert names == ["time", *found.names]
    np.testing.assert_allclose(np.array(table, float)[:, 1:], found.degrees, atol=1e-5)


STRIDE, STANCE, SPEED, LATE = 1.1, 0.62, 1.2, 0.5
"""Seconds, share, m/s, and by how much of a stride the right foot is late."""


def walking(seconds: float = 6.0, fps: float = 30.0, noise: float = 0.003) -> Motion:
    """Feet that stand and swing at known times beneath a pelvis of even speed, along a diagonal, some noise."""
    times = np.arange(int(seconds * fps)) / fps
    motion = Motion.from_poses(ACTOR, dance(ACTOR.skeleton, times), np.arange(len(times)), times)
    fine = np.linspace(0, 1, 201)
    swing = np.cumsum(np.clip(np.minimum(fine, 1 - fine) / 0.08, 0, 1))
    swing /= swing[-1]
    way, across = np.array([0.6, 0, 0.8]), np.array([0.8, 0, -0.6])
    joints = np.array(motion.joints, np.float64)
    at = {name: motion.joint_names.index(name) for name in motion.joint_names}
    joints[:, at["pelvis"]] = SPEED * times[:, None] * way + [0, 0.95, 0]
    for side, late, offset in (("l", 0.0, 0.08), ("r", LATE, -0.08)):
        phase = times / STRIDE - late  # a whole number where the foot strikes
        done, part = np.floor(phase), phase % 1
        swung = np.interp((part - STANCE) / (1 - STANCE), fine, swing)
        heel = SPEED * STRIDE * (done + late + swung + 0.5 * STANCE)
        for name, ahead in (("heel", -0.08), ("toe", 0.12)):
            place = (heel + ahead)[:, None] * way + offset * across
            joints[:, at[f"{side}_{name}"]] = place
    joints += np.random.default_rng(0).normal(0, noise, joints.shape)
    return replace(motion, joints=joints)


def test_a_walk_s_known_figures_come_back():
    motion = walking()
    found = gait(motion)
    told = found.summary()
    assert told["strides"] >= 6
    assert told["duration"]["mean"] == pytest.approx(STRIDE, abs=0.02)
    assert told["cadence"] == pytest.approx(120 / STRIDE, abs=2)
    assert told["length"]["mean"] == pytest.approx(SPEED * STRIDE, abs=0.03)
    assert told["speed"]["mean"] == pytest.approx(SPEED, abs=0.03)
    assert told["step_width"]["mean"] == pytest.approx(0.16, abs=0.02)
    assert told["stance"]["mean"] == pytest.approx(STANCE, abs=0.05)
    assert told["double_support"]["mean"] == pytest.approx(2 * STANCE - 1, abs=0.1)
    assert told["step_length"]["mean"] == pytest.approx(SPEED * STRIDE / 2, abs=0.05)
    for event in found.events:
        phase = event.seconds / STRIDE - (LATE if event.foot == "right" else 0.0)
        off = (phase - (STANCE if event.kind == "off" else 0.0) + 0.5) % 1 - 0.5
        assert abs(off * STRIDE) < 0.05
    for foot, intervals in found.contact.items():
        assert len(intervals) >= 3, foot
        assert [end - start for start, end in intervals] == pytest.approx([STANCE * STRIDE] * len(intervals), abs=0.08)


def test_the_walk_s_figures_are_written_and_a_dance_in_place_has_none(even, tmp_path):
    told = json.loads(export(walking(4.0), tmp_path / "walk.gait.json").read_text())
    assert told["summary"]["strides"] == len(told["strides"]) > 2
    assert {event["kind"] for event in told["events"]} == {"strike", "off"}
    assert "Zeni" in told["method"]
    said = []
    told = json.loads(export(even, tmp_path / "dance.gait.json", say=said.append).read_text())
    assert (told["summary"], told["strides"], told["events"]) == ({}, [], [])
    assert "no stride was found" in said[0]
    assert {".isb.csv", ".isb.mot", ".gait.json"} <= EXPORTERS.keys()


def test_somebody_who_stands_still_has_no_stride(tmp_path):
    motion = walking(2.0)
    still = replace(motion, joints=np.repeat(motion.joints[:1], len(motion), axis=0))
    told = json.loads(export(still, tmp_path / "still.gait.json").read_text())
    assert (told["summary"], told["strides"]) == ({}, [])


def test_no_stride_goes_over_frames_that_are_missing():
    whole = walking(8.0)
    found = gait(whole[np.flatnonzero((whole.timestamps < 3.0) | (whole.timestamps > 4.6))])
    assert 4 <= len(found.strides) < len(gait(whole).strides)
    assert found.summary()["length"]["mean"] == pytest.approx(SPEED * STRIDE, abs=0.05)
    for stride in found.strides:
        assert stride.duration == pytest.approx(STRIDE, abs=0.1)
        assert stride.start + stride.duration < 3.1 or stride.start > 4.5
    for start, end in (interval for intervals in found.contact.values() for interval in intervals):
        assert end < 3.1 or start > 4.5


def test_strides_in_doubtful_or_lost_frames_say_so_and_are_left_out_of_the_means():
    """The feet go astray at 2 to 3 s, and the right one is lost a while later."""
    sound = walking(8.0)
    joints, status, confidence = np.array(sound.joints), np.array(sound.status, "U8"), np.array(sound.confidence)
    astray = (sound.timestamps > 2) & (sound.timestamps < 3)
    heels = [sound.joint_names.index(f"{side}_heel") for side in "lr"]
    joints[np.ix_(astray, heels)] += [0, 0, 0.25]
    status[astray], confidence[astray] = "doubtful", 0.3
    hidden = (sound.timestamps > 5) & (sound.timestamps < 5.2)
    confidence[hidden, heels[1]] = 0
    motion = replace(sound, joints=joints, status=status, confidence=confidence)
    found = gait(motion)
    expected = {(False, 0.3): 0, (False, 0.0): 0, (True, 1.0): 0}
    for stride in found.strides:
        frames = (motion.timestamps >= stride.start) & (motion.timestamps <= stride.start + stride.duration)
        bad = [bool((frames & where).any()) for where in (astray, hidden)]
        expected[not any(bad), 0.0 if bad[1] else 0.3 if bad[0] else 1.0] += 1
        assert stride.trusted == (not any(bad))
        assert stride.confidence == pytest.approx(0.0 if bad[1] else 0.3 if bad[0] else 1.0)
    assert min(expected.values()) > 0, expected
    told = found.summary()
    assert told["strides"] + told["left_out"] == len(found.strides)
    assert told["strides"] == expected[True, 1.0]
    assert told["confidence"] == 1
    assert told["length"]["mean"] == pytest.approx(SPEED * STRIDE, abs=0.03)
    nothing = gait(replace(motion, status=np.full(len(motion), "doubtful"))).summary()
    assert nothing == {"strides": 0, "left_out": len(found.strides)}


def test_a_stride_s_deviations_are_those_of_the_heels():
    motion = walking()
    assert all(np.isnan(stride.length_sd) for stride in gait(motion).strides)
    way, across = np.array([0.6, 0, 0.8]), np.array([0.8, 0, -0.6])
    spread = 0.02**2 * np.outer(way, way) + 0.01**2 * np.outer(across, across) + 0.5**2 * np.diag([0, 1, 0])
    known = replace(motion, covariance=np.broadcast_to(spread, (*motion.joints.shape[:2], 3, 3)))
    for stride in gait(known).strides:
        assert stride.length_sd == pytest.approx(0.02 * np.sqrt(2), rel=0.03)
        assert stride.step_length_sd == pytest.approx(0.02 * np.sqrt(2), rel=0.03)
        assert stride.step_width_sd == pytest.approx(0.01 * np.sqrt(2), rel=0.1)
