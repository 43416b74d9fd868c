"""A clip of any format: joints that move, the bodies that they are, and what these bodies do."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from jaxmocap.character import BODIES, RawSkin, Rig, Skeleton

from ._joint_angles import Targets

_NUMBER = {body: number for number, (body, _, _) in enumerate(BODIES)}
_PARENT = {body: parent for body, parent, _ in BODIES}
_SAME_PLACE = 1e-3  # metres


class JointClip(NamedTuple):
    """Joints that move.

    Attributes:
        rig: which body each joint is; places and rest transforms in the file's units.
        worlds: transforms of the rig's joints in the file's own world and units.
        timestamps: seconds.
        up: the world's vertical axis.
    """

    rig: Rig
    worlds: Float[np.ndarray, "frame joint 4 4"]
    timestamps: Float[np.ndarray, " frame"]
    up: str


def meshless(names: Sequence[str], parents: Sequence[int], worlds: Float[np.ndarray, "joint 4 4"]) -> RawSkin:
    """Make joints of no mesh out of their names, their parents and their transforms at rest."""
    return RawSkin(
        vertices=np.zeros((0, 3)),
        faces=np.zeros((0, 3), int),
        weights=np.zeros((0, len(names))),
        joint_names=tuple(names),
        joint_parents=tuple(parents),
        joint_places=worlds[:, :3, 3],
        extras={},
        joint_nodes=tuple(range(len(names))),
        place=np.eye(4),
        inverse_binds=np.linalg.inv(worlds),
    )


def in_metres(clip: JointClip, skeleton: Skeleton, metres_per_unit: float | None) -> JointClip:
    """Scale a clip to metres; without `metres_per_unit`, so that its legs become as long as the skeleton's."""
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
    """Measure both legs from hip to ankle."""
    bones = [(f"{side}_{a}", f"{side}_{b}") for side in "lr" for a, b in (("hip", "knee"), ("knee", "ankle"))]
    return float(sum(np.linalg.norm(places[a] - places[b]) for a, b in bones))


def body_transform(clip: JointClip, body: str) -> Float[np.ndarray, "frame 4 4"]:
    """Find the rigid transform, world from rest, of a body that begins at a joint."""
    joint = clip.rig.anchors[body]
    rest = clip.rig.rest_from_joint[joint]
    moved = (clip.worlds[:, joint] @ np.linalg.inv(rest))[:, :3, :3]
    rigid = np.tile(np.eye(4), (len(moved), 1, 1))
    rigid[:, :3, :3] = Rotation.from_matrix(moved / np.cbrt(np.linalg.det(moved))[:, None, None]).as_matrix()
    rigid[:, :3, 3] = clip.worlds[:, joint, :3, 3] - rigid[:, :3, :3] @ rest[:3, 3]
    return rigid


def targets_of(clip: JointClip) -> Targets:
    """Collect the rotations of all bodies that begin at a joint, and the bones between such joints."""
    rig, count = clip.rig, len(clip.worlds)
    rotations = np.full((count, len(BODIES), 3, 3), np.nan)
    for number, (body, _, _) in enumerate(BODIES):
        if body in rig.anchors:
            rotations[:, number] = body_transform(clip, body)[:, :3, :3]
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
