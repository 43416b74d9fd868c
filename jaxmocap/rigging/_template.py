"""The body that is laid into a mesh: the procedural actor, with its pose and proportions as 58 numbers."""

from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmocap.character import (
    GIRTHS,
    LENGTHS,
    ROOT_DOFS,
    BodyShape,
    Character,
    Pose,
    landmark_positions,
    rest_pose,
    retract,
    scaled,
    skin,
)
from jaxmocap.synthetic import make_actor

NUM_SHAPE = 1 + len(LENGTHS) + len(GIRTHS)
_EVERY = 4  # of the template's vertices, those that correspondences are made for


class Body(NamedTuple):
    """The template in some pose and proportions: `root` (4, 4), joint `angles` in radians, and `shape` (19,), the
    logarithms of `BodyShape`."""

    root: Float[np.ndarray, "4 4"]
    angles: Float[np.ndarray, " dof"]
    shape: Float[np.ndarray, " scale"]


@lru_cache(maxsize=1)
def template() -> Character:
    """Make the procedural actor, 1.75 m tall."""
    return make_actor()


@lru_cache(maxsize=1)
def probes() -> np.ndarray:
    """Choose the vertices of `template` that correspondences are made for, as indices."""
    return np.arange(0, len(template().vertices), _EVERY)


def body_at_rest(root: Float[np.ndarray, "4 4"]) -> Body:
    """Put the template, as it is, at a root transform."""
    return Body(root, np.zeros(template().skeleton.num_angles), np.zeros(NUM_SHAPE))


def moved(body: Body, step: Float[np.ndarray, " parameter"]) -> Body:
    """Move the body by a step: the increment of `retract`, then 19 numbers of the shape."""
    dofs = template().skeleton.num_dofs
    pose = _moved(_arrays(body), jnp.asarray(step[:dofs], jnp.float32))
    return Body(np.asarray(pose.root, np.float64), np.asarray(pose.angles, np.float64), body.shape + step[dofs:])


def surface(body: Body) -> tuple[Float[np.ndarray, "vertex 3"], Float[Array, "probe 3 parameter"]]:
    """Compute the vertices of the body, and the derivative of the probed ones by a step."""
    vertices, jacobian = _surface(template(), jnp.asarray(probes()), _arrays(body))
    return np.asarray(vertices, np.float64), jacobian


def squares(
    jacobian: Float[Array, "probe 3 parameter"],
    metric: Float[np.ndarray, "probe 3 3"],
    pull: Float[np.ndarray, "probe 3"],
) -> tuple[Float[np.ndarray, "parameter parameter"], Float[np.ndarray, " parameter"]]:
    """Build Hessian and gradient of squared displacements in a metric per probe; `pull` is metric times residual."""
    hessian, gradient = _squares(jacobian, jnp.asarray(metric, jnp.float32), jnp.asarray(pull, jnp.float32))
    return np.array(hessian, np.float64), np.array(gradient, np.float64)


def landmarks(body: Body) -> dict[str, np.ndarray]:
    """Return joints and other landmarks of the body by name."""
    places = np.asarray(_landmarks(template(), _arrays(body)), np.float64)
    return dict(zip(template().skeleton.landmark_names, places, strict=True))


def joint_slopes(body: Body) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return landmarks of the body by name, and their derivatives (3, 58) by a step."""
    places, slopes = _slopes(template(), _arrays(body))
    names = template().skeleton.landmark_names
    return (
        dict(zip(names, np.asarray(places, np.float64), strict=True)),
        dict(zip(names, np.asarray(slopes, np.float64), strict=True)),
    )


def shape_of(numbers: Array) -> BodyShape:
    """Turn the 19 numbers into a `BodyShape`."""
    return BodyShape(numbers[0], numbers[1 : 1 + len(LENGTHS)], numbers[1 + len(LENGTHS) :])


def _arrays(body: Body) -> tuple[Pose, Array]:
    single = lambda values: jnp.asarray(values, jnp.float32)  # noqa: E731
    return Pose(single(body.root), single(body.angles)), single(body.shape)


@jax.jit
def _moved(body: tuple[Pose, Array], step: Float[Array, " dof"]) -> Pose:
    return retract(scaled(template(), shape_of(body[1])).skeleton, body[0], step)


@jax.jit
def _surface(character: Character, probed: Array, body: tuple[Pose, Array]) -> tuple[Array, Array]:
    pose, shape = body
    few = Character(
        character.name, character.skeleton, character.vertices[probed], character.faces, character.weights[probed]
    )

    def place(step: Float[Array, " parameter"]) -> Float[Array, "probe 3"]:
        dofs = character.skeleton.num_dofs
        sized = scaled(few, shape_of(shape + step[dofs:]))
        return skin(sized, retract(sized.skeleton, pose, step[:dofs]))

    jacobian = jax.jacfwd(place)(jnp.zeros(character.skeleton.num_dofs + NUM_SHAPE))
    return skin(scaled(character, shape_of(shape)), pose), jacobian


@jax.jit
def _squares(jacobian: Array, metric: Array, pull: Array) -> tuple[Array, Array]:
    flat = jacobian.reshape(-1, jacobian.shape[-1])
    pushed = jnp.einsum("nij,njp->nip", metric, jacobian, precision="highest").reshape(flat.shape)
    square = jnp.matmul(flat.T, pushed, precision="highest")
    return square, jnp.matmul(flat.T, pull.ravel(), precision="highest")


@jax.jit
def _slopes(character: Character, body: tuple[Pose, Array]) -> tuple[Array, Array]:
    pose, shape = body

    def place(step: Float[Array, " parameter"]) -> Float[Array, "landmark 3"]:
        dofs = character.skeleton.num_dofs
        skeleton = scaled(character, shape_of(shape + step[dofs:])).skeleton
        return landmark_positions(skeleton, retract(skeleton, pose, step[:dofs]))

    still = jnp.zeros(character.skeleton.num_dofs + NUM_SHAPE)
    return place(still), jax.jacfwd(place)(still)


@jax.jit
def _landmarks(character: Character, body: tuple[Pose, Array]) -> Float[Array, "landmark 3"]:
    return landmark_positions(scaled(character, shape_of(body[1])).skeleton, body[0])


def rest_angles_of(arms: float) -> Float[np.ndarray, " dof"]:
    """Find the joint angles that turn the template's arms by `arms` radians upwards."""
    skeleton = template().skeleton
    angles = np.array(rest_pose(skeleton).angles, np.float64)
    for side in "lr":
        angles[skeleton.dof_names.index(f"{side}_shoulder_abd") - ROOT_DOFS] = arms
    return angles
