"""Which rig a motion is written on: the one its actor came with, somebody else's, or else our own joints."""

import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from jaxmocap._results import InputError
from jaxmocap.character import (
    Character,
    Document,
    RawSkin,
    Rig,
    local_matrix,
    parents_first,
    parents_of,
    read_rig,
    read_skin,
)
from jaxmocap.motion import Motion

from ._exporter import ExportForm
from ._retarget import retargeted

Scales = Float[np.ndarray, "joint 3"]
Rotations = Float[np.ndarray, "frame joint 3 3"]
Translations = Float[np.ndarray, "frame joint 3"]

_SAME = 1e-4
"""Metres by which the vertices of the actor's file may be off those of the tracked character."""
_SHEAR = 1e-4  # by which a joint may stretch unevenly before glTF nodes cannot hold it
_NOTICED = 1e-3
"""Metres by which the posed mesh may be off before it is said."""
_UNEVEN = "stretches unevenly, which glTF nodes cannot hold"


class ActorRig(NamedTuple):
    """A skinned document, posed.

    Attributes:
        document: the glTF.
        joints: the nodes of its joints.
        scales: of the joints, in their parents.
        rotations: of the joints, in their parents.
        translations: of the joints, in their parents, in the document's units.
        whose: "the actor's own", "jaxmocap", or the name of the file of somebody else's.
        off: how far its mesh comes to lie from the tracked one at most, metres; None if it is another's.
    """

    document: Document
    joints: tuple[int, ...]
    scales: Scales
    rotations: Rotations
    translations: Translations
    whose: str
    off: float | None


def actor_rig(motion: Motion, form: ExportForm) -> ActorRig:
    """Pose the actor's own rig in every frame.

    Where its file is gone, or no longer what was tracked, our own joints are posed, and a sentence says so; it is an
    `InputError` if the user named the file. A rig of somebody else's that the user named is posed instead.
    """
    if form.rig is not None:
        found = retargeted(motion, form)
        placed = _in_parents(found.document, found.nodes, found.world_from_rest @ found.rest_from_joint)
        if placed is None:
            raise InputError(f"the rig of {form.rig} {_UNEVEN}; apply the scales of its joints and export it again.")
        form.say(found.told)
        return ActorRig(found.document, found.nodes, *placed, form.rig.name, None)
    named = form.actor or motion.provenance.get("actor")
    why = "the result names no actor's file"
    if named:
        why = _mismatch(motion.character, Path(named))
        if why is None:
            posed = _posed(Document(Path(named)), motion, own=True)
            if posed is not None:
                if posed.off is not None and posed.off > _NOTICED:
                    form.say(
                        f"{form.name}: the actor's rig has fewer joints than the tracked body, so its mesh is off by "
                        f"up to {100 * posed.off:.1f} cm."
                    )
                return posed
            why = f"the rig of {named} {_UNEVEN}"
        if form.actor is not None:
            raise InputError(f"{why}; leave the actor out to write the motion on our own joints.")
    if named:
        form.say(f"{form.name}: {why}; the motion is written on our own joints, without materials.")
    with tempfile.TemporaryDirectory() as folder:
        posed = _posed(Document(motion.character.save_glb(Path(folder) / "character.glb")), motion, own=False)
    assert posed is not None
    return posed


def _mismatch(character: Character, path: Path) -> str | None:
    """Say why the actor's file cannot be used; None where it can."""
    if not path.is_file():
        return f"the actor's file {path} is not there"
    try:
        found = Character.load(path)
    except InputError as error:
        return str(error).rstrip(".")
    same = found.vertices.shape == character.vertices.shape and np.array_equal(found.faces, character.faces)
    if not same or float(np.abs(np.asarray(found.vertices - character.vertices)).max()) > _SAME:
        return f"{path} is another character than the one that was tracked"
    return None


def _posed(document: Document, motion: Motion, own: bool) -> ActorRig | None:
    """Pose the document's nodes; None where they cannot be written as translation, rotation and scale."""
    raw, rig = read_rig(document) if own else _own_rig(document)
    placed = _in_parents(document, raw.joint_nodes, _joint_worlds(motion, rig))
    if placed is None:
        return None
    whose = "the actor's own" if own else "jaxmocap"
    return ActorRig(document, raw.joint_nodes, *placed, whose, _difference(raw, rig, motion))


def _in_parents(
    document: Document, joints: tuple[int, ...], joint_worlds: Float[np.ndarray, "frame joint 4 4"]
) -> tuple[Scales, Rotations, Translations] | None:
    """Split joints into scales, rotations and translations in their parents; None where glTF nodes cannot hold them."""
    nodes = document.content["nodes"]
    still = np.stack([local_matrix(node) for node in nodes])
    parents = parents_of(nodes)
    targets = dict(zip(joints, joint_worlds.swapaxes(0, 1), strict=True))
    worlds = np.empty((len(joint_worlds), len(nodes), 4, 4))
    local = np.empty_like(worlds)
    for node in parents_first(parents):
        above = worlds[:, parents[node]] if parents[node] >= 0 else np.eye(4)
        local[:, node] = np.linalg.solve(above, targets[node]) if node in targets else still[node]
        worlds[:, node] = above @ local[:, node]
    local = local[:, list(joints)]
    scales = np.linalg.norm(local[..., :3, :3], axis=-2)
    rotations = local[..., :3, :3] / scales[..., None, :]
    uneven = np.abs(rotations.swapaxes(-1, -2) @ rotations - np.eye(3)).max()
    breathing = np.ptp(scales, axis=0).max() / scales.max()
    if uneven > _SHEAR or breathing > _SHEAR or (np.linalg.det(rotations) < 0).any():
        return None
    return np.median(scales, axis=0), rotations, local[..., :3, 3]


def _own_rig(document: Document) -> tuple[RawSkin, Rig]:
    """Take the rig of a file that `Character.save_glb` wrote for any skeleton: a joint per body, in their order."""
    raw = read_skin(document)
    return raw, Rig(tuple(range(len(raw.joint_names))), raw.place @ np.linalg.inv(raw.inverse_binds), {}, {}, np.eye(3))


def _difference(raw: RawSkin, rig: Rig, motion: Motion) -> float:
    """Measure how far vertices of the file, moved by its own joints, lie from the tracked ones at most, metres.

    It is more than rounding only where one joint of the file stands for two of ours, as in a trunk with one joint.
    Eight frames are looked at.
    """
    character = motion.character
    rest = raw.vertices @ rig.rest_from_file.T
    _, nearest = KDTree(np.asarray(character.vertices, np.float64)).query(rest)
    weights = raw.weights @ np.eye(len(character.skeleton.body_names))[list(rig.bodies)]
    weights /= np.maximum(weights.sum(axis=1, keepdims=True), 1e-12)
    wrong = weights - np.asarray(character.weights, np.float64)[nearest]
    frames = np.unique(np.linspace(0, len(motion) - 1, 8).astype(int))
    moved = motion.body_transforms[frames].astype(np.float64)
    apart = np.einsum("vb,tbij,vj->tvi", wrong, moved[..., :3, :3], rest, optimize=True)
    apart += np.einsum("vb,tbi->tvi", wrong, moved[..., :3, 3])
    return float(np.linalg.norm(apart, axis=-1).max())


def _joint_worlds(motion: Motion, rig: Rig) -> Float[np.ndarray, "frame joint 4 4"]:
    bodies = motion.body_transforms.astype(np.float64)
    return bodies[:, list(rig.bodies)] @ rig.rest_from_joint
