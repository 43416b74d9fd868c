"""Which joint of a file is which, by name: Mixamo, VRM, Rocketbox, MakeHuman, MHR, Unreal, SMPL, Blender and others."""

import re
from collections.abc import Sequence

# Words of a name, its side removed, and the parts of the body they mean, best first: a clavicle is called "shoulder"
# where an upper arm has a name of its own, a shank is called "leg" where a thigh has one.
_TRUNK = {
    "pelvis": ("hips", "pelvis", "hip", "bip"),
    "neck": ("neck", "necklower", "neckbase"),
    "head": ("head",),
}
_LIMBS = {
    "upper_arm": ("upperarm", "uparm", "armupper", "humerus", "arm", "shldr", "shoulder"),
    "forearm": ("forearm", "lowerarm", "lowarm", "loarm", "armlower", "elbow", "ulna", "radius"),
    "hand": ("wrist", "hand", "palm"),
    "thigh": ("thigh", "upleg", "upperleg", "legupper", "femur", "hip", "leg"),
    "shank": ("shank", "shin", "calf", "lowerleg", "lowleg", "leglower", "crus", "tibia", "knee", "leg"),
    "foot": ("ankle", "foot"),
    "clavicle": ("clavicle", "collar", "clav", "shoulder", "shldr"),
}
_SPINE = ("spine", "abdomen", "chest", "torso", "thorax", "upperchest", "waist", "lumbar", "belly", "lowerback", "rib")
_PROGRAMS = {"bip", "bip01", "bip001", "mixamorig", "valvebiped", "cc", "sk", "def", "org"}
_NOISE = _PROGRAMS | {"j", "jnt", "joint", "bone", "b", "c", "m", "f", "avg", "base", "bend"}
_SIDES = {"l": "l", "left": "l", "lft": "l", "r": "r", "right": "r", "rgt": "r"}


def split_side(name: str) -> tuple[str, str]:
    """Split a joint's name into (side, words).

    `mixamorig:LeftForeArm` is `("l", "forearm")`, `spine_01` is `("", "spine1")`.
    """
    base = re.split(r"[:|/]", name)[-1]
    spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", " ", base)
    words = [word for word in re.split(r"[^a-z0-9]+", spaced.lower()) if word]
    words = [piece for word in words for piece in _split_glued(word)]
    side = next((_SIDES[word] for word in words if word in _SIDES), "")
    rest = [word for word in words if word not in _SIDES]
    useful = [word for word in rest if word not in _NOISE] or rest
    text = "".join(useful)
    return side, re.sub(r"(?<![0-9])0+(?=[0-9])", "", text)


def _split_glued(word: str) -> list[str]:
    """`leftarm` and `rthigh` into side and part, where that leaves a known word."""
    known = {synonym for synonyms in _LIMBS.values() for synonym in synonyms}
    for prefix in ("left", "right", "mixamorig"):
        if word.startswith(prefix) and len(word) > len(prefix):
            return [prefix, *_split_glued(word[len(prefix) :])]
    if word[0] in "lr" and word[1:] in known:
        return [word[0], word[1:]]
    return [word]


def roles_by_name(names: Sequence[str], parents: Sequence[int]) -> dict[str, int]:
    """Recognise joints by their names, as {role: joint}.

    Roles are `pelvis`, `neck`, `head`, `l_upper_arm`, `l_toe` and the like, and `spine0`, `spine1`, ... from the pelvis
    up. A role whose names are absent is absent, but a pelvis of another name is the joint that both thighs hang from.
    """
    split = [split_side(name) for name in names]
    depth = [_depth(joint, parents) for joint in range(len(names))]
    roles: dict[str, int] = {}
    for side in "lr":
        taken: set[int] = set()
        for role, synonyms in _LIMBS.items():
            joint = _best(split, depth, side, synonyms, taken)
            if joint is not None:
                roles[f"{side}_{role}"] = joint
                taken.add(joint)
    for role, synonyms in _TRUNK.items():
        joint = _best(split, depth, "", synonyms, set())
        if joint is not None:
            roles[role] = joint
    if "pelvis" not in roles and "l_thigh" in roles and "r_thigh" in roles:
        shared = common_ancestor(roles["l_thigh"], roles["r_thigh"], parents)
        if shared is not None:
            roles["pelvis"] = shared
    pelvis, neck = roles.get("pelvis"), roles.get("neck", roles.get("head"))
    if pelvis is not None and neck is not None:
        path = ancestors(neck, parents)
        between = path[: path.index(pelvis)] if pelvis in path else path
        spine = [joint for joint in reversed(between) if joint not in roles.values() and _is_spine(split[joint][1])]
        roles.update({f"spine{number}": joint for number, joint in enumerate(spine)})
    return roles


def ancestors(joint: int, parents: Sequence[int]) -> list[int]:
    """List parent, grandparent, and so on to the root."""
    path = []
    while parents[joint] >= 0:
        joint = parents[joint]
        path.append(joint)
    return path


def common_ancestor(a: int, b: int, parents: Sequence[int]) -> int | None:
    """Find the nearest joint above both, if any."""
    above = ancestors(b, parents)
    return next((joint for joint in ancestors(a, parents) if joint in above), None)


def _best(
    split: list[tuple[str, str]], depth: list[int], side: str, synonyms: tuple[str, ...], taken: set[int]
) -> int | None:
    """Find the joint with the best synonym; a number after the word is allowed, and the topmost joint wins ties."""
    best: tuple[int, int, int, int] | None = None
    for joint, (joint_side, words) in enumerate(split):
        if joint_side != side or joint in taken:
            continue
        stem = words.rstrip("0123456789")
        for rank, synonym in enumerate(synonyms):
            if synonym in (words, stem):
                key = (rank, depth[joint], int(words != synonym), joint)
                best = key if best is None else min(best, key)
    return None if best is None else best[3]


def _is_spine(words: str) -> bool:
    return words.rstrip("0123456789").startswith(_SPINE)


def _depth(joint: int, parents: Sequence[int]) -> int:
    return len(ancestors(joint, parents))
