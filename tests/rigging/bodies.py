"""People whose joints are known: procedural bodies of other proportions and poses, as bare meshes."""

import json
from collections.abc import Mapping
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from jaxmocap.camera import Cameras
from jaxmocap.character import (
    BodyShape,
    Character,
    Pose,
    angles_at_rest,
    body_transforms,
    landmark_positions,
    scaled,
    skin,
)
from jaxmocap.observation import BODY_25
from jaxmocap.rigging import RiggedMesh
from jaxmocap.synthetic import make_actor

JOINTS = ("neck", *(f"{s}_{j}" for s in "lr" for j in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")))
MEAN, WORST = 2.5, 5.0  # centimetres
STANCES = {  # degrees from the neutral body
    "T": {"shoulder_flex": 0, "shoulder_abd": 0, "shoulder_axial": 0, "elbow_flex": 0},
    "A": {"shoulder_flex": 0, "shoulder_abd": -45, "shoulder_axial": 0, "elbow_flex": 5},
    "relaxed": {"shoulder_flex": 5, "shoulder_abd": -72, "shoulder_axial": 0, "elbow_flex": 15, "hip_abd": 3},
    "one arm up": {"l_shoulder_abd": 70, "r_shoulder_abd": -70, "l_elbow_flex": 20},
}


def tall_person() -> Character:
    """1.9 m, long thighs, short arms, stout."""
    shape = BodyShape.of(0, {"thigh": 0.08, "upper_arm": -0.06}, {"torso": 0.15, "thigh": 0.1})
    return scaled(make_actor(1.9), shape)


def small_person() -> Character:
    """1.5 m, short shanks, slim."""
    shape = BodyShape.of(0, {"shank": -0.06, "torso": 0.05}, {"torso": -0.12, "upper_arm": -0.1})
    return scaled(make_actor(1.5), shape)


def standing(character: Character, stance: str) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Vertices, faces and joints of the character in a stance, metres."""
    skeleton, at_rest = character.skeleton, np.degrees(angles_at_rest(character.skeleton))
    angles = np.zeros(skeleton.num_angles)
    for number, name in enumerate(skeleton.dof_names[6:]):
        for key in {name, name[2:]} & set(STANCES[stance]):
            angles[number] = STANCES[stance][key] - at_rest[number]
    pose = Pose(jnp.eye(4), jnp.asarray(np.radians(angles), jnp.float32))
    places = dict(zip(skeleton.landmark_names, np.asarray(landmark_positions(skeleton, pose), float), strict=True))
    return np.asarray(skin(character, pose), float), np.asarray(character.faces), {j: places[j] for j in JOINTS}


def write_keypoints(
    folder: Path,
    cameras: Cameras,
    joints: Mapping[str, np.ndarray],
    noise: float = 4.0,
    exchanged: tuple[str, ...] = (),
) -> None:
    """What a detector would find in the pictures of a mesh: its joints, with `noise` in pixels, left taken for right
    in the views `exchanged`, as OpenPose files."""
    draw = np.random.default_rng(0)
    places = dict(joints)
    places |= {f"mid_{joint}": 0.5 * (joints[f"l_{joint}"] + joints[f"r_{joint}"]) for joint in ("shoulder", "hip")}
    for camera, name in enumerate(cameras.names):
        points = np.zeros((25, 3))
        for number, parts in BODY_25.items():
            joint = parts[0] if len(parts) == 1 else f"mid_{parts[0][2:]}"
            if name in exchanged and len(parts) == 1:
                joint = {"l": "r", "r": "l"}.get(joint[0], joint[0]) + joint[1:]
            if joint in places:
                pose = np.asarray(cameras.cam_from_world[camera, 0], float)
                pixel = np.asarray(cameras.intrinsics[camera], float) @ (pose[:3, :3] @ places[joint] + pose[:3, 3])
                points[number] = *(pixel[:2] / pixel[2] + noise * draw.standard_normal(2)), 0.8
        write_people(folder / f"{name}_keypoints.json", points)


def write_people(file: Path, *people: np.ndarray) -> None:
    """An OpenPose file."""
    file.write_text(json.dumps({"people": [{"pose_keypoints_2d": points.ravel().tolist()} for points in people]}))


def errors(rigged: RiggedMesh, truth: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Centimetres from each joint to where it is in truth, which is in the file's units and axes."""
    matrix, skeleton = rigged.rest_from_file, rigged.character.skeleton
    there = {joint: matrix[:3, :3] @ place + matrix[:3, 3] for joint, place in truth.items()}
    return {j: 100 * float(np.linalg.norm(np.asarray(skeleton.landmark(j)) - there[j])) for j in there}


def within_bounds(rigged: RiggedMesh, truth: Mapping[str, np.ndarray]) -> None:
    """Assert that the joints are where they should be, on average and each."""
    off = errors(rigged, truth)
    assert np.mean(list(off.values())) < MEAN, off
    assert max(off.values()) < WORST, off


def tall(character: Character) -> float:
    """Metres from the lowest point at rest to the highest."""
    return float(np.ptp(np.asarray(character.vertices)[:, 1]))


def turned_out(character: Character) -> float:
    """The largest share of triangles that face against their own bones' rotation, over the limits of every joint."""
    rest, faces, skeleton = np.asarray(character.vertices, float), np.asarray(character.faces), character.skeleton
    weights, normals = np.asarray(character.weights)[faces].mean(axis=1), _normals(rest, faces)
    worst = 0.0
    for number in range(skeleton.num_angles):
        for limit in (skeleton.lower, skeleton.upper):
            angles = np.zeros(skeleton.num_angles, np.float32)
            angles[number] = limit[number]
            pose = Pose(jnp.eye(4), jnp.asarray(angles))
            turn = np.asarray(body_transforms(skeleton, pose), float)[:, :3, :3]
            expected = np.einsum("fb,bij,fj->fi", weights, turn, normals, optimize=True)
            found = _normals(np.asarray(skin(character, pose), float), faces)
            worst = max(worst, float(np.mean(np.sum(found * expected, axis=1) < 0)))
    return worst


def _normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    return np.cross(b - a, c - a)
