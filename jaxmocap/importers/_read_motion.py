"""`read_motion`: a clip of another program as a `Motion` of one of our characters."""

from collections.abc import Mapping
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from jaxmocap._results import InputError
from jaxmocap.character import BODIES, Character, Pose, Skeleton, angles_at_rest, away_from_limits, build_skeleton
from jaxmocap.motion import Motion, continuous

from ._bvh import read_bvh
from ._clip import JointClip
from ._glb import read_glb
from ._joint_angles import Targets, joint_angles

SUFFIXES = (".bvh", ".glb", ".gltf", ".vrm")
_NUMBER = {body: number for number, (body, _, _) in enumerate(BODIES)}
_PARENT = {body: parent for body, parent, _ in BODIES}
_SAME_PLACE = 1e-3
"""Metres."""


def read_motion(
    path: str | Path,
    character: Character | None = None,
    *,
    mapping: str | Path | Mapping[str, str] | None = None,
    animation: str | None = None,
    metres_per_unit: float | None = None,
) -> Motion:
    """The motion of a BVH, GLB, glTF or VRM file, as `character` would move.

    Joints are recognised as by `Character.load`, whose `mapping` this is. The clip's own skeleton is built at its rest
    pose, bones are made to point and bodies to turn as in the clip, and the joint angles, measured from the neutral
    body, are given to the character: so the two may rest in different poses. Lengths are scaled so that the clip's legs
    become as long as the character's and feet stay where they stand; `metres_per_unit` says instead what the
    file's unit is, for a motion that is to be compared in place. What our skeleton cannot do (a wrist that bends,
    fingers, toes) is left out.

    `animation` names one of several. Without a character, the one in a skinned glTF is taken. Times are the
    file's. Raises `InputError` for a file that cannot be read, joints that are not recognised, and unknown clips.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{path} is none of the clips that are read; expected a file in {', '.join(SUFFIXES)}.")
    if metres_per_unit is not None and not (np.isfinite(metres_per_unit) and metres_per_unit > 0):
        raise InputError(f"metres_per_unit is {metres_per_unit}; expected a number above 0, such as 0.01.")
    if character is None and suffix == ".bvh":
        raise InputError(f"{path} holds a skeleton without a body; give the character that is to move.")
    found = read_bvh(path, mapping) if suffix == ".bvh" else read_glb(path, mapping, animation)
    own_body = character is None
    character = Character.load(path, mapping) if character is None else character
    if not np.isfinite(found.worlds).all():
        raise InputError(f"{path} has joints whose places are not finite; the file is damaged, export it again.")
    own = _in_metres(found, character.skeleton, metres_per_unit)
    arm = "wrist7" if "l_wrist_flex" in character.skeleton.dof_names else "cmu7"
    try:
        skeleton, root, targets = build_skeleton(own.rig.places, arm), _body(own, "pelvis"), _targets(own)
    except (ValueError, np.linalg.LinAlgError) as error:
        raise InputError(f"{path} has joints that make no person ({str(error).rstrip('.')}).") from error
    angles = joint_angles(skeleton, root, targets) + angles_at_rest(skeleton) - angles_at_rest(character.skeleton)
    placed = root.copy()
    pelvis = root[:, :3, :3] @ own.rig.places["pelvis"] + root[:, :3, 3]
    placed[:, :3, 3] = pelvis - root[:, :3, :3] @ np.asarray(character.skeleton.pelvis, np.float64)
    first = away_from_limits(
        character.skeleton, Pose(jnp.asarray(placed[0], jnp.float32), jnp.asarray(angles[0], jnp.float32))
    )
    angles[0] = np.asarray(first.angles)
    poses = Pose(jnp.asarray(placed, jnp.float32), jnp.asarray(angles, jnp.float32))
    provenance = {"clip": str(path.resolve())} | ({"actor": str(path.resolve())} if own_body else {})
    frames = np.arange(len(placed))
    return continuous(Motion.from_poses(character, poses, frames, own.timestamps, provenance=provenance, up=own.up))


def _in_metres(clip: JointClip, skeleton: Skeleton, metres_per_unit: float | None) -> JointClip:
    places = clip.rig.places
    if metres_per_unit is None:
        theirs = {name: np.asarray(skeleton.landmark(name), np.float64) for name in skeleton.landmark_names}
        metres_per_unit = _legs(theirs) / max(_legs(places), 1e-12)
    worlds, rests = clip.worlds.copy(), clip.rig.rest_from_joint.copy()
    worlds[..., :3, 3] *= metres_per_unit
    rests[..., :3, 3] *= metres_per_unit
    places = {name: metres_per_unit * place for name, place in places.items()}
    return clip._replace(worlds=worlds, rig=clip.rig._replace(rest_from_joint=rests, places=places))


def _legs(places: Mapping[str, np.ndarray]) -> float:
    """Length of both legs from hip to ankle."""
    bones = [(f"{side}_{a}", f"{side}_{b}") for side in "lr" for a, b in (("hip", "knee"), ("knee", "ankle"))]
    return float(sum(np.linalg.norm(places[a] - places[b]) for a, b in bones))


def _body(clip: JointClip, body: str) -> Float[np.ndarray, "frame 4 4"]:
    """The rigid transform, world from rest, of a body that begins at a joint."""
    joint = clip.rig.anchors[body]
    rest = clip.rig.rest_from_joint[joint]
    moved = (clip.worlds[:, joint] @ np.linalg.inv(rest))[:, :3, :3]
    rigid = np.tile(np.eye(4), (len(moved), 1, 1))
    rigid[:, :3, :3] = Rotation.from_matrix(moved / np.cbrt(np.linalg.det(moved))[:, None, None]).as_matrix()
    rigid[:, :3, 3] = clip.worlds[:, joint, :3, 3] - rigid[:, :3, :3] @ rest[:3, 3]
    return rigid


def _targets(clip: JointClip) -> Targets:
    """Rotations of all bodies that begin at a joint, and the bones between such joints."""
    rig, count = clip.rig, len(clip.worlds)
    rotations = np.full((count, len(BODIES), 3, 3), np.nan)
    for number, (body, _, _) in enumerate(BODIES):
        if body in rig.anchors:
            rotations[:, number] = _body(clip, body)[:, :3, :3]
    # The joint of a trunk that has only one may lie where ours has the other; then it is no end of a bone.
    ends = {
        body: joint
        for body, _, joint in BODIES
        if body in rig.anchors
        and np.linalg.norm(rig.rest_from_joint[rig.anchors[body]][:3, 3] - rig.places[joint]) < _SAME_PLACE
    }
    if "abdomen" not in rig.anchors and "chest" not in ends:
        rotations[:, _NUMBER["abdomen"]] = rotations[:, _NUMBER["chest"]]
    bones, vectors = [], []
    for body, above, joint in BODIES[1:]:
        while above not in ends and above:
            above = _PARENT[above]
        if body in ends and above:
            a, b = rig.anchors[above], rig.anchors[body]
            bones.append((ends[above], joint))
            vectors.append(clip.worlds[:, b, :3, 3] - clip.worlds[:, a, :3, 3])
    return Targets(rotations, tuple(bones), np.stack(vectors, axis=1))
