"""The surface of a body made to measure: offsets along its normals, from the outlines of masks in several frames."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy import sparse
from scipy.sparse.linalg import spsolve
from scipy.spatial import KDTree

from jaxmocap.character import Character, Pose, skin
from jaxmocap.energies import SurfaceLines, contour_lines
from jaxmocap.geometry import uniform_laplacian, vertex_normals
from jaxmocap.observation import FrameProblem, draw

from ._fit_silhouette import RegistrationSettings, Rows, mask_contours, moved_by_rows
from ._shape_outlines import OUTLINE_SCALE

_REACH = (25, 15)  # pixels within which an outline is looked for: in the first round, and afterwards
_ROBUST = 0.03  # metres beyond which a row fades (Geman and McClure)
_POSE_PULL = {"root": 0.2, "angles": 0.8}  # keeps poses where the shape was fitted
_POSE_STEPS = 2
_TWINS = 0.02  # metres between a vertex and the mirror image of its twin, at most


@dataclass(frozen=True)
class SurfaceSettings:
    """How far the surface of a generic body may move to the outlines of the person. Not in the paper.

    Attributes:
        offset: standard deviation of a vertex's offset, metres: clothes, hair, shape beyond lengths and girths. It is
            wide, so that what no outline shows goes with what is beside it.
        bending: standard deviation of an offset less the mean of the neighbours', metres.
        between_sides: standard deviation of the difference between left and right, metres.
        rounds: of poses and offsets in turn.
        steps: of offsets in a round, each with outlines tied anew.
    """

    offset: float = 0.1
    bending: float = 0.003
    between_sides: float = 0.005
    rounds: int = 3
    steps: int = 3


@dataclass(frozen=True)
class SurfaceFit:
    """A body with its own surface.

    Attributes:
        character: the body, its skeleton unchanged.
        offsets: of its vertices along the normals that they had at rest, metres.
        poses: those given, moved to the outlines.
    """

    character: Character
    offsets: Float[np.ndarray, "vertex"]
    poses: dict[int, Pose]


def fit_surface(
    character: Character,
    poses: Mapping[int, Pose],
    problems: Sequence[FrameProblem],
    settings: SurfaceSettings | None = None,
) -> SurfaceFit:
    """Move the vertices of a body along their normals to the outlines of masks, smoothly and alike on both sides.

    `poses` are those at the frames of `problems` (`mask_problems`), in that order. Contour points of the drawn mesh are
    tied to the masks' outlines as in registration; their lines (Eq. 9) are linear in the offsets, which one sparse
    system finds, by turns with the poses. What no outline shows stays where the smoothness puts it.
    """
    settings = SurfaceSettings() if settings is None else settings
    vertices, faces = np.asarray(character.vertices, np.float64), np.asarray(character.faces)
    normals, prior = vertex_normals(vertices, faces), _prior(vertices, faces, settings)
    offsets, found, now = np.zeros(len(vertices)), dict(poses), character
    for number in range(settings.rounds):
        reach = _REACH[min(number, 1)]
        moved = [_pose(now, pose, problem, reach) for pose, problem in zip(found.values(), problems, strict=True)]
        found = dict(zip(found, moved, strict=True))
        for _ in range(settings.steps):
            matrix, vector = prior, -prior @ offsets
            for pose, problem in zip(found.values(), problems, strict=True):
                own_matrix, own_vector = _normal_equations(now, pose, _lines(now, pose, problem, reach))
                matrix, vector = matrix + own_matrix, vector + own_vector
            offsets = offsets + np.asarray(spsolve(sparse.csc_array(matrix), vector))
            placed = jnp.asarray(vertices + offsets[:, None] * normals, character.vertices.dtype)
            now = eqx.tree_at(lambda one: one.vertices, character, placed)
    return SurfaceFit(now, offsets, found)


def _lines(character: Character, pose: Pose, problem: FrameProblem, reach: int) -> SurfaceLines:
    vertices, ids, inverse = draw(character, pose, problem)
    return contour_lines(vertices, character.faces, ids, inverse, problem, mask_contours(reach))


def _pose(character: Character, pose: Pose, problem: FrameProblem, reach: int) -> Pose:
    weight, settings = character.skeleton.per_dof(**_POSE_PULL), RegistrationSettings()
    for _ in range(_POSE_STEPS):
        rows = (Rows(_lines(character, pose, problem, reach), OUTLINE_SCALE, _ROBUST),)
        pose = moved_by_rows(character, pose, rows, (), weight, settings, [])
    return pose


def _prior(vertices: np.ndarray, faces: np.ndarray, settings: SurfaceSettings) -> sparse.csr_array:
    """Build the information matrix of the offsets before anything is seen."""
    count = len(vertices)
    bending = uniform_laplacian(faces, count)
    apart, twin = map(np.asarray, KDTree(vertices).query(vertices * [-1.0, 1.0, 1.0]))
    paired = np.flatnonzero(apart < _TWINS)
    mirror = sparse.csr_array((np.ones(len(paired)), (paired, twin[paired])), shape=(count, count))
    alone = sparse.csr_array((np.ones(len(paired)), (paired, paired)), shape=(count, count))
    difference = alone - mirror
    return sparse.csr_array(
        sparse.eye_array(count) / settings.offset**2
        + bending.T @ bending / settings.bending**2
        + difference.T @ difference / settings.between_sides**2
    )


def _normal_equations(
    character: Character, pose: Pose, lines: SurfaceLines
) -> tuple[sparse.csr_array, Float[np.ndarray, "vertex"]]:
    """Linearise Eq. 9 in the offsets: a contour point moves along the posed normals of its triangle's corners."""
    vertices = np.asarray(skin(character, pose), np.float64)
    normals = vertex_normals(vertices, np.asarray(character.faces))
    kept = np.flatnonzero(np.asarray(lines.weight) > 0)
    corners, shares = np.asarray(lines.corners)[kept], np.asarray(lines.barycentric, np.float64)[kept]
    along = np.asarray(lines.direction, np.float64)[kept]
    error = np.asarray(lines.residual(jnp.asarray(vertices, character.vertices.dtype)), np.float64)[kept]
    faded = 1 / (1 + (error**2).sum(1) / _ROBUST**2) ** 2
    weight = np.asarray(lines.weight, np.float64)[kept] * faded / OUTLINE_SCALE**2
    slopes = shares[:, :, None] * np.cross(normals[corners], along[:, None, :])
    rows = np.arange(slopes.size // 3)  # one per row and axis of the residual
    columns = np.repeat(corners[:, None, :], 3, axis=1).reshape(-1)
    shape = (3 * len(corners), len(vertices))
    table = sparse.csr_array((slopes.transpose(0, 2, 1).reshape(-1), (np.repeat(rows, 3), columns)), shape=shape)
    weighed = sparse.diags_array(np.repeat(weight, 3)) @ table
    return sparse.csr_array(table.T @ weighed), -(weighed.T @ error.reshape(-1))
