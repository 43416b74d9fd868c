"""What a pose costs (Eq. 5), what it shows limb by limb, and what it leaves unexplained.

Gating, re-search and verdict read the same figures, so they stand below all three.
"""

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxmocap._cache import cached_jit
from jaxmocap.character import Character, Pose, difference, dominant_bodies
from jaxmocap.energies import GroupProblem, Scores, SearchEnergy, body_part, covered_cost, prepare_base, score_particles
from jaxmocap.observation import FrameProblem, draw
from jaxmocap.render import to_screen


@cached_jit
def covered_costs(ids: Int[Array, "camera height width"], problem: FrameProblem) -> Float[Array, "camera height width"]:
    """Compute Eq. 6 per pixel as if every pixel were covered by its face."""
    table = problem.surface.colour_distance
    flat = jnp.maximum(ids, 0) * table.shape[2] + problem.labels
    foreground = jnp.stack([table[c].reshape(-1)[flat[c]] for c in range(problem.num_cameras)])
    return covered_cost(foreground.astype(jnp.float32), problem.background)


@jax.jit
def _screens(vertices: Float[Array, "vertex 3"], problem: FrameProblem) -> Float[Array, "camera 3 vertex"]:
    return jax.vmap(to_screen, in_axes=(None, 0, 0))(vertices, problem.projection, problem.origins)


class DrawnPose(NamedTuple):
    """A pose drawn in a frame's rectangles.

    Attributes:
        pose: the pose.
        ids: the face drawn at each pixel, -1 for none.
        costs: Eq. 6 of each pixel by its face.
        over: the face drawn where each vertex projects to, -1 for none.
    """

    pose: Pose
    ids: Int[np.ndarray, "camera height width"]
    costs: Float[np.ndarray, "camera height width"]
    over: Int[np.ndarray, "camera vertex"]


Bodies = list[Bool[np.ndarray, "body"]]
"""Sets of bodies, such as those of every limb."""


@dataclass(frozen=True)
class Evidence:
    """Draws poses of a character and says what speaks for them (host).

    Attributes:
        character: the skinned mesh.
        face_bodies: the body that moves each face most.
        groups: the bodies that each group of degrees of freedom moves.
        distal: the bodies beyond the elbow or knee of each limb, in the order of the skeleton's limbs.
    """

    character: Character
    face_bodies: Int[np.ndarray, "face"]
    groups: Bodies
    distal: Bodies

    @staticmethod
    def of(character: Character, groups: Bodies | None = None) -> "Evidence":
        """Make the tables of a character; `groups` are those of its skeleton unless given."""
        skeleton = character.skeleton
        groups = [skeleton.bodies_of(name) for name, _ in skeleton.groups] if groups is None else groups
        return Evidence(character, dominant_bodies(character), groups, skeleton.distal_bodies)

    def draw(self, pose: Pose, problem: FrameProblem) -> DrawnPose:
        """Draw a pose and cost its pixels."""
        vertices, ids, _ = draw(self.character, pose, problem)
        drawn, over = np.asarray(ids), np.full((problem.num_cameras, vertices.shape[0]), -1)
        for camera, screen in enumerate(np.asarray(_screens(vertices, problem))):
            column, row = np.nan_to_num(np.round(screen[:2]), nan=-1.0).clip(-1, 2**15).astype(int)
            inside = (column >= 0) & (row >= 0) & (column < problem.size[1]) & (row < problem.size[0])
            over[camera, inside] = drawn[camera, row[inside], column[inside]]
        return DrawnPose(pose, drawn, np.asarray(covered_costs(ids, problem)), over)

    def mean_costs(self, drawn: DrawnPose, of: Bodies) -> Float[np.ndarray, "set"]:
        """Average the cost over the pixels of each set of bodies, all views together; NaN where none is seen."""
        covered = drawn.ids >= 0
        body = self.face_bodies[drawn.ids[covered]]
        bodies = len(of[0])
        count = np.bincount(body, minlength=bodies)
        total = np.bincount(body, weights=drawn.costs[covered], minlength=bodies)
        seen = np.array([count[group].sum() for group in of])
        return np.array([total[group].sum() for group in of]) / np.where(seen > 0, seen, np.nan)

    def limb_costs(self, drawn: DrawnPose) -> Float[np.ndarray, "limb"]:
        """Average the cost over the distal half of each limb; NaN where it is not seen."""
        return self.mean_costs(drawn, self.distal)

    def limb_shares(self, drawn: DrawnPose) -> Float[np.ndarray, "limb"]:
        """Measure how much of each limb's distal half is seen, in the view where that is largest.

        It is the share of its vertices that project to pixels of it: 1 for a limb in front of everything, though half
        its vertices face away; 0 for one behind the body.
        """
        own = np.asarray(self.character.weights).argmax(1)
        below = np.where(drawn.over >= 0, self.face_bodies[drawn.over], -1)
        shares = [np.where(below >= 0, limb[below], False)[:, limb[own]].mean(1).max() for limb in self.distal]
        return np.array(shares)


