"""A motion on somebody else's rig: its own bones and proportions, our directions, feet that stand where ours do."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from jaxmocap._results import InputError
from jaxmocap.character import BODIES, Character, Document, RawSkin, Rig, read_rig
from jaxmocap.motion import Motion

from ._exporter import ExportForm
from ._legs import legs_of, swings
from ._stand import stand

_BODY_NAMES = tuple(body for body, _, _ in BODIES)
_X, _Y, _Z = np.eye(3)
_SAID = 0.05  # centimetres by which the hips are lowered before it is said
_BENT = np.radians(10.0)  # bend at rest from which a knee or elbow shows its axis
_TWIST = np.radians(90.0)  # by which that axis may be off the one of a straight limb


class Retargeted(NamedTuple):
    """A rig of somebody else's in every frame of a motion; joints are those that move, parents before children.

    Attributes:
        document: the glTF.
        nodes: the joints' nodes.
        names: of the joints, the file's own.
        parents: of each joint its parent's number; -1 of the first.
        rest_from_joint: takes the space of each joint, as it is bound, to the rest frame, metres.
        world_from_rest: how each joint moves what it carries.
        vertices: of the mesh at rest, metres.
        weights: of the vertices, by joint.
        told: a sentence about how well it stands.
    """

    document: Document
    nodes: tuple[int, ...]
    names: tuple[str, ...]
    parents: tuple[int, ...]
    rest_from_joint: Float[np.ndarray, "joint 4 4"]
    world_from_rest: Float[np.ndarray, "frame joint 4 4"]
    vertices: Float[np.ndarray, "vertex 3"]
    weights: Float[np.ndarray, "vertex joint"]
    told: str


def retargeted(motion: Motion, form: ExportForm) -> Retargeted:
    """Move the rig that `form` names as the motion's person moves.

    Limbs point where the person's do, and turn about themselves as they do; trunk, head and collar bones turn from
    rest as theirs. Raises `InputError` where the rig is not that of a person.
    """
    assert form.rig is not None
    document = Document(form.rig)
    target = Character.load(form.rig, form.mapping)
    raw, rig = read_rig(document, form.mapping)
    if motion.character.skeleton.body_names != _BODY_NAMES:
        raise InputError(f"{form.name}: only a person's motion is written on another rig; leave the rig out.")
    joints, frames = _moving(document, raw, rig), body_frames(target)
    turns = motion.body_transforms[..., :3, :3].astype(np.float64)
    turns = turns @ body_frames(motion.character) @ frames.swapaxes(1, 2)
    stance = stand(motion, target, turns, frames[[_BODY_NAMES.index(f"{side}_thigh") for side in "lr"], :, 0])
    rest = rig.rest_from_joint[:, :3, 3]
    joint_turns = _joint_turns(raw, rig, joints, stance.turns)
    worlds = np.tile(np.eye(4), (len(motion), len(joints), 1, 1))
    hips = rest[[rig.anchors[f"{side}_thigh"] for side in "lr"]].mean(axis=0)
    for number, joint in enumerate(joints):
        turn = worlds[:, number, :3, :3] = joint_turns[joint]
        if number == 0:
            place = stance.hips + turn @ (rest[joint] - hips)
        else:
            above = worlds[:, joints.index(raw.joint_parents[joint])]
            place = above[:, :3, :3] @ rest[joint] + above[:, :3, 3]
        worlds[:, number, :3, 3] = place - turn @ rest[joint]
    before, after, lowered = (100 * length for length in (*stance.slides, stance.lowered))
    told = (
        f"{form.name}: the path is scaled by {stance.scale:.2f}, as the legs of {form.rig.name} are; planted feet "
        f"slide by up to {after:.1f} cm ({before:.1f} cm in the motion)"
        + (f", and the hips are lowered by up to {lowered:.1f} cm so that feet reach." if lowered >= _SAID else ".")
    )
    numbers = {joint: number for number, joint in enumerate(joints)}
    return Retargeted(
        document,
        tuple(raw.joint_nodes[joint] for joint in joints),
        tuple(raw.joint_names[joint] for joint in joints),
        tuple(numbers.get(raw.joint_parents[joint], -1) for joint in joints),
        rig.rest_from_joint[joints],
        worlds,
        raw.vertices @ rig.rest_from_file.T,
        raw.weights[:, joints],
        told,
    )


def body_frames(character: Character) -> Float[np.ndarray, "bone 3 3"]:
    """Lay axes into the bodies of any rest pose: the turns that bring them there from the neutral body.

    In that one the arms are straight out to the sides, palms down, and the legs straight down, feet forward. A limb
    turns out of it the shortest way, and about itself only where its knee or elbow is bent and so shows its axis.
    Trunk, head and collar bones are taken to rest upright.
    """
    at = lambda name: np.asarray(character.skeleton.landmark(name), np.float64)  # noqa: E731
    turns = {}
    for side, sign, heading in zip("lr", (1.0, -1.0), legs_of(character).headings, strict=True):
        arm = [at(f"{side}_{name}") for name in ("shoulder", "elbow", "wrist")]
        leg = [at(f"{side}_{name}") for name in ("hip", "knee", "ankle")]
        upper, fore = _limb_frames(np.diff(arm, axis=0), sign * _X, np.cross(sign * _X, _Z))
        turns |= {f"{side}_upper_arm": upper, f"{side}_forearm": fore, f"{side}_hand": fore}
        thigh, shank = _limb_frames(np.diff(leg, axis=0), -_Y, _X)
        turns |= {f"{side}_thigh": thigh, f"{side}_shank": shank, f"{side}_foot": heading}
    return np.stack([turns.get(body, np.eye(3)) for body in _BODY_NAMES])


def _limb_frames(
    bones: Float[np.ndarray, "2 3"], straight: Float[np.ndarray, "3"], axis: Float[np.ndarray, "3"]
) -> list[Float[np.ndarray, "3 3"]]:
    """Find the turns of both bones of a limb that is `straight` in the neutral body and bends about `axis` there."""
    upper, lower = bones / np.linalg.norm(bones, axis=1, keepdims=True)
    frame = swings(straight, upper)
    normal, now = np.cross(upper, lower), frame @ axis
    twist = np.arctan2(np.cross(now, normal) @ upper, now @ normal)
    if np.linalg.norm(normal) > np.sin(_BENT) and abs(twist) < _TWIST:
        frame = Rotation.from_rotvec(twist * upper).as_matrix() @ frame
    return [frame, swings(upper, lower) @ frame]


def _line(joint: int, raw: RawSkin) -> list[int]:
    """List a joint and all that it hangs from."""
    line = [joint]
    while raw.joint_parents[line[-1]] >= 0:
        line.append(raw.joint_parents[line[-1]])
    return line


def _moving(document: Document, raw: RawSkin, rig: Rig) -> list[int]:
    """List the joints that move, parents first: the one from which legs and head hang, and all below it."""
    legs, head = (_line(rig.anchors[body], raw) for body in ("l_thigh", "head"))
    right = _line(rig.anchors["r_thigh"], raw)
    root = next((joint for joint in legs if joint in right and joint in head), None)
    if root is None:
        document.fail("has no joint from which both legs and the head hang; give its skeleton one root")
    lines = {joint: _line(joint, raw) for joint in range(len(raw.joint_names))}
    return sorted((joint for joint, line in lines.items() if root in line), key=lambda joint: len(lines[joint]))


def _joint_turns(
    raw: RawSkin, rig: Rig, joints: list[int], turns: Float[np.ndarray, "frame bone 3 3"]
) -> dict[int, Float[np.ndarray, "frame 3 3"]]:
    """Turn each joint that begins a body as that body; others follow their parents, but a spine shares its bend."""
    found: dict[int, np.ndarray] = {}
    shares = _spine_shares(raw, rig)
    for number, joint in enumerate(joints):
        parent, body = raw.joint_parents[joint], rig.bodies[joint]
        if joint in shares:
            low, high = (turns[:, _BODY_NAMES.index(name)] for name in ("abdomen", "chest"))
            between = Rotation.from_matrix(low.swapaxes(1, 2) @ high).as_rotvec()
            found[joint] = low @ Rotation.from_rotvec(shares[joint] * between).as_matrix()
        else:
            found[joint] = turns[:, body] if number == 0 or body != rig.bodies[parent] else found[parent]
    return found


def _spine_shares(raw: RawSkin, rig: Rig) -> dict[int, float]:
    """Divide the bend between abdomen and chest among the joints between theirs."""
    low, line = rig.anchors.get("abdomen"), _line(rig.anchors["chest"], raw)
    between = line[1 : line.index(low)][::-1] if low in line else []
    return {joint: (number + 1) / (len(between) + 1) for number, joint in enumerate(between)}
