"""The body as a sum of coloured Gaussians in space, attached to the bones (Stoll et al. 2011)."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxmocap.character import Character, Pose, blend, capsules, dominant_bodies

_LAYERS = np.sqrt((np.arange(4) + 0.5) / 4)
"""Of the way from bone to skin: points there are spread evenly over a round section."""

_WIDTH = 0.8
"""Standard deviation of a Gaussian in units of the root mean square distance of the part it stands for."""


class GaussianBody(eqx.Module):
    """Gaussians exp(-|x - centre|^2 / (2 sigma^2)), each carried by one bone.

    Attributes:
        centres: at rest, metres.
        sigmas: standard deviations, metres.
        bones: weights of Eq. 1, a 1 in every row.
        colours: what each view sees of it, as `colour_cone` writes colours.
    """

    centres: Float[Array, "gaussian 3"]
    sigmas: Float[Array, "gaussian"]
    bones: Float[Array, "gaussian bone"]
    colours: Float[Array, "camera gaussian 3"]

    def posed(self, character: Character, pose: Pose) -> Float[Array, "gaussian 3"]:
        """Carry the centres to a pose, metres in the world."""
        return blend(character.skeleton, pose, self.centres, self.bones)


def colour_cone(rgb: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Write RGB in [0, 1] as a point of the HSV cone, (S V cos H, S V sin H, V).

    The publication measures distances in HSV; in the cone the hue is no longer torn at red, nor at random in grey.
    """
    red, green, blue = np.moveaxis(np.asarray(rgb), -1, 0)
    value = np.maximum(np.maximum(red, green), blue)
    chroma = value - np.minimum(np.minimum(red, green), blue)
    across, up = red - 0.5 * (green + blue), np.sqrt(0.75) * (green - blue)
    length = np.maximum(np.hypot(across, up), 1e-9)
    return np.stack([chroma * across / length, chroma * up / length, value], -1)


class Filling(NamedTuple):
    """A character filled with Gaussians (host): where each is, how wide, whose it is, and the faces around it.

    Attributes:
        centres: at rest, metres.
        sigmas: standard deviations, metres.
        bones: weights of Eq. 1, a 1 in every row.
        gaussian: of each wedge between bone and skin.
        face: of each wedge.
        mass: of each wedge, cubic metres.
    """

    centres: Float[np.ndarray, "gaussian 3"]
    sigmas: Float[np.ndarray, "gaussian"]
    bones: Float[np.ndarray, "gaussian bone"]
    gaussian: Int[np.ndarray, "wedge"]
    face: Int[np.ndarray, "wedge"]
    mass: Float[np.ndarray, "wedge"]


def filling(character: Character, count: int) -> Filling:
    """Fill a character with `count` Gaussians, at least one per body that owns skin (host).

    Every body is filled with points between its bone and its skin, and the widest cloud of points is cut in two across
    its longest axis until there are enough: Gaussians come out about as wide as the limbs they lie in.
    """
    vertices, faces = np.asarray(character.vertices, np.float64), np.asarray(character.faces)
    corners, owner, bones = vertices[faces], dominant_bodies(character), capsules(character)
    skin = corners.mean(1)
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    start, way = bones.starts[owner], (bones.ends - bones.starts)[owner]
    along = np.einsum("fi,fi->f", skin - start, way) / np.maximum(np.einsum("fi,fi->f", way, way), 1e-12)
    inside = start + np.clip(along, 0.0, 1.0)[:, None] * way
    points = (inside + _LAYERS[:, None, None] * (skin - inside)).reshape(-1, 3)
    face = np.tile(np.arange(len(faces)), len(_LAYERS))
    mass = area[face] * np.linalg.norm(skin - inside, axis=1)[face]  # of a wedge between bone and skin
    label = _halved(points, mass, owner[face], count)
    total = np.bincount(label, mass)
    centres = np.stack([np.bincount(label, mass * points[:, axis]) for axis in range(3)], 1) / total[:, None]
    square = np.bincount(label, mass * ((points - centres[label]) ** 2).sum(1)) / total
    body = np.zeros((len(total), len(character.skeleton.body_names)), np.float32)
    body[label, owner[face]] = 1.0
    return Filling(centres, _WIDTH * np.sqrt(square), body, label, face, mass)


def gaussian_body(
    character: Character,
    face_colours: Float[np.ndarray, "camera face 3"],
    known: Float[np.ndarray, "camera face"],
    count: int,
) -> GaussianBody:
    """Fill a character with `count` Gaussians, and colour them (host).

    Colours are mean RGB of the faces around (`face_colours` in [0, 1], those with `known` > 0), of all views where a
    view knows none. A Gaussian of which no view knows the colour is left out.
    """
    filled = filling(character, count)
    colours, seen = _colours(filled, face_colours, known)
    return GaussianBody(
        jnp.asarray(filled.centres[seen], jnp.float32),
        jnp.asarray(filled.sigmas[seen], jnp.float32),
        jnp.asarray(filled.bones[seen]),
        jnp.asarray(colour_cone(colours[:, seen]), jnp.float32),
    )


def _halved(
    points: Float[np.ndarray, "point 3"], mass: Float[np.ndarray, "point"], owner: Int[np.ndarray, "point"], count: int
) -> Int[np.ndarray, "point"]:
    """Cut the clouds of the owners, always the widest one at its middle, until there are `count`; number them."""
    label = np.unique(owner, return_inverse=True)[1]
    number = label.max() + 1
    cuts = [_longest(points[label == one], mass[label == one]) for one in range(number)]
    while number < count:
        widest = int(np.argmax([width for width, _, _ in cuts]))
        _, axis, middle = cuts[widest]
        label[(label == widest) & (points @ axis > middle)] = number
        cuts[widest] = _longest(points[label == widest], mass[label == widest])
        cuts.append(_longest(points[label == number], mass[label == number]))
        number += 1
    return label


def _longest(
    points: Float[np.ndarray, "point 3"], mass: Float[np.ndarray, "point"]
) -> tuple[float, Float[np.ndarray, "3"], float]:
    """Return the mean squared distance from the middle, the longest axis, and the middle along it."""
    share = mass / max(mass.sum(), 1e-12)
    middle = share @ points
    off = points - middle
    values, axes = np.linalg.eigh((share[:, None] * off).T @ off)
    return float(values.sum()), axes[:, -1], float(axes[:, -1] @ middle)


def _colours(
    filled: Filling, face_colours: Float[np.ndarray, "camera face 3"], known: Float[np.ndarray, "camera face"]
) -> tuple[Float[np.ndarray, "camera gaussian 3"], Bool[np.ndarray, "gaussian"]]:
    """Average RGB per view and Gaussian, and mark the Gaussians that any view knows."""
    sums, weights = [], []
    for colours, seen in zip(face_colours, known, strict=True):
        weight = filled.mass * seen[filled.face]
        weights.append(np.bincount(filled.gaussian, weight))
        parts = [np.bincount(filled.gaussian, weight * colours[filled.face, c]) for c in range(3)]
        sums.append(np.stack(parts, 1))
    total, weight = np.stack(sums), np.stack(weights)
    anywhere = total.sum(0) / np.maximum(weight.sum(0), 1e-12)[:, None]
    own = total / np.maximum(weight, 1e-12)[..., None]
    return np.where(weight[..., None] > 0, own, anywhere), weight.sum(0) > 0