def uncovered_share(ids: Int[np.ndarray, "camera height width"], problem: FrameProblem) -> float:
    """Measure the share of the person's pixels that look foreign but are not covered.

    The view in which it is largest counts; thin seams do not.
    """
    covered, foreign = ids >= 0, np.asarray(problem.background) > 0.5
    shares = []
    for body, unlike in zip(covered, foreign, strict=True):
        shares.append(without_seams(unlike & ~body, body).sum() / max(body.sum(), 1))
    return float(max(shares))


def without_seams(
    marked: Bool[np.ndarray, "height width"], covered: Bool[np.ndarray, "height width"]
) -> Bool[np.ndarray, "height width"]:
    """Remove seams thinner than a twentieth of the body's size in this view from the marked pixels."""
    width = 2 * round(0.05 * np.sqrt(covered.sum()) / 2) + 1
    return cv2.morphologyEx(marked.astype(np.uint8), cv2.MORPH_OPEN, np.ones((width, width), np.uint8)) > 0


@cached_jit
def _score(
    energy: SearchEnergy,
    group: GroupProblem,
    increments: Float[Array, "particle dof"],
    live: Bool[Array, "particle"],
    capacity: int,
) -> Scores:
    return score_particles(energy, group, prepare_base(energy, group, capacity), increments, capacity, live=live)


ROWS = 8
"""Poses scored by one call of the compiled program: a frame's start has as many, and what is missing costs nothing."""


class PoseScore:
    """Scores some poses on the full problem; the windows' capacity grows when needed (host)."""

    def __init__(self, energy: SearchEnergy, character: Character):
        self.energy = energy
        self.character = character
        self.part = body_part(character, character.skeleton.group("root"))
        self.capacity = 2 ** (character.faces.shape[0] - 1).bit_length()

    def __call__(self, problem: FrameProblem, poses: list[Pose]) -> tuple[np.ndarray, np.ndarray]:
        """Score poses: totals (pose,) and terms (pose, term)."""
        skeleton = self.character.skeleton
        moved = np.stack([np.asarray(difference(skeleton, poses[0], pose)) for pose in poses])
        group = GroupProblem(self.character, self.part, poses[0], problem)
        chunks = [self._chunk(group, moved[first : first + ROWS]) for first in range(0, len(moved), ROWS)]
        totals, terms = zip(*chunks, strict=True)
        return np.concatenate(totals), np.concatenate(terms)

    def _chunk(self, group: GroupProblem, moved: Float[np.ndarray, "pose dof"]) -> tuple[np.ndarray, np.ndarray]:
        """Score at most `ROWS` increments, which the devices take in turn."""
        places = np.argsort(np.arange(ROWS) % jax.local_device_count(), kind="stable").argsort()[: len(moved)]
        increments, live = np.zeros((ROWS, moved.shape[1]), np.float32), np.zeros(ROWS, bool)
        increments[places], live[places] = moved, True
        increments, live = jax.device_put((increments, live))
        while True:
            scores = _score(self.energy, group, increments, live, self.capacity)
            needed = int(scores.needed)
            if needed <= self.capacity:
                return np.asarray(scores.total)[places], np.asarray(scores.terms)[places]
            self.capacity = 2 ** (needed - 1).bit_length()
