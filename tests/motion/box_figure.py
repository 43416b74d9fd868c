"""A figure of 18 rigid boxes, one per body, and motions of it: small enough to know every answer."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxmocap.character import Character, Pose, build_skeleton, pose_from_vector
from jaxmocap.motion import Motion

_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
_FACES = np.array(
    [
        *([0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]),
        *([2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]),
    ]
)


def box_character() -> Character:
    """A T-posed box figure of about 1.7 m; box b has vertices 8 b to 8 b + 7 and faces 12 b to 12 b + 11."""
    joints = {"pelvis": (0.0, 0.95, 0.0), "neck": (0.0, 1.45, 0.0), "head": (0.0, 1.55, 0.0)}
    for side, sign in (("l", 1.0), ("r", -1.0)):
        joints |= {f"{side}_shoulder": (0.18 * sign, 1.4, 0.0), f"{side}_elbow": (0.45 * sign, 1.4, 0.0)}
        joints |= {f"{side}_wrist": (0.7 * sign, 1.4, 0.0), f"{side}_hip": (0.1 * sign, 0.9, 0.0)}
        joints |= {f"{side}_knee": (0.1 * sign, 0.5, 0.0), f"{side}_ankle": (0.1 * sign, 0.1, 0.0)}
    skeleton = build_skeleton({name: np.array(place) for name, place in joints.items()})
    vertices, faces, weights = [], [], []
    for body in range(len(skeleton.body_names)):
        places = np.asarray(skeleton.landmarks)[np.array(skeleton.landmark_bodies) == body]
        centre = places.mean(axis=0) if len(places) else np.array([0.0, 1.2, 0.0])
        vertices.append(centre + 0.06 * _CORNERS)
        faces.append(_FACES + 8 * body)
        weights.append(np.tile(np.eye(len(skeleton.body_names))[body], (8, 1)))
    return Character(
        name="boxes",
        skeleton=skeleton,
        vertices=jnp.asarray(np.concatenate(vertices), jnp.float32),
        faces=jnp.asarray(np.concatenate(faces), jnp.int32),
        weights=jnp.asarray(np.concatenate(weights), jnp.float32),
    )


def box_motion(character: Character, num_frames: int = 6, seed: int = 0, **fields) -> Motion:
    """A motion at 30 fps whose poses are drawn at random about the rest pose."""
    rng = np.random.default_rng(seed)
    vectors = jnp.asarray(0.3 * rng.standard_normal((num_frames, character.skeleton.num_dofs)), jnp.float32)
    poses: Pose = jax.vmap(pose_from_vector, in_axes=(None, 0))(character.skeleton, vectors)
    frames = np.arange(num_frames)
    return Motion.from_poses(character, poses, frames, frames / 30, **fields)
