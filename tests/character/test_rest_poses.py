"""`build_skeleton` finds the same anatomical axes whatever pose the mesh was made in."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap._results import InputError
from jaxmocap.character import Pose, build_skeleton, landmark_positions, rest_pose
from jaxmocap.character._kinematics import chain

REQUIRED = ["pelvis", "neck"] + [
    f"{s}_{j}" for s in "lr" for j in ["shoulder", "elbow", "wrist", "hip", "knee", "ankle"]
]


def t_pose() -> dict[str, np.ndarray]:
    joints = {"pelvis": (0, 0.95, 0), "spine": (0, 1.05, 0), "thorax": (0, 1.2, 0), "neck": (0, 1.48, 0)}
    for side, sign in (("l", 1), ("r", -1)):
        joints |= {f"{side}_clavicle": (0.03 * sign, 1.44, 0.05), f"{side}_shoulder": (0.18 * sign, 1.42, 0)}
        joints |= {f"{side}_elbow": (0.46 * sign, 1.42, 0), f"{side}_wrist": (0.71 * sign, 1.42, 0)}
        joints |= {f"{side}_hip": (0.1 * sign, 0.9, 0), f"{side}_knee": (0.1 * sign, 0.5, 0)}
        joints |= {f"{side}_ankle": (0.1 * sign, 0.08, 0)}
    return {name: np.array(place, float) for name, place in joints.items()}


def bent(skeleton, degrees: dict[str, float]) -> Pose:
    angles = np.zeros(33)
    for name, value in degrees.items():
        for side in "lr":
            angles[skeleton.dof_names.index(f"{side}_{name}") - 6] = np.radians(value)
    return Pose(rest_pose(skeleton).root, jnp.asarray(angles))


POSES = {
    "A-pose": {"shoulder_abd": -45},
    "hanging": {"shoulder_flex": 5, "shoulder_abd": -85},
    "elbows bent forward": {"shoulder_flex": 3, "shoulder_abd": -50, "shoulder_axial": 8, "elbow_flex": 46},
    "elbows bent, palms turned": {"shoulder_flex": -10, "shoulder_abd": -40, "shoulder_axial": -60, "elbow_flex": 80},
    "arms raised": {"shoulder_abd": 60, "elbow_flex": 30},
    "arms forward": {"shoulder_flex": 85, "shoulder_abd": -60, "elbow_flex": 25},
    "legs apart": {"hip_abd": 20, "hip_flex": 8},
    "sitting": {
        "hip_flex": 70,
        "hip_abd": 12,
        "hip_int": 15,
        "knee_flex": 60,
        "shoulder_abd": -70,
        "shoulder_flex": 20,
    },
}


@pytest.mark.parametrize("name", POSES)
def test_axes_and_limits_built_in_any_rest_pose_are_those_of_the_t_pose_carried_there(name):
    neutral = build_skeleton(t_pose())
    pose = bent(neutral, POSES[name])
    places = dict(zip(neutral.landmark_names, np.asarray(landmark_positions(neutral, pose)), strict=True))
    kept = {joint: place for joint, place in places.items() if joint in t_pose()}
    built = build_skeleton(kept)
    carried = np.einsum("dij,dj->di", chain(neutral, pose).before_rotations, neutral.axes)
    feet = ["ankle_dorsi", "ankle_inv"]  # feet stay flat in a new rest pose, here they turned with the shank
    compared = [i for i, dof in enumerate(neutral.dof_names[6:]) if dof[2:] not in feet]
    np.testing.assert_allclose(np.asarray(built.axes)[compared], carried[compared], atol=2e-5)
    limits = np.asarray(neutral.lower - pose.angles)
    slack = np.radians(5)
    np.testing.assert_allclose(
        np.asarray(built.lower)[compared], np.minimum(limits, -slack)[compared], atol=1e-4, err_msg=name
    )
    limits = np.asarray(neutral.upper - pose.angles)
    np.testing.assert_allclose(np.asarray(built.upper)[compared], np.maximum(limits, slack)[compared], atol=1e-4)


def test_t_pose_axes_are_the_table_itself():
    skeleton = build_skeleton(t_pose())
    axes = dict(zip(skeleton.dof_names[6:], np.asarray(skeleton.axes), strict=True))
    for name, axis in {
        "lumbar_flex": (1, 0, 0),
        "l_clav_protract": (0, -1, 0),
        "r_clav_protract": (0, 1, 0),
        "l_shoulder_flex": (-1, 0, 0),
        "r_shoulder_abd": (0, 0, -1),
        "l_elbow_flex": (0, -1, 0),
        "r_elbow_flex": (0, 1, 0),
        "l_hip_int": (0, -1, 0),
        "r_ankle_inv": (0, 0, 1),
    }.items():
        np.testing.assert_allclose(axes[name], axis, atol=1e-6, err_msg=name)


@pytest.mark.parametrize("arm", ["cmu7", "wrist7"])
def test_groups_are_root_torso_and_four_limbs_of_39(arm):
    skeleton = build_skeleton(t_pose(), arm=arm)
    sizes = {name: len(members) for name, members in skeleton.groups}
    assert sizes == {"root": 6, "torso": 7, "l_arm": 7, "r_arm": 7, "l_leg": 6, "r_leg": 6}
    assert [i for _, members in skeleton.groups for i in members] == list(range(39))
    assert all(parent < body for body, parent in enumerate(skeleton.parents))


def test_wrist7_flexes_the_wrist_towards_the_palm_and_has_no_clavicle():
    skeleton = build_skeleton(t_pose(), arm="wrist7")
    assert not any("clav" in name for name in skeleton.dof_names)
    axes = dict(zip(skeleton.dof_names[6:], np.asarray(skeleton.axes), strict=True))
    hand = np.array([1.0, 0, 0])
    assert np.cross(axes["l_wrist_flex"], hand)[1] == pytest.approx(-1)  # palms face down in T-pose
    assert np.cross(axes["r_wrist_flex"], -hand)[1] == pytest.approx(-1)
    assert np.cross(axes["l_wrist_dev"], hand)[2] == pytest.approx(-1)  # the little finger is behind
    assert np.cross(axes["r_wrist_dev"], -hand)[2] == pytest.approx(-1)


def test_missing_joints_are_placed_between_their_neighbours():
    joints = {name: place for name, place in t_pose().items() if name in REQUIRED}
    skeleton = build_skeleton(joints)
    heights = [float(skeleton.landmark(name)[1]) for name in ("pelvis", "spine", "thorax", "neck", "head")]
    assert heights == sorted(heights)
    clavicle = np.asarray(skeleton.landmark("l_clavicle"))
    assert 0.015 < clavicle[0] < 0.035
    assert 1.42 < clavicle[1] < 1.48
    assert clavicle[2] > 0.02


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"l_elbow": None}, "lacks the joints l_elbow"),
        ({"l_elbow": np.array([np.nan, 0, 0])}, "three finite numbers"),
        ({"l_elbow": t_pose()["l_shoulder"]}, "closer than 1 mm"),
    ],
)
def test_unusable_joints_are_refused_by_name(change, words):
    joints = {name: place for name, place in {**t_pose(), **change}.items() if place is not None}
    with pytest.raises(InputError, match=words):
        build_skeleton(joints)


def test_unknown_arm_layout_is_refused():
    with pytest.raises(InputError, match="cmu7, wrist7"):
        build_skeleton(t_pose(), arm="tentacle")
