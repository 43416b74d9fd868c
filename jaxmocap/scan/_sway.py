"""How a person who stands sways while a camera goes around: small motions of a skeleton, told by the silhouettes.

Not in the paper. Motions are linear in the skeleton's degrees of freedom, small, smooth over the views and without a
mean; feet stay where they are. Gauss-Newton on the distances between drawn outlines and those of the masks.
"""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from jaxmocap.character import points_and_jacobian, rest_pose
from jaxmocap.refinement import View
from jaxmocap.rigging import rig

NEAREST = 3
"""Vertices of the skinned body from which a point takes its motion."""

TURN = 0.03
"""Radians that a joint turns, and metres that the pelvis moves, standard deviation."""

STEP = 0.5
"""Of the motion from one view to the next, as a share of that."""

PLANTED, FEET = 0.002, 0.06
"""Metres that points of the feet move, standard deviation, and how high above the ground a foot is."""

PIXEL = 0.004
"""Metres that an outline is off for other reasons, standard deviation."""

ROBUST = 0.02
"""Metres at which what one pixel says counts a quarter (Geman and McClure 1985)."""

TOGETHER = 30.0
"""Pixels of an outline that err together."""


class Sway(NamedTuple):
    """Small motions of a body, linear in the degrees of freedom of its skeleton.

    Attributes:
        places: points of the body in its mean pose, metres.
        fields: how they move with each degree of freedom, metres per radian or metre.
        amounts: of each degree of freedom in each view.
        stiffness: the inverse covariance that they are expected to have.
    """

    places: Float[np.ndarray, "place 3"]
    fields: Float[np.ndarray, "place 3 dof"]
    amounts: Float[np.ndarray, "view dof"]
    stiffness: Float[np.ndarray, "dof dof"]

    def only(self, chosen: Bool[np.ndarray, " view"]) -> "Sway":
        """Take some of the views."""
        return self._replace(amounts=self.amounts[chosen])

    @property
    def extent(self) -> float:
        """Tell the standard deviation of the place of the body's points over views and body, metres."""
        return float(np.sqrt((self.moves(self.places) ** 2).sum(axis=-1).mean()))

    def fields_at(self, points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point 3 dof"]:
        """Interpolate the motion of points near the body."""
        distance, index = KDTree(self.places).query(points, k=NEAREST)
        share = 1 / np.maximum(distance, 1e-6)
        share /= share.sum(axis=1, keepdims=True)
        return np.einsum("pk,pkid->pid", share, self.fields[index])

    def moves(self, points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "view point 3"]:
        """Tell by how much points of the mean body are displaced in each view, metres."""
        return np.einsum("pid,vd->vpi", self.fields_at(points), self.amounts, optimize=True)


_moved = jax.jit(points_and_jacobian)


def sway_at_rest(vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"], count: int) -> Sway:
    """Give a surface a skeleton, in its own place, that does not move in any of `count` views.

    Raises `InputError` where it is no standing person.
    """
    made = rig((vertices, faces), units="m", anew=True)
    character, matrix = made.character, made.rest_from_file
    assert matrix is not None
    pose = rest_pose(character.skeleton)
    places, fields = _moved(character.skeleton, pose, character.vertices, character.weights)
    rest = np.asarray(character.vertices, np.float64)
    feet = np.asarray(fields, np.float64)[rest[:, 1] < FEET].reshape(-1, fields.shape[2])
    stiffness = np.eye(fields.shape[2]) / TURN**2 + feet.T @ feet / len(feet) / PLANTED**2
    turn = np.linalg.inv(matrix)
    places = np.asarray(places, np.float64) @ turn[:3, :3].T + turn[:3, 3]
    fields = np.einsum("ij,pjd->pid", turn[:3, :3], np.asarray(fields, np.float64))
    return Sway(places, fields, np.zeros((count, fields.shape[2])), stiffness)


def estimate_sway(
    sway: Sway,
    vertices: Float[np.ndarray, "vertex 3"],
    faces: Int[np.ndarray, "face 3"],
    drawn: list[View],
    distances: Float[np.ndarray, "view height width"],
    used: Bool[np.ndarray, " view"],
) -> Sway:
    """Take one Gauss-Newton step to where the outlines of the swaying surface, as drawn, meet those of the masks.

    The views follow each other in time; those that are not `used` follow the others. The mean over all is no motion.
    """
    (count, size), fields = sway.amounts.shape, sway.fields_at(vertices)
    chain = np.diff(np.eye(count), axis=0)
    smooth = np.eye(count) + chain.T @ chain / STEP**2
    matrix = np.kron(smooth, sway.stiffness)
    right = -(matrix @ sway.amounts.ravel())
    for number in np.flatnonzero(used):
        rows, offset = _outline_rows(faces, fields, distances[number], drawn[number])
        weight = 1 / (1 + (offset / ROBUST) ** 2) ** 2 / PIXEL**2 / TOGETHER
        block = slice(number * size, (number + 1) * size)
        matrix[block, block] += rows.T @ (weight[:, None] * rows)
        right[block] += rows.T @ (weight * offset)
    amounts = sway.amounts + np.linalg.solve(matrix, right).reshape(count, size)
    return sway._replace(amounts=amounts - amounts.mean(axis=0))


def _outline_rows(
    faces: np.ndarray, fields: np.ndarray, field: np.ndarray, view: View
) -> tuple[Float[np.ndarray, "pixel dof"], Float[np.ndarray, " pixel"]]:
    """Say of the pixels of the drawn outline how they move outwards with the body, and how far they should, metres.

    Both less what the outline has in common: a surface that is a little too large everywhere is not one that is nearer.
    """
    covered = np.pad(view.ids >= 0, 1, mode="edge")
    inner = covered[:-2, 1:-1] & covered[2:, 1:-1] & covered[1:-1, :-2] & covered[1:-1, 2:]
    row, column = np.nonzero((view.ids >= 0) & ~inner)
    face = faces[view.ids[row, column]]
    pose = view.cam_from_world.astype(np.float64)
    place = view.vertices[face].mean(axis=1) @ pose[:3, :3].T + pose[:3, 3]
    moved = np.einsum("ij,pjd->pid", pose[:3, :3], fields[face].mean(axis=1))
    down, across = (slope[row, column] for slope in np.gradient(field))
    steep = np.maximum(np.hypot(down, across), 0.3)
    shifted = moved[:, :2] - (place[:, :2] / place[:, 2:])[..., None] * moved[:, 2:]
    rows = -(across / steep)[:, None] * shifted[:, 0] - (down / steep)[:, None] * shifted[:, 1]
    offset = (field[row, column] - 0.5) * place[:, 2] / float(view.intrinsics[0, 0])
    return rows - rows.mean(axis=0), offset - np.median(offset)
