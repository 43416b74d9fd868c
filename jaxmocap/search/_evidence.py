"""What a drawn pose shows, what it costs limb by limb, and what it leaves unexplained."""

from typing import NamedTuple

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxmocap._cache import cached_jit
from jaxmocap.character import Character, Pose
from jaxmocap.energies import covered_cost
from jaxmocap.observation import FrameProblem, draw
from jaxmocap.render import to_screen


@cached_jit
def covered_costs(ids: Int[Array, "camera height width"], problem: FrameProblem) -> Float[Array, "camera height width"]:
    """Eq. 6 per pixel as if every pixel were covered by its face."""
    table = problem.surface.colour_distance
    flat = jnp.maximum(ids, 0) * table.shape[2] + problem.labels
    foreground = jnp.stack([table[c].reshape(-1)[flat[c]] for c in range(problem.num_cameras)]).astype(jnp.float32)
    return covered_cost(foreground, problem.background)


@jax.jit
def _screens(vertices: Float[Array, "vertex 3"], problem: FrameProblem) -> Float[Array, "camera 3 vertex"]:
    return jax.vmap(to_screen, in_axes=(None, 0, 0))(vertices, problem.projection, problem.origins)


class Seen(NamedTuple):
    """Face ids of a pose in the rectangle, Eq. 6 of each pixel by its face, and the face drawn where each vertex
    projects to, -1 for none."""

    ids: Int[np.ndarray, "camera height width"]
    costs: Float[np.ndarray, "camera height width"]
    over: Int[np.ndarray, "camera vertex"]


def look_at(character: Character, pose: Pose, problem: FrameProblem) -> Seen:
    """Draw a pose and cost its pixels."""
    vertices, ids, _ = draw(character, pose, problem)
    drawn, over = np.asarray(ids), np.full((problem.num_cameras, vertices.shape[0]), -1)
    for camera, screen in enumerate(np.asarray(_screens(vertices, problem))):
        column, row = np.nan_to_num(np.round(screen[:2]), nan=-1.0).clip(-1, 2**15).astype(int)
        inside = (column >= 0) & (row >= 0) & (column < problem.size[1]) & (row < problem.size[0])
        over[camera, inside] = drawn[camera, row[inside], column[inside]]
    return Seen(drawn, np.asarray(covered_costs(ids, problem)), over)


def unexplained(ids: Int[np.ndarray, "camera height width"], problem: FrameProblem) -> float:
    """Share of the person's pixels that look foreign but are not covered, in the view where it is largest; thin seams
    do not count."""
    covered, foreign = ids >= 0, np.asarray(problem.background) > 0.5
    shares = []
    for camera in range(problem.num_cameras):
        beside = (foreign[camera] & ~covered[camera]).astype(np.uint8)
        width = 2 * round(0.05 * np.sqrt(covered[camera].sum()) / 2) + 1
        blobs = cv2.morphologyEx(beside, cv2.MORPH_OPEN, np.ones((width, width), np.uint8))
        shares.append(blobs.sum() / max(covered[camera].sum(), 1))
    return float(max(shares))


def mean_costs(
    groups: list[Bool[np.ndarray, "body"]],
    face_bodies: Int[np.ndarray, "face"],
    ids: Int[np.ndarray, "camera height width"],
    costs: Float[np.ndarray, "camera height width"],
) -> Float[np.ndarray, "group"]:
    """Mean cost over the pixels of each group of bodies, all views together; NaN where none is seen."""
    covered = ids >= 0
    body = face_bodies[ids[covered]]
    bodies = len(groups[0])
    count = np.bincount(body, minlength=bodies)
    total = np.bincount(body, weights=costs[covered], minlength=bodies)
    seen = np.array([count[group].sum() for group in groups])
    return np.array([total[group].sum() for group in groups]) / np.where(seen > 0, seen, np.nan)


def seen_shares(
    groups: list[Bool[np.ndarray, "body"]],
    character: Character,
    face_bodies: Int[np.ndarray, "face"],
    over: Int[np.ndarray, "camera vertex"],
) -> Float[np.ndarray, "group"]:
    """Share of each group's vertices that project to pixels of the group, in the view where it is largest: 1 for a limb
    in front of everything, though half its vertices face away; 0 for one behind the body."""
    own = np.asarray(character.weights).argmax(1)
    below = np.where(over >= 0, face_bodies[over], -1)
    shares = [np.where(below >= 0, group[below], False)[:, group[own]].mean(1).max() for group in groups]
    return np.array(shares)
