"""Each degree of freedom turns the way the table says, on the box figure (T-pose) and on the actor (A-pose)."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap.character import Pose, landmark_positions, pose_from_vector, rest_pose, skin

X, Y, Z = np.eye(3)
FLEX = ("lumbar_flex", "thorax_flex")


@pytest.fixture(scope="module", params=["box_figure", "actor"])
def character(request):
    return request.getfixturevalue(request.param)


@pytest.fixture(scope="module")
def move(character):
    """Displacement of every landmark, in metres, for 10 degrees of one degree of freedom after an optional posture."""
    skeleton = character.skeleton
    place = jax.jit(lambda angles: landmark_positions(skeleton, Pose(rest_pose(skeleton).root, angles)))

    def displacement(name: str, **posture: float) -> dict[str, np.ndarray]:
        before = np.zeros(33)
        for other, degrees in posture.items():
            before[skeleton.dof_names.index(other) - 6] = np.radians(degrees)
        after = before.copy()
        after[skeleton.dof_names.index(name) - 6] += np.radians(10)
        moved = np.asarray(place(jnp.asarray(after)) - place(jnp.asarray(before)))
        return dict(zip(skeleton.landmark_names, moved, strict=True))

    return displacement


@pytest.mark.parametrize("name", FLEX)
def test_trunk_flexion_brings_the_head_forward(move, name):
    assert move(name)["head"] @ Z > 0.02


def test_trunk_leans_right_and_turns_left(move):
    assert move("lumbar_lat")["head"] @ X < -0.02
    assert move("lumbar_axial")["l_shoulder"] @ Z < -0.01
    assert move("lumbar_axial")["r_shoulder"] @ Z > 0.01


def test_neck_nods_down_tilts_right_and_looks_left(move):
    assert move("neck_flex")["nose"] @ Y < -0.005
    assert move("neck_lat")["head"] @ X < -0.005
    assert move("neck_axial")["nose"] @ X > 0.005


@pytest.mark.parametrize(("side", "outwards"), [("l", X), ("r", -X)])
class TestLimbs:
    def test_clavicle_protracts_and_shrugs(self, move, side, outwards):
        assert move(f"{side}_clav_protract")[f"{side}_shoulder"] @ Z > 0.01
        assert move(f"{side}_clav_elev")[f"{side}_shoulder"] @ Y > 0.01

    def test_shoulder_flexion_brings_a_hanging_arm_forward(self, character, move, side, outwards):
        degrees = hang(character, side)
        moved = move(f"{side}_shoulder_flex", **{f"{side}_shoulder_abd": degrees})
        assert moved[f"{side}_elbow"] @ Z > 0.03

    def test_shoulder_abduction_raises_the_arm(self, move, side, outwards):
        assert move(f"{side}_shoulder_abd")[f"{side}_elbow"] @ Y > 0.02

    def test_internal_rotation_of_a_bent_hanging_arm_brings_the_hand_inwards(self, character, move, side, outwards):
        posture = {f"{side}_shoulder_abd": hang(character, side), f"{side}_elbow_flex": 60}
        assert move(f"{side}_shoulder_axial", **posture)[f"{side}_wrist"] @ outwards < -0.01

    def test_elbow_flexion_brings_the_wrist_to_the_shoulder(self, character, move, side, outwards):
        shoulder, wrist = (np.asarray(character.skeleton.landmark(f"{side}_{j}")) for j in ("shoulder", "wrist"))
        posture = {f"{side}_elbow_flex": 30}
        moved = move(f"{side}_elbow_flex", **posture)[f"{side}_wrist"]
        assert moved @ (shoulder - wrist) > 0.01 * np.linalg.norm(shoulder - wrist)

    def test_hip_flexes_forward_abducts_outwards_and_turns_toes_inwards(self, move, side, outwards):
        assert move(f"{side}_hip_flex")[f"{side}_knee"] @ Z > 0.05
        assert move(f"{side}_hip_abd")[f"{side}_knee"] @ outwards > 0.05
        assert move(f"{side}_hip_int")[f"{side}_toe"] @ outwards < -0.01

    def test_knee_flexion_moves_the_ankle_back_and_up(self, move, side, outwards):
        moved = move(f"{side}_knee_flex", **{f"{side}_knee_flex": 20})[f"{side}_ankle"]
        assert moved @ Z < -0.03
        assert moved @ Y > 0.005

    def test_ankle_lifts_the_toes_and_turns_the_sole_inwards(self, character, move, side, outwards):
        assert move(f"{side}_ankle_dorsi")[f"{side}_toe"] @ Y > 0.01
        inversion = np.asarray(character.skeleton.axes[character.skeleton.dof_names.index(f"{side}_ankle_inv") - 6])
        assert np.cross(inversion, -Y) @ outwards < -0.9  # what is below the ankle moves inwards: the sole faces in

    def test_pronation_of_a_bent_arm_lowers_the_thumb(self, character, side, outwards):
        skeleton = character.skeleton
        number = skeleton.dof_names.index(f"{side}_forearm_pron") - 6
        axis = np.asarray(skeleton.axes[number])
        forearm = np.asarray(skeleton.landmark(f"{side}_wrist") - skeleton.landmark(f"{side}_elbow"))
        sense = 1.0 if side == "l" else -1.0
        assert sense * axis @ forearm / np.linalg.norm(forearm) == pytest.approx(1, abs=1e-5)


def hang(character, side: str) -> float:
    """Abduction, in degrees from rest, that brings the arm to 70 degrees below horizontal."""
    arm = np.asarray(character.skeleton.landmark(f"{side}_elbow") - character.skeleton.landmark(f"{side}_shoulder"))
    return -70 + np.degrees(np.arctan2(-arm[1], abs(arm[0])))


def test_mirrored_angles_give_the_mirrored_mesh(box_figure):
    skeleton = box_figure.skeleton
    values = np.random.default_rng(1).uniform(-0.4, 0.4, 39)
    mirrored = values.copy()
    for number, name in enumerate(skeleton.dof_names):
        if name[:2] in ("l_", "r_"):
            mirrored[skeleton.dof_names.index({"l": "r", "r": "l"}[name[0]] + name[1:])] = values[number]
        elif name in ("root_tx", "root_ry", "root_rz", "lumbar_lat", "lumbar_axial", "neck_lat", "neck_axial"):
            mirrored[number] = -values[number]
    one = np.asarray(skin(box_figure, pose_from_vector(skeleton, jnp.asarray(values)))) * [-1, 1, 1]
    two = np.asarray(skin(box_figure, pose_from_vector(skeleton, jnp.asarray(mirrored))))
    rest = np.asarray(box_figure.vertices)
    partner = np.argmin(np.sum((rest[:, None] * [-1, 1, 1] - rest[None]) ** 2, axis=2), axis=1)
    np.testing.assert_allclose(one, two[partner], atol=2e-6)


def test_limits_contain_the_rest_pose(character):
    assert np.all(np.asarray(character.skeleton.lower) < -0.05)
    assert np.all(np.asarray(character.skeleton.upper) > 0.05)


def test_bent_elbows_of_the_actor_shift_the_elbow_limits(actor):
    number = actor.skeleton.dof_names.index("l_elbow_flex") - 6
    upper, fore = (
        np.asarray(actor.skeleton.landmark(b) - actor.skeleton.landmark(a), np.float64)
        for a, b in (("l_shoulder", "l_elbow"), ("l_elbow", "l_wrist"))
    )
    bend = np.degrees(np.arccos(upper @ fore / np.linalg.norm(upper) / np.linalg.norm(fore)))
    assert bend > 40
    assert np.degrees(actor.skeleton.upper[number]) == pytest.approx(150 - bend, abs=0.01)
    assert np.degrees(actor.skeleton.lower[number]) == pytest.approx(-5 - bend, abs=0.01)
