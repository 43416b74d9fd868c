"""The joint angles that the International Society of Biomechanics recommends, as data.

Wu et al. 2002 (ankle, hip, spine) and 2005 (shoulder, elbow, wrist); Grood and Suntay 1983 (knee); Baker 2001 (pelvis).
"""

from typing import NamedTuple

NEUTRAL = (
    "Neutral pose, in which all joint angles are 0: upright, legs straight, feet flat and forward, arms hanging, palms "
    "forward (the anatomical position).",
    "Segment axes in it: x forward, y up, z to the subject's right, right-handed (ISB). Left limbs are mirrored at the "
    "sagittal plane, so a sign means the same on both sides.",
    "The laboratory is y up; a pelvis that faces its x has rotation 0.",
    "Angles follow each other without jumps: they may pass 180 degrees, and an elevation may go below 0, which is the "
    "same as above 0 in the plane 180 degrees further.",
)
"""What holds for all of these angles."""


class IsbJoint(NamedTuple):
    """A joint and its three angles; a joint of a limb without its side.

    Attributes:
        name: of the joint.
        proximal: the body it turns in; "" for the laboratory.
        distal: the body it turns.
        order: axes of the sequence, each turned by the ones before: e1, e2, e3.
        angles: what they are called.
        signs: -1 where an angle is positive against the axis.
        positive: which way each goes, in words.
        seen_by: landmarks whose confidence is the joint's.
        source: of the definition.
    """

    name: str
    proximal: str
    distal: str
    order: str
    angles: tuple[str, str, str]
    signs: tuple[int, int, int]
    positive: tuple[str, str, str]
    seen_by: tuple[str, ...]
    source: str


_LEG = ("flexion", "adduction", "internal_rotation")
_SPINE = ("extension", "lateral_bend", "rotation")
_SPINE_WORDS = ("backwards", "to the right", "to the left")
MIDDLE = (
    IsbJoint(
        "pelvis",
        "",
        "pelvis",
        "YXZ",
        ("rotation", "obliquity", "tilt"),
        (1, -1, -1),
        ("to the left", "right side up", "forward (anterior)"),
        ("pelvis", "l_hip", "r_hip"),
        "Baker 2001",
    ),
    IsbJoint(
        "thorax", "pelvis", "chest", "ZXY", _SPINE, (1, 1, 1), _SPINE_WORDS, ("mid_shoulder", "neck"), "Wu 2002, 2005"
    ),
    IsbJoint("neck", "chest", "head", "ZXY", _SPINE, (1, 1, 1), _SPINE_WORDS, ("neck", "head"), "Wu 2002"),
)
SIDES = (
    IsbJoint(
        "hip",
        "pelvis",
        "thigh",
        "ZXY",
        _LEG,
        (1, 1, 1),
        ("thigh forward", "thigh inwards", "toes inwards"),
        ("hip", "knee"),
        "Wu 2002",
    ),
    IsbJoint(
        "knee",
        "thigh",
        "shank",
        "ZXY",
        _LEG,
        (-1, 1, 1),
        ("shank backwards", "shank inwards (varus)", "toes inwards"),
        ("hip", "knee", "ankle"),
        "Grood and Suntay 1983",
    ),
    IsbJoint(
        "ankle",
        "shank",
        "foot",
        "ZXY",
        ("dorsiflexion", "inversion", "internal_rotation"),
        (1, 1, 1),
        ("toes up", "sole inwards", "toes inwards"),
        ("knee", "ankle", "toe"),
        "Wu 2002",
    ),
    IsbJoint(
        "shoulder",
        "chest",
        "upper_arm",
        "YXY",
        ("plane_of_elevation", "elevation", "internal_rotation"),
        (1, -1, 1),
        ("from sideways (0) to forward (90)", "arm up (Wu's is negative)", "inwards"),
        ("shoulder", "elbow"),
        "Wu 2005, thorax to humerus",
    ),
    IsbJoint(
        "elbow",
        "upper_arm",
        "forearm",
        "ZXY",
        ("flexion", "carrying_angle", "pronation"),
        (1, 1, 1),
        ("flex", "forearm inwards (varus)", "pronate, from palm forward (0)"),
        ("shoulder", "elbow", "wrist"),
        "Wu 2005",
    ),
    IsbJoint(
        "wrist",
        "forearm",
        "hand",
        "ZXY",
        ("flexion", "ulnar_deviation", "internal_rotation"),
        (1, 1, 1),
        ("palm towards the forearm", "towards the little finger", "inwards"),
        ("elbow", "wrist"),
        "Wu 2005",
    ),
)
"""The wrist is left out where the tracked hand does not bend."""
