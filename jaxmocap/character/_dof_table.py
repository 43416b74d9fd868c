"""The 39 degrees of freedom as data: names, order, axes, directions and limits (Sec. 3.1, Fig. 3).

The paper fixes 39 = 6 + 33 and the groups; the split per joint follows the CMU skeleton. Axes are those of the
**neutral** body (arms straight out to the sides, palms down, legs straight down; x = subject's left, y up, z forward)
and of its left side; `_build.py` carries them to whatever rest pose the mesh was made in. Mirrored to the right side,
an axis (x, y, z) becomes (x, -y, -z) and limits stay. `cmu7` arms have a clavicle, `wrist7` arms a wrist instead.

Limits are those of ordinary adults with a tenth of slack, but for two. Where an arm points sideways, `shoulder_flex`
and `shoulder_axial` turn about the same line, so only their sum is anatomical and the axial one is kept wide. And a
rest pose may hold the shoulders up by up to 25 degrees, which `clav_elev` must be able to take back.
"""

from typing import Literal, NamedTuple

Arm = Literal["cmu7", "wrist7"]


class Dof(NamedTuple):
    """One joint degree of freedom; limits in degrees, measured from the neutral body."""

    name: str
    group: str
    joint: str
    body: str
    axis: tuple[float, float, float]
    lower: float
    upper: float
    positive: str


LEFT, UP, FORWARD = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
RIGHT, DOWN, BACK = (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)

ROOT = ("root_tx", "root_ty", "root_tz", "root_rx", "root_ry", "root_rz")

TORSO = (
    Dof("lumbar_flex", "torso", "spine", "abdomen", LEFT, -30, 70, "bend forward"),
    Dof("lumbar_lat", "torso", "spine", "abdomen", FORWARD, -35, 35, "lean right"),
    Dof("lumbar_axial", "torso", "spine", "abdomen", UP, -45, 45, "turn left"),
    Dof("thorax_flex", "torso", "thorax", "chest", LEFT, -15, 35, "bend forward"),
    Dof("neck_flex", "torso", "neck", "head", LEFT, -60, 60, "nod down"),
    Dof("neck_lat", "torso", "neck", "head", FORWARD, -45, 45, "tilt right"),
    Dof("neck_axial", "torso", "neck", "head", UP, -80, 80, "look left"),
)

_CLAVICLE = (
    Dof("clav_protract", "arm", "clavicle", "clavicle", DOWN, -20, 30, "shoulder forward"),
    Dof("clav_elev", "arm", "clavicle", "clavicle", FORWARD, -25, 40, "shrug"),
)

_ARM = (
    Dof("shoulder_flex", "arm", "shoulder", "upper_arm", RIGHT, -60, 180, "hanging arm forward"),
    Dof("shoulder_abd", "arm", "shoulder", "upper_arm", FORWARD, -110, 90, "raise"),
    Dof("shoulder_axial", "arm", "shoulder", "upper_arm", LEFT, -150, 140, "internal rotation"),
    Dof("elbow_flex", "arm", "elbow", "forearm", DOWN, -5, 150, "flex"),
    Dof("forearm_pron", "arm", "wrist", "hand", LEFT, -90, 80, "pronate"),
)

_WRIST = (
    Dof("wrist_flex", "arm", "wrist", "hand", BACK, -70, 70, "palm towards the forearm"),
    Dof("wrist_dev", "arm", "wrist", "hand", UP, -25, 35, "towards the little finger"),
)

_LEG = (
    Dof("hip_flex", "leg", "hip", "thigh", RIGHT, -30, 125, "thigh forward"),
    Dof("hip_abd", "leg", "hip", "thigh", FORWARD, -30, 50, "thigh outwards"),
    Dof("hip_int", "leg", "hip", "thigh", DOWN, -45, 45, "toes inwards"),
    Dof("knee_flex", "leg", "knee", "shank", LEFT, -5, 150, "flex"),
    Dof("ankle_dorsi", "leg", "ankle", "foot", RIGHT, -50, 30, "toes up"),
    Dof("ankle_inv", "leg", "ankle", "foot", BACK, -20, 35, "sole inwards"),
)

ARMS: dict[Arm, tuple[Dof, ...]] = {"cmu7": _CLAVICLE + _ARM, "wrist7": _ARM + _WRIST}

BODIES: tuple[tuple[str, str, str], ...] = (  # name, parent, the joint it turns about; parents precede children
    ("pelvis", "", "pelvis"),
    ("abdomen", "pelvis", "spine"),
    ("chest", "abdomen", "thorax"),
    ("head", "chest", "neck"),
    ("l_clavicle", "chest", "l_clavicle"),
    ("l_upper_arm", "l_clavicle", "l_shoulder"),
    ("l_forearm", "l_upper_arm", "l_elbow"),
    ("l_hand", "l_forearm", "l_wrist"),
    ("r_clavicle", "chest", "r_clavicle"),
    ("r_upper_arm", "r_clavicle", "r_shoulder"),
    ("r_forearm", "r_upper_arm", "r_elbow"),
    ("r_hand", "r_forearm", "r_wrist"),
    ("l_thigh", "pelvis", "l_hip"),
    ("l_shank", "l_thigh", "l_knee"),
    ("l_foot", "l_shank", "l_ankle"),
    ("r_thigh", "pelvis", "r_hip"),
    ("r_shank", "r_thigh", "r_knee"),
    ("r_foot", "r_shank", "r_ankle"),
)

LANDMARKS: tuple[tuple[str, str], ...] = (  # name, the body that carries it
    *((joint, body) for body, _, joint in BODIES),
    *((name, "head") for name in ("head", "nose", "l_eye", "r_eye", "l_ear", "r_ear")),
    ("mid_hip", "pelvis"),
    ("mid_shoulder", "chest"),
    *((f"{side}_{name}", f"{side}_foot") for side in "lr" for name in ("toe", "heel", "big_toe", "small_toe")),
)


def joint_dofs(arm: Arm) -> tuple[Dof, ...]:
    """The 33 joint degrees of freedom in order, both sides, axes in the neutral body."""
    limbs = [(side, dof) for table in (ARMS[arm], _LEG) for side in "lr" for dof in table]
    return TORSO + tuple(_on_side(side, dof) for side, dof in limbs)


def _on_side(side: str, dof: Dof) -> Dof:
    x, y, z = dof.axis
    return dof._replace(
        name=f"{side}_{dof.name}",
        group=f"{side}_{dof.group}",
        joint=f"{side}_{dof.joint}",
        body=f"{side}_{dof.body}",
        axis=dof.axis if side == "l" else (x, -y, -z),
    )
