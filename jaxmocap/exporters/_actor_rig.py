"""Which rig a motion is written on: the one its actor came with, or else our own 18 joints."""

import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxmocap._results import InputError
from jaxmocap.character import Character, Document, Rig, local_matrix, parents_first, parents_of, read_rig
from jaxmocap.motion import Motion

from ._exporter import ExportForm

_SAME = 1e-4
"""Metres by which the vertices of the actor's file may be off those of the tracked character."""
_SHEAR = 1e-4


class ActorRig(NamedTuple):
    """A skinned document, the nodes of its joints, and the transforms of all its nodes in every frame."""

    document: Document
    joints: tuple[int, ...]
    scales: Float[np.ndarray, "node 3"]
    rotations: Float[np.ndarray, "frame node 3 3"]
    translations: Float[np.ndarray, "frame node 3"]
    own: bool  # the actor's own file


def actor_rig(motion: Motion, form: ExportForm) -> ActorRig:
    """The actor's own rig, posed. Where its file is gone, or no longer what was tracked, our own joints, and a sentence
    that says so; `InputError` if the file was named by the user."""
    named = form.actor or motion.provenance.get("actor")
    why = "the result names no actor's file"
    if named:
        why = _mismatch(motion.character, Path(named))
        if why is None:
            posed = _posed(Document(Path(named)), motion, own=True)
            if posed is not None:
                return posed
            why = f"the rig of {named} stretches unevenly, which glTF nodes cannot hold"
        if form.actor is not None:
            raise InputError(f"{why}; leave the actor out to write the motion on our own joints.")
    if named:
        form.say(f"{form.name}: {why}; the motion is written on our own joints, without materials.")
    with tempfile.TemporaryDirectory() as folder:
        posed = _posed(Document(motion.character.save_glb(Path(folder) / "character.glb")), motion, own=False)
    assert posed is not None
    return posed


def _mismatch(character: Character, path: Path) -> str | None:
    """Why the actor's file cannot be used, if so."""
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
    """The document's nodes in every frame; None where they cannot be written as translation, rotation and scale."""
    raw, rig = read_rig(document)
    nodes = document.content["nodes"]
    still = np.stack([local_matrix(node) for node in nodes])
    parents = parents_of(nodes)
    targets = dict(zip(raw.joint_nodes, _joint_worlds(motion, rig).swapaxes(0, 1), strict=True))
    worlds = np.empty((len(motion), len(nodes), 4, 4))
    local = np.empty_like(worlds)
    for node in parents_first(parents):
        above = worlds[:, parents[node]] if parents[node] >= 0 else np.eye(4)
        local[:, node] = np.linalg.solve(above, targets[node]) if node in targets else still[node]
        worlds[:, node] = above @ local[:, node]
    scales = np.linalg.norm(local[..., :3, :3], axis=-2)
    rotations = local[..., :3, :3] / scales[..., None, :]
    joints = list(raw.joint_nodes)
    uneven = np.abs(rotations.swapaxes(-1, -2) @ rotations - np.eye(3))[:, joints].max()
    mirrored = (np.linalg.det(rotations[:, joints]) < 0).any()
    breathing = np.ptp(scales[:, joints], axis=0).max() / scales[:, joints].max()
    if uneven > _SHEAR or mirrored or breathing > _SHEAR:
        return None
    return ActorRig(document, raw.joint_nodes, np.median(scales, axis=0), rotations, local[..., :3, 3], own)


def _joint_worlds(motion: Motion, rig: Rig) -> Float[np.ndarray, "frame joint 4 4"]:
    bodies = motion.body_transforms.astype(np.float64)
    return bodies[:, list(rig.bodies)] @ rig.rest_from_joint
