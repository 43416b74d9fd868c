"""Skeletons as data: bodies, landmarks, and degrees of freedom with axes, limits and spread (Sec. 3.1, Fig. 3).

The paper fixes 39 = 6 + 33 degrees of freedom and their groups; the split per joint follows the CMU skeleton. Axes are
those of the **neutral** body (arms straight out to the sides, palms down, legs straight down; x = subject's left, y up,
z forward) and of its left side; `_build.py` carries them to whatever rest pose the mesh was made in. Mirrored to the
right side, an axis (x, y, z) becomes (x, -y, -z) and limits stay. `cmu7` arms have a clavicle, `wrist7` arms a wrist
instead.

Limits are those of ordinary adults with a tenth of slack, but for two. Where an arm points sideways, `shoulder_flex`
and `shoulder_axial` turn about the same line, so only their sum is anatomical and the axial one is kept wide. And a
rest pose may hold the shoulders up by up to 25 degrees, which `clav_elev` must be able to take back.
"""

from collections.abc import Iterable
from typing import Literal, NamedTuple

import numpy as np

from ._skeleton import ROOT_DOFS

Arm = Literal["cmu7", "wrist7"]


class Dof(NamedTuple):
    """One joint degree of freedom.

    Attributes:
        name: without the side, where both sides have it.
        group: what is searched at once.
        joint: the landmark that its axis goes through.
        body: what it turns, with everything beyond.
        axis: unit vector in the neutral body.
        lower: smallest angle, degrees from the neutral body.
        upper: largest angle, degrees from the neutral body.
        positive: which way it turns, in words.
        spread: standard deviation of the first particles, degrees; the heavier what it moves, the smaller.
        distal: whether it leaves the limb's bone next to the trunk where it is.
        posture: whether it bends the trunk: spine, neck or collar bone.
    """

    name: str
    group: str
    joint: str
    body: str
    axis: tuple[float, float, float]
    lower: float
    upper: float
    positive: str
    spread: float = 10.0
    distal: bool = False
    posture: bool = False


class SkeletonTable(NamedTuple):
    """A skeleton as data.

    Attributes:
        bodies: name, parent ("" of the first) and the joint it turns about, parents before children.
        dofs: the joint degrees of freedom in order.
        landmarks: name and carrying body; the joints of the bodies first, in the same order.
    """

    bodies: tuple[tuple[str, str, str], ...]
    dofs: tuple[Dof, ...]
    landmarks: tuple[tuple[str, str], ...]

    @property
    def groups(self) -> tuple[tuple[str, tuple[int, ...]], ...]:
        """As in `Skeleton`: the root, then the groups in the order of their first degrees of freedom."""
        members: dict[str, tuple[int, ...]] = {"root": tuple(range(ROOT_DOFS))}
        for index, dof in enumerate(self.dofs, start=ROOT_DOFS):
            members[dof.group] = (*members.get(dof.group, ()), index)
        return tuple(members.items())


LEFT, UP, FORWARD = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
RIGHT, DOWN, BACK = (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)

ROOT = ("root_tx", "root_ty", "root_tz", "root_rx", "root_ry", "root_rz")
ROOT_SPREAD = (0.04, 0.04, 0.04, *(float(np.deg2rad(6.0)) for _ in range(3)))  # metres, radians

TORSO = (
    Dof("lumbar_flex", "torso", "spine", "abdomen", LEFT, -30, 70, "bend forward", spread=6, posture=True),
    Dof("lumbar_lat", "torso", "spine", "abdomen", FORWARD, -35, 35, "lean right", spread=6, posture=True),
    Dof("lumbar_axial", "torso", "spine", "abdomen", UP, -45, 45, "turn left", spread=6, posture=True),
    Dof("thorax_flex", "torso", "thorax", "chest", LEFT, -15, 35, "bend forward", spread=6, posture=True),
    Dof("neck_flex", "torso", "neck", "head", LEFT, -60, 60, "nod down", spread=6, posture=True),
    Dof("neck_lat", "torso", "neck", "head", FORWARD, -45, 45, "tilt right", spread=6, posture=True),
    Dof("neck_axial", "torso", "neck", "head", UP, -80, 80, "look left", spread=6, posture=True),
)

_CLAVICLE = (
    Dof("clav_protract", "arm", "clavicle", "clavicle", DOWN, -20, 30, "shoulder forward", spread=4, posture=True),
    Dof("clav_elev", "arm", "clavicle", "clavicle", FORWARD, -25, 40, "shrug", spread=4, posture=True),
)

_ARM = (
    Dof("shoulder_flex", "arm", "shoulder", "upper_arm", RIGHT, -60, 180, "hanging arm forward", spread=12),
    Dof("shoulder_abd", "arm", "shoulder", "upper_arm", FORWARD, -110, 90, "raise", spread=12),
    Dof("shoulder_axial", "arm", "shoulder", "upper_arm", LEFT, -150, 140, "internal rotation", spread=12, distal=True),
    Dof("elbow_flex", "arm", "elbow", "forearm", DOWN, -5, 150, "flex", spread=15, distal=True),
    Dof("forearm_pron", "arm", "wrist", "hand", LEFT, -90, 80, "pronate", distal=True),
)

_WRIST = (
    Dof("wrist_flex", "arm", "wrist", "hand", BACK, -70, 70, "palm towards the forearm", distal=True),
    Dof("wrist_dev", "arm", "wrist", "hand", UP, -25, 35, "towards the little finger", distal=True),
)

_LEG = (
    Dof("hip_flex", "leg", "hip", "thigh", RIGHT, -30, 125, "thigh forward", spread=12),
    Dof("hip_abd", "leg", "hip", "thigh", FORWARD, -30, 50, "thigh outwards", spread=12),
    Dof("hip_int", "leg", "hip", "thigh", DOWN, -45, 45, "toes inwards", spread=12, distal=True),
    Dof("knee_flex", "leg", "knee", "shank", LEFT, -5, 150, "flex", spread=15, distal=True),
    Dof("ankle_dorsi", "leg", "ankle", "foot", RIGHT, -50, 30, "toes up", distal=True),
    Dof("ankle_inv", "leg", "ankle", "foot", BACK, -20, 35, "sole inwards", distal=True),
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


def human_table(arm: Arm = "cmu7") -> SkeletonTable:
    """Make the table of a person's skeleton: both sides, axes in the neutral body."""
    limbs = [(side, dof) for table in (ARMS[arm], _LEG) for side in "lr" for dof in table]
    return SkeletonTable(BODIES, TORSO + tuple(_on_side(side, dof) for side, dof in limbs), LANDMARKS)


def known_dofs(names: Iterable[str]) -> tuple[Dof, ...]:
    """Look up the joint degrees of freedom of these names in the skeletons of persons."""
    known = {dof.name: dof for arm in ARMS for dof in human_table(arm).dofs}
    return tuple(known[name] for name in names)


def _on_side(side: str, dof: Dof) -> Dof:
    x, y, z = dof.axis
    return dof._replace(
        name=f"{side}_{dof.name}",
        group=f"{side}_{dof.group}",
        joint=f"{side}_{dof.joint}",
        body=f"{side}_{dof.body}",
        axis=dof.axis if side == "l" else (x, -y, -z),
    )
