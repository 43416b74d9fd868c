"""The synthetic actor: one closed skin over the procedural body, bound to the skeleton of a person, its markers, and
somebody who walks past."""

from functools import lru_cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy import sparse

from jaxmocap.character import Character, Pose, Skeleton, build_skeleton, landmark_positions, skin
from jaxmocap.geometry import surface_nets

from ._body import CENTRE_JOINTS, SIDE_JOINTS, TEMPLATE_HEIGHT, sheared, side_joint, skin_distance
from ._clothes import Outfit, Subject
from ._motion import perform

MAX_BONES = 4
_BEHIND = (0.8, 2.0)
_PACE = (0.7, 1.4)
_HINTS = ("knuckles", "fingertips", "thumb")
# Body -> segments (joint names; l_/r_ is put before the side ones) and the radius of the flesh around them.
_CENTRE_FLESH: dict[str, tuple[list[tuple[str, str]], float]] = {
    "pelvis": ([("pelvis", "spine"), ("l_hip", "r_hip")], 0.105),
    "abdomen": ([("spine", "thorax")], 0.125),
    "chest": ([("thorax", "neck")], 0.125),
    "head": ([("neck", "head"), ("head", "head_top")], 0.060),
}
_SIDE_FLESH: dict[str, tuple[list[tuple[str, str]], float]] = {
    "clavicle": ([("clavicle", "shoulder")], 0.058),
    "upper_arm": ([("shoulder", "elbow")], 0.048),
    "forearm": ([("elbow", "wrist")], 0.036),
    "hand": ([("wrist", "knuckles"), ("knuckles", "fingertips"), ("wrist", "thumb")], 0.026),
    "thigh": ([("hip", "knee")], 0.078),
    "shank": ([("knee", "ankle")], 0.046),
    "foot": ([("ankle", "toe"), ("ankle", "heel")], 0.040),
}


def make_actor(height: float = TEMPLATE_HEIGHT) -> Character:
    """Make a person of `height` metres in an A-pose with slightly bent elbows.

    The mesh has about 4,900 triangles, the same at every height, and at most 4 bones per vertex.
    """
    vertices, faces, weights = _template()
    scale = height / TEMPLATE_HEIGHT
    return Character(
        name="synthetic actor",
        skeleton=actor_skeleton(height),
        vertices=jnp.asarray(scale * vertices, jnp.float32),
        faces=jnp.asarray(faces, jnp.int32),
        weights=jnp.asarray(weights, jnp.float32),
    )


def actor_skeleton(height: float = TEMPLATE_HEIGHT) -> Skeleton:
    """Make the actor's skeleton alone, its joints where the anatomy puts them."""
    scale = height / TEMPLATE_HEIGHT
    return build_skeleton({name: scale * place for name, place in _joints().items() if name[2:] not in _HINTS})


def _joints() -> dict[str, np.ndarray]:
    joints = {name: np.asarray(place) for name, place in CENTRE_JOINTS.items()}
    for prefix, side in (("l_", 1.0), ("r_", -1.0)):
        joints |= {prefix + name: side_joint(name, side) for name in SIDE_JOINTS}
    return joints


@lru_cache(maxsize=1)
def _template() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    vertices, faces = surface_nets(skin_distance, _grid())
    return vertices, faces, skin_weights(actor_skeleton(), vertices, faces)


def _grid() -> Float[np.ndarray, "i j k 3"]:
    """Lay out grid points whose cells are long where the body is plain, and sheared so that arms run along cells."""
    half = _graded(0.0, (0.23, 0.0275), (0.58, 0.039), (0.71, 0.026))
    x = np.concatenate([-half[:0:-1], half])
    y = _graded(-0.03, (0.12, 0.030), (0.86, 0.056), (1.06, 0.036), (1.33, 0.046), (1.48, 0.028), (1.80, 0.029))
    z = _graded(-0.17, (0.25, 0.0265))
    return sheared(np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1), -1.0)


def _graded(start: float, *pieces: tuple[float, float]) -> np.ndarray:
    """Space coordinates from `start` through pieces of (end, about this step)."""
    knots = [np.array([start])]
    for end, step in pieces:
        knots.append(np.linspace(knots[-1][-1], end, max(1, round((end - knots[-1][-1]) / step)) + 1)[1:])
    return np.concatenate(knots)


def skin_weights(
    skeleton: Skeleton, vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"]
) -> Float[np.ndarray, "vertex bone"]:
    """Compute skinning weights that fall off with the distance to the bones, for template-sized vertices.

    Each vertex belongs to the body whose flesh is nearest and shares with that body's neighbours in the skeleton only,
    so an arm never moves the flank beside it; a few averaging steps along the surface then make the weights smooth.
    """
    depth, radii = _flesh_distances(skeleton.body_names, vertices)
    owner = depth.argmin(axis=1)
    parents = np.asarray(skeleton.parents)
    linked = np.eye(len(parents), dtype=bool)
    linked[np.arange(1, len(parents)), parents[1:]] = linked[parents[1:], np.arange(1, len(parents))] = True
    softness = 0.22 * np.sqrt(radii[owner][:, None] * radii)
    weights = np.where(linked[owner], np.exp(-(depth - depth.min(axis=1, keepdims=True)) / softness), 0.0)
    weights /= weights.sum(axis=1, keepdims=True)
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    adjacency = sparse.coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(len(vertices),) * 2).tocsr()
    mean = sparse.diags_array(1 / adjacency.sum(axis=1)) @ adjacency
    for _ in range(4):
        weights = 0.5 * (weights + mean @ weights)
    weights[weights < 0.004] = 0.0
    least = np.sort(weights, axis=1)[:, -MAX_BONES][:, None]
    weights = np.where(weights >= least, weights, 0.0)
    return weights / weights.sum(axis=1, keepdims=True)


