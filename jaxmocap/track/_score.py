"""Eq. 5 of whole poses, and what they leave unexplained."""

from typing import NamedTuple

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxmocap._kept_programs import kept_jit, run_often
from jaxmocap.character import Character, Pose, difference
from jaxmocap.energies import Region, SearchEnergy, body_part, covered_cost, prepare_base, score_particles
from jaxmocap.observation import FrameProblem
from jaxmocap.render import to_screen

from ._register import draw


@run_often
def _score(energy, character, part, pose, problem, increments, capacity):
    height, width = problem.size
    region = Region(jnp.zeros((problem.num_cameras, 2), jnp.int32), (height, width))
    base = prepare_base(energy, character, part, pose, problem, region, capacity)
    return score_particles(energy, character, part, pose, problem, region, base, increments, capacity)


class PoseScore:
    """Scores some poses on the full problem; the windows' capacity grows when needed (host)."""

    def __init__(self, energy: SearchEnergy, character: Character):
        self.energy = energy
        self.character = character
        self.part = body_part(character, character.skeleton.group("root"))
        self.capacity = 2 ** (character.faces.shape[0] - 1).bit_length()

    def __call__(self, problem: FrameProblem, poses: list[Pose]) -> tuple[np.ndarray, np.ndarray]:
        """Totals (pose,) and terms (pose, term)."""
        moved = [np.asarray(difference(self.character.skeleton, poses[0], pose)) for pose in poses]
        increments = jnp.asarray(np.stack(moved + moved[-1:] * (-len(poses) % 4)))  # few and many compile once
        while True:
            scores = _score(self.energy, self.character, self.part, poses[0], problem, increments, self.capacity)
            needed = int(scores.needed)
            if needed <= self.capacity:
                return np.asarray(scores.total)[: len(poses)], np.asarray(scores.terms)[: len(poses)]
            self.capacity = 2 ** (needed - 1).bit_length()


@kept_jit
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
