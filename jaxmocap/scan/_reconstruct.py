"""From pictures of a standing person to a closed surface: silhouettes carve it, pictures that agree draw it in."""

from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int

from jaxmocap._results import InputError
from jaxmocap.geometry import intersection_over_union

from ._hull import Views, mask_distances, visual_hull
from ._surface import draw_views, refine_surface
from ._sway import Sway, estimate_sway, sway_at_rest

FEWEST_VIEWS = 5
"""Below that a hull is no body: of four views, two and two face each other and say the same."""

SUSPICIOUS, TIMES = 0.04, 3.0
"""A mask is left out if it lacks more than this share of what all others show, and so many times what masks usually
lack."""

LOOK_CELL = 0.02
"""Metres between the points of the grid on which masks are compared."""

CONTRADICT, TURNS = 0.125, 3
"""Share of the views that may contradict the hull into which a skeleton is laid, and turns in which sway is found."""

NOTICED = 0.01
"""Metres of sway below which the person counts as standing still: errors of masks that are found look like 0.8 cm."""


@dataclass(frozen=True)
class Scan:
    """The surface of a person who stood still.

    Attributes:
        vertices: in the cameras' world, metres.
        faces: counter-clockwise seen from outside; the surface is closed.
        overlap: per view the intersection over union of the surface's silhouette and the mask.
        used: the views whose masks the others confirm.
        sway: how the person swayed about this surface; None where it was not looked for, or is below `NOTICED`.
    """

    vertices: Float[np.ndarray, "vertex 3"]
    faces: Int[np.ndarray, "face 3"]
    overlap: Float[np.ndarray, " view"]
    used: Bool[np.ndarray, " view"]
    sway: Sway | None = None


def reconstruct(
    views: Views, *, cell: float = 0.01, num_faces: int = 20_000, rounds: int = 10, swaying: bool = False
) -> Scan:
    """Reconstruct the surface of a person who stands still.

    The visual hull on a grid of `cell` metres, simplified to about `num_faces` triangles, is refined in `rounds`
    rounds at most (`refine_surface`); 0 leaves the hull. With six views or more, one whose mask lacks what the others
    show is left out: a single mask without an arm would carve it off. `swaying` looks for small motions of the person
    in views that follow each other in time (`find_sway`). Raises `InputError` for too few views and for silhouettes
    with nothing in common.
    """
    count = len(views.masks)
    refuse_few_views(count)
    used = confirmed(views) if count > FEWEST_VIEWS else np.ones(count, bool)
    if swaying:
        views = views._replace(sway=find_sway(views, used))
    vertices, faces = visual_hull(views.only(used), cell)
    if len(faces) > num_faces:
        mesh = trimesh.Trimesh(vertices, faces, process=False).simplify_quadric_decimation(face_count=num_faces)
        vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
    vertices = refine_surface(vertices, faces, views.only(used), rounds)
    return Scan(vertices, faces, overlaps(vertices, faces, views), used, views.sway)


def refuse_few_views(count: int, where: str = "") -> None:
    """Raise `InputError` for fewer views than `FEWEST_VIEWS`; `where` they are is said first."""
    if count < FEWEST_VIEWS:
        place = f"{where}: " if where else ""
        given = "1 view of the person is" if count == 1 else f"{count} views of the person are"
        raise InputError(f"{place}{given} given; {FEWEST_VIEWS} all around are needed, better 8 or more.")


def find_sway(views: Views, used: Bool[np.ndarray, " view"]) -> Sway | None:
    """Find how a person sways from view to view, in the order of time, by the outlines of the views that are `used`.

    A skeleton is laid into a hull that some views may contradict, for what sways is carved off otherwise; its motion
    and the hull of the mean body are found in turns. None for motion that is too small to tell, and where no standing
    person is found.
    """
    count, distances = len(views.masks), mask_distances(views.masks)
    vertices, faces = visual_hull(views.only(used), LOOK_CELL, outliers=int(CONTRADICT * used.sum()))
    try:
        sway = sway_at_rest(vertices, faces, count)
    except InputError:
        return None
    for turn in range(TURNS):
        if turn:
            vertices, faces = visual_hull(views._replace(sway=sway).only(used), LOOK_CELL)
        for _ in range(2):
            drawn = draw_views(vertices, faces, views._replace(sway=sway))
            sway = estimate_sway(sway, vertices, faces, drawn, distances, used)
    return sway if sway.extent > NOTICED else None


def overlaps(
    vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"], views: Views
) -> Float[np.ndarray, " view"]:
    """Compute the intersection over union of a mesh's silhouette and the mask in every view."""
    drawn = np.stack([one.ids >= 0 for one in draw_views(vertices, faces, views)])
    return intersection_over_union(drawn, views.masks, empty=0.0)


def confirmed(views: Views) -> Bool[np.ndarray, " view"]:
    """Mark the views whose masks show what the others show, from a hull that any single view may contradict."""
    drawn = np.stack([one.ids >= 0 for one in draw_views(*visual_hull(views, LOOK_CELL, outliers=1), views)])
    missing = (drawn & ~views.masks).sum((1, 2)) / np.maximum(views.masks.sum((1, 2)), 1)
    used = missing <= max(SUSPICIOUS, TIMES * float(np.median(missing)))
    return used if used.sum() >= FEWEST_VIEWS else np.ones(len(used), bool)
