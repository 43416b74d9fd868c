"""From pictures of a standing person to a closed surface: silhouettes carve it, pictures that agree draw it in."""

from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int

from jaxmocap._results import InputError

from ._hull import Views, visual_hull
from ._surface import draw_views, refine_surface

FEWEST_VIEWS = 4
"""Below that a hull is no body."""

SUSPICIOUS, TIMES = 0.04, 3.0
"""A mask is left out if it lacks more than this share of what all others show, and so many times what masks usually
lack."""

LOOK_CELL = 0.02
"""Metres between the points of the grid on which masks are compared."""


@dataclass(frozen=True)
class Scan:
    """The surface of a person who stood still.

    Attributes:
        vertices: in the cameras' world, metres.
        faces: counter-clockwise seen from outside; the surface is closed.
        overlap: per view the intersection over union of the surface's silhouette and the mask.
        used: the views whose masks the others confirm.
    """

    vertices: Float[np.ndarray, "vertex 3"]
    faces: Int[np.ndarray, "face 3"]
    overlap: Float[np.ndarray, " view"]
    used: Bool[np.ndarray, " view"]


def reconstruct(views: Views, *, cell: float = 0.01, num_faces: int = 20_000, rounds: int = 3) -> Scan:
    """Reconstruct the surface of a person who stands still.

    The visual hull on a grid of `cell` metres, simplified to about `num_faces` triangles, is refined in `rounds`
    rounds (`refine_surface`); 0 leaves the hull. With six views or more, one whose mask lacks what the others show is
    left out: a single mask without an arm would carve it off. Raises `InputError` for too few views and for silhouettes
    with nothing in common.
    """
    count = len(views.masks)
    if count < FEWEST_VIEWS:
        raise InputError(
            f"{count} views of the person are given; {FEWEST_VIEWS} all around are needed, better 8 or more."
        )
    used = confirmed(views) if count >= FEWEST_VIEWS + 2 else np.ones(count, bool)
    vertices, faces = visual_hull(views.only(used), cell)
    if len(faces) > num_faces:
        mesh = trimesh.Trimesh(vertices, faces, process=False).simplify_quadric_decimation(face_count=num_faces)
        vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
    vertices = refine_surface(vertices, faces, views.only(used), rounds)
    return Scan(vertices, faces, overlaps(vertices, faces, views), used)


def overlaps(
    vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"], views: Views
) -> Float[np.ndarray, " view"]:
    """Compute the intersection over union of a mesh's silhouette and the mask in every view."""
    drawn = np.stack([one.ids >= 0 for one in draw_views(vertices, faces, views)])
    return (drawn & views.masks).sum((1, 2)) / np.maximum((drawn | views.masks).sum((1, 2)), 1)


def confirmed(views: Views) -> Bool[np.ndarray, " view"]:
    """Mark the views whose masks show what the others show, from a hull that any single view may contradict."""
    drawn = np.stack([one.ids >= 0 for one in draw_views(*visual_hull(views, LOOK_CELL, outliers=1), views)])
    missing = (drawn & ~views.masks).sum((1, 2)) / np.maximum(views.masks.sum((1, 2)), 1)
    used = missing <= max(SUSPICIOUS, TIMES * float(np.median(missing)))
    return used if used.sum() >= FEWEST_VIEWS else np.ones(len(used), bool)
