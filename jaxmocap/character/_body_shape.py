"""Proportions of a character: bone lengths and girths as numbers, applied in the rest pose."""

from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._character import Character
from ._dof_table import BODIES
from ._kinematics import times
from ._skeleton import Skeleton

LENGTHS = ("torso", "shoulders", "hips", "head", "upper_arm", "forearm", "hand", "thigh", "shank", "foot")
GIRTHS = ("torso", "head", "upper_arm", "forearm", "hand", "thigh", "shank", "foot")

_ENDS = {  # a limb's body lies along the line between two landmarks
    "upper_arm": ("shoulder", "elbow"),
    "forearm": ("elbow", "wrist"),
    "hand": ("elbow", "wrist"),
    "thigh": ("hip", "knee"),
    "shank": ("knee", "ankle"),
    "foot": ("heel", "toe"),
}
_WIDTHS = {"pelvis": "hips", "abdomen": None, "chest": "shoulders", "clavicle": "shoulders", "head": None}
_BONES = {
    "upper_arm": ("shoulder", "elbow"),
    "forearm": ("elbow", "wrist"),
    "thigh": ("hip", "knee"),
    "shank": ("knee", "ankle"),
    "foot": ("heel", "toe"),
}


class BodyShape(eqx.Module):
    """Natural logarithms of scales; zero is the character as it is. Both sides of the body share theirs.

    `height` scales everything. `lengths` scale, on top of it, the bones `LENGTHS`: along the limb, along the spine
    ("torso"), or across ("shoulders", "hips"). `girths` scale `GIRTHS` across the bone; the torso's is its depth and
    the width of the waist.
    """

    height: Float[Array, "*batch"]
    lengths: Float[Array, "*batch length"]
    girths: Float[Array, "*batch girth"]

    @classmethod
    def of(
        cls,
        height: float = 0.0,
        lengths: Mapping[str, float] | None = None,
        girths: Mapping[str, float] | None = None,
    ) -> "BodyShape":
        """Make a shape from parameters by name; those left out are zero."""
        row = lambda names, given: jnp.asarray([(given or {}).get(name, 0.0) for name in names], jnp.float32)  # noqa: E731
        return cls(jnp.asarray(height, jnp.float32), row(LENGTHS, lengths), row(GIRTHS, girths))


@jax.jit
def scaled(character: Character, shape: BodyShape) -> Character:
    """Give the character other proportions: the same triangles, weights, joint axes and limits, other places.

    Every body is stretched affinely about its joint, a limb along and across its own bone, so bones keep their
    directions; vertices blend these maps by their skinning weights, and the heels keep their height above the floor.
    Differentiable, also under `vmap`; a zero shape gives back the character bit for bit.
    """
    skeleton = character.skeleton
    joints = jnp.stack([skeleton.landmark(joint) for _, _, joint in BODIES])
    stretch = _stretch(skeleton, shape)
    moved = [jnp.zeros(3)]
    for body, parent in list(enumerate(skeleton.parents))[1:]:
        moved.append(moved[parent] + times(stretch[parent], joints[body] - joints[parent]))
    constant = jnp.stack(moved) - times(stretch, joints)  # body b moves a point x by stretch_b x + constant_b

    def carried(points: Float[Array, "point 3"], bodies: tuple[int, ...]) -> Float[Array, "point 3"]:
        index = np.array(bodies, np.uint32)
        return points + times(stretch[index], points) + constant[index]

    landmarks = carried(skeleton.landmarks, skeleton.landmark_bodies)
    heels = np.array([skeleton.landmark_names.index(f"{side}_heel") for side in "lr"], np.uint32)
    lift = jnp.array([0.0, 1.0, 0.0]) * jnp.mean(skeleton.landmarks[heels, 1] - landmarks[heels, 1])
    blended = jnp.einsum("vb,bij->vij", character.weights, stretch, precision="highest")
    drift = jnp.matmul(character.weights, constant, precision="highest")
    return eqx.tree_at(
        lambda c: (c.vertices, c.skeleton.landmarks, c.skeleton.origins),
        character,
        (
            character.vertices + times(blended, character.vertices) + drift + lift,
            landmarks + lift,
            carried(skeleton.origins, skeleton.dof_body) + lift,
        ),
    )


def stature(character: Character) -> Float[Array, ""]:
    """Find how tall the character stands at rest, metres."""
    return jnp.max(character.vertices[:, 1]) - jnp.min(character.vertices[:, 1])


def bone_lengths(skeleton: Skeleton) -> dict[str, Float[Array, ""]]:
    """Measure bones between joints, metres, the mean of both sides.

    The limbs; `shoulders` and `hips` across; `torso` from the middle of the hips to that of the shoulders.
    """
    at = skeleton.landmark
    distance = lambda a, b: jnp.linalg.norm(at(a) - at(b))  # noqa: E731
    trunk = {
        "torso": distance("mid_hip", "mid_shoulder"),
        "shoulders": distance("l_shoulder", "r_shoulder"),
        "hips": distance("l_hip", "r_hip"),
    }
    limbs = {
        name: 0.5 * (distance(f"l_{a}", f"l_{b}") + distance(f"r_{a}", f"r_{b}")) for name, (a, b) in _BONES.items()
    }
    return trunk | limbs


def _stretch(skeleton: Skeleton, shape: BodyShape) -> Float[Array, "bone 3 3"]:
    """Compute what each body's stretch adds to the identity."""
    length: dict[str, Array] = dict(zip(LENGTHS, jnp.expm1(shape.height + shape.lengths), strict=True))
    girth: dict[str, Array] = dict(zip(GIRTHS, jnp.expm1(shape.height + shape.girths), strict=True))
    parts = []
    for name in skeleton.body_names:
        part = name.removeprefix("l_").removeprefix("r_")
        if part in _ENDS:
            start, end = (skeleton.landmark(f"{name[:2]}{joint}") for joint in _ENDS[part])
            along = (end - start) / jnp.linalg.norm(end - start)
            across = girth[part] * jnp.eye(3)
            parts.append(across + (length[part] - girth[part]) * along[:, None] * along)
        else:
            whole, width = ("head" if part == "head" else "torso"), _WIDTHS[part]
            breadth = girth[whole] if width is None else length[width]
            parts.append(jnp.diag(jnp.stack([breadth, length[whole], girth[whole]])))
    return jnp.stack(parts)