def _flesh_distances(bodies: tuple[str, ...], vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Measure the distance of each vertex to each body's flesh (negative inside), and the radius of that flesh."""
    joints = _joints()
    depth, radii = np.empty((len(vertices), len(bodies))), np.empty(len(bodies))
    for column, body in enumerate(bodies):
        prefix = body[:2] if body[:2] in ("l_", "r_") else ""
        segments, radii[column] = _SIDE_FLESH[body[2:]] if prefix else _CENTRE_FLESH[body]
        depth[:, column] = np.min(
            [_to_segment(vertices, joints[prefix + a], joints[prefix + b]) for a, b in segments], 0
        )
    return depth - radii, radii


def _to_segment(points: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    axis = end - start
    along = np.clip((points - start) @ axis / (axis @ axis), 0, 1)
    return np.linalg.norm(points - start - along[:, None] * axis, axis=1)


def bind_markers(
    vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"], count: int, seed: int
) -> tuple[Int[np.ndarray, "marker"], Float[np.ndarray, "marker 3"]]:
    """Choose `count` points of the skin, spread evenly: their faces and barycentrics.

    Each is the farthest from those before among random points on the surface.
    """
    rng = np.random.default_rng([seed, 6])
    corners = vertices[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    candidates = rng.choice(len(faces), 2000, p=area / area.sum())
    barycentrics = rng.dirichlet((1.0, 1.0, 1.0), len(candidates))
    points = np.einsum("nc,ncd->nd", barycentrics, corners[candidates])
    chosen = [0]
    distance = np.full(len(points), np.inf)
    while len(chosen) < count:
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
        chosen.append(int(distance.argmax()))
    return candidates[chosen], barycentrics[chosen]


def marker_positions(
    vertices: Float[np.ndarray, "frame vertex 3"],
    faces: Int[np.ndarray, "face 3"],
    marker_faces: Int[np.ndarray, "marker"],
    barycentrics: Float[np.ndarray, "marker 3"],
) -> Float[np.ndarray, "frame marker 3"]:
    """Place the markers on a moving mesh, metres."""
    return np.einsum("mc,fmcd->fmd", barycentrics, vertices[:, faces[marker_faces]])


def posed(
    character: Character, poses: Pose
) -> tuple[Float[np.ndarray, "frame vertex 3"], Float[np.ndarray, "frame landmark 3"]]:
    """Place a character's vertices and landmarks in many poses, which have a leading frame axis."""
    each = [_skinned(character, Pose(*pose)) for pose in zip(poses.root, poses.angles, strict=True)]
    vertices, joints = (np.stack(values).astype(float) for values in zip(*each, strict=True))
    return vertices, joints


@eqx.filter_jit
def _skinned(character: Character, pose: Pose) -> tuple[Float[jax.Array, "vertex 3"], Float[jax.Array, "landmark 3"]]:
    return skin(character, pose), landmark_positions(character.skeleton, pose)


def passing(
    seed: int, times: Float[np.ndarray, "frame"], path: Float[np.ndarray, "frame 3"]
) -> tuple[Subject, Float[np.ndarray, "frame vertex 3"]]:
    """Make somebody who walks past behind where the actor is halfway, and their vertices at all times (seconds).

    `path` are the actor's places on the ground. They step and swing their arms as the dancer does, in clothes of other
    colours.
    """
    rng = np.random.default_rng([seed, 8])
    height, ahead = rng.uniform(1.55, 1.9), rng.choice([-1.0, 1.0])
    person = make_actor(height)
    vertices, _ = posed(person, perform("dance", person.skeleton, times + rng.uniform(5, 15), 0.6))
    middle = path[len(path) // 2] - np.array([0.0, 0.0, rng.uniform(*_BEHIND)])
    along = rng.uniform(-0.5, 0.5) + rng.uniform(*_PACE) * (times - times.mean())
    way = middle + ahead * along[:, None] * np.array([1.0, 0.0, 0.0])
    facing = np.array([[0.0, 0.0, ahead], [0.0, 1.0, 0.0], [-ahead, 0.0, 0.0]])  # they walk to where they look
    rest = np.asarray(person.vertices, np.float32) * np.float32(TEMPLATE_HEIGHT / height)
    style = ("patterned", "uniform", "plain sleeves")[rng.integers(3)]
    outfit = Outfit.make(seed + 1000, style, ((2, 0, 1), (1, 2, 0), (1, 0, 2))[rng.integers(3)])
    turned = vertices @ facing.T + way[:, None]
    return Subject(rest, np.asarray(person.faces), outfit), turned
