"""The points that are asked for: of BODY_25 those that registration uses, where they lie, and the bones between."""

from typing import Any

from jaxmocap.detection import BODY_25

_ON_BOTH_SIDES = {
    "shoulder": "middle of the shoulder joint, a hand's breadth inside the sleeve's seam",
    "elbow": "middle of the elbow",
    "wrist": "middle of the wrist, not of the hand",
    "hip": "middle of the hip joint, where the thigh folds, not the waist",
    "knee": "middle of the knee",
    "ankle": "middle of the ankle, between the knuckles",
    "heel": "back of the heel, at the sole",
    "big_toe": "tip of the big toe, or of the shoe over it",
}
_HEAD = {"eye": "the eye's middle", "ear": "the ear's middle"}
MIDDLES = {"neck": ("l_shoulder", "r_shoulder"), "mid_hip": ("l_hip", "r_hip")}
"""Points that follow from two others unless they are set themselves."""

_BONES = (
    ("nose", "neck"), ("neck", "mid_hip"), ("nose", "eye"), ("eye", "ear"), ("neck", "shoulder"),
    ("shoulder", "elbow"), ("elbow", "wrist"), ("mid_hip", "hip"), ("hip", "knee"), ("knee", "ankle"),
    ("ankle", "heel"), ("ankle", "big_toe"),
)  # fmt: skip


def asked_points() -> list[dict[str, Any]]:
    """List the points in the order in which they are asked for.

    One that `optional` says is not asked for, but may be set: middles follow from two others, and eyes and ears only
    tell where the head looks.
    """
    limbs = (("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle", "heel", "big_toe"))
    sides = ("r", "l")
    points = [_point("nose", "tip of the nose; pass over it if it is turned away")]
    points += [_point(f"{s}_{part}", _ON_BOTH_SIDES[part]) for limb in limbs for s in sides for part in limb]
    points += [_point(f"{s}_{part}", hint, optional=True) for part, hint in _HEAD.items() for s in sides]
    middle = "halfway between both {}s; follows them unless you set it"
    return points + [_point(n, middle.format(pair[0][2:]), optional=True) for n, pair in MIDDLES.items()]


def bones() -> list[tuple[int, int]]:
    """List pairs of BODY_25 points to draw lines between."""
    found: list[tuple[int, int]] = []
    for ends in _BONES:
        for side in ("l", "r"):
            names = [end if end in BODY_25.points else f"{side}_{end}" for end in ends]
            pair = BODY_25.points.index(names[0]), BODY_25.points.index(names[1])
            found += [] if pair in found else [pair]
    return found


def _point(name: str, hint: str, optional: bool = False) -> dict[str, Any]:
    side = {"l_": "left", "r_": "right"}.get(name[:2], "")
    words = {"mid_hip": "middle of the hips", "big_toe": "toe"}
    bare = name[2:] if side else name
    title = f"{side} {words.get(bare, bare)}".strip()
    index = BODY_25.points.index(name)
    return {"index": index, "name": name, "title": title, "hint": hint, "side": side, "optional": optional}
