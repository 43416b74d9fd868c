"""`read_motion`: a clip of another program as a `Motion` of one of our characters."""

from collections.abc import Mapping
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from jaxmocap._results import InputError
from jaxmocap.character import Character, Pose, angles_at_rest, away_from_limits, build_skeleton
from jaxmocap.motion import Motion, continuous

from ._bvh import read_bvh
from ._clip import body_transform, in_metres, targets_of
from ._glb import read_glb
from ._joint_angles import joint_angles

SUFFIXES = (".bvh", ".glb", ".gltf", ".vrm")


def read_motion(
    path: str | Path,
    character: Character | None = None,
    *,
    mapping: str | Path | Mapping[str, str] | None = None,
    animation: str | None = None,
    metres_per_unit: float | None = None,
) -> Motion:
    """Read a BVH, GLB, glTF or VRM file as a motion of `character`.

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
    own = in_metres(found, character.skeleton, metres_per_unit)
    arm = "wrist7" if "l_wrist_flex" in character.skeleton.dof_names else "cmu7"
    try:
        skeleton, root, targets = build_skeleton(own.rig.places, arm), body_transform(own, "pelvis"), targets_of(own)
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
