"""From a scan to one clean surface: welded, without specks and crossings, facing outwards, closed, of a chosen size."""

from typing import NamedTuple

import numpy as np
import trimesh
from jaxtyping import Float, Int
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from jaxmocap._results import InputError
from jaxmocap.geometry import face_areas

from ._watertight import fill_holes, orient

_HUGE = 200_000  # triangles from which a mesh is snapped to a grid that leaves about half of them
_SPECK = 0.005  # of the whole area
_APART = 0.05  # of the longest side


class Repair(NamedTuple):
    """A clean mesh in the file's units and axes, and what was done to it, a sentence each."""

    vertices: Float[np.ndarray, "vertex 3"]
    faces: Int[np.ndarray, "face 3"]
    done: list[str]


def repair(vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"], num_faces: int) -> Repair:
    """Clean a mesh and simplify it to about `num_faces` triangles where it has more.

    In this order: broken triangles go, a huge mesh is snapped to a fine grid, seams are welded, islands that are specks
    or far away go, third triangles on an edge go, neighbours are made to agree where outside is, holes are closed, and
    edges are collapsed by quadric error (Garland and Heckbert 1997). Raises `InputError` if too little is left.
    """
    done: list[str] = []
    vertices, faces = _finite(vertices, faces, done)
    size = float(np.ptp(vertices, axis=0).max()) if len(vertices) else 0.0
    if len(faces) < 100 or size <= 0:
        raise InputError(f"the mesh has {len(faces)} usable triangles; a surface of a person needs hundreds.")
    most = max(_HUGE, 4 * num_faces)
    if len(faces) > most:
        before = len(faces)
        vertices, faces = _weld(vertices, faces, 2 * np.sqrt(face_areas(vertices, faces).sum() / most), flatten=True)
        done.append(f"snapped {before:,} triangles to a grid, which left {len(faces):,}")
    else:
        before = len(vertices)
        vertices, faces = _weld(vertices, faces, 1e-6 * size)
        if len(vertices) < before:
            done.append(f"welded {before - len(vertices):,} repeated or unused vertices")
    vertices, faces = _without_islands(vertices, faces, size, done)
    vertices, faces = _sound(vertices, faces, done)
    if len(faces) > 1.02 * num_faces:
        vertices, faces = _simplified(vertices, faces, num_faces, done)
        vertices, faces = _sound(vertices, faces, [])
    return Repair(vertices, faces, done)


def repaired(
    label: str, vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"], num_faces: int
) -> Repair:
    """Run `repair` with errors that begin with the mesh's `label`."""
    try:
        return repair(vertices, faces, num_faces)
    except InputError as error:
        raise InputError(f"{label}: {error}") from None


def _simplified(
    vertices: np.ndarray, faces: np.ndarray, num_faces: int, done: list[str]
) -> tuple[np.ndarray, np.ndarray]:
    """About `num_faces` triangles: carefully at first, which may stop early, then at any cost."""
    before, mesh = len(faces), trimesh.Trimesh(vertices, faces, process=False)
    for aggression in (3, 7):
        if len(mesh.faces) > 1.05 * num_faces:
            mesh = mesh.simplify_quadric_decimation(face_count=num_faces, aggression=aggression)
    done.append(f"simplified {before:,} triangles to {len(mesh.faces):,}")
    return _used(np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64))


def _finite(vertices: np.ndarray, faces: np.ndarray, done: list[str]) -> tuple[np.ndarray, np.ndarray]:
    good = np.all(np.isfinite(vertices), axis=1) & np.all(np.abs(vertices) < 1e12, axis=1)
    if not good.all():
        faces = faces[good[faces].all(axis=1)]
        done.append(f"dropped {int((~good).sum()):,} vertices that are no finite places")
    return _used(vertices, faces)


def _used(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Without vertices that no face has; the order is kept."""
    used = np.zeros(len(vertices), bool)
    used[faces.ravel()] = True
    number = np.cumsum(used) - 1
    return vertices[used], number[faces]


def _weld(vertices: np.ndarray, faces: np.ndarray, cell: float, flatten: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """One vertex per occupied cell of a grid, at the mean of those in it; collapsed and repeated faces go."""
    cells = np.floor((vertices - vertices.min(axis=0)) / cell + 0.5).astype(np.int64)
    key = (cells[:, 0] << 42) + (cells[:, 1] << 21) + cells[:, 2]
    _, label, count = np.unique(key, return_inverse=True, return_counts=True)
    sums = [np.bincount(label, vertices[:, axis], len(count)) for axis in range(3)]
    vertices, faces = np.stack(sums, axis=1) / count[:, None], label[faces]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    ordered = np.sort(faces, axis=1)
    _, first, group = np.unique(
        ordered[:, 0] << 42 | ordered[:, 1] << 21 | ordered[:, 2], return_index=True, return_inverse=True
    )
    if flatten:  # what the grid made flat has two faces, back to back
        even = np.argmin(faces, axis=1)
        rows = np.arange(len(faces))
        side = np.where(faces[rows, (even + 1) % 3] < faces[rows, (even + 2) % 3], 1, -1)
        total = np.bincount(group, side, len(first))
        keep = np.unique(group[side * total[group] > 0], return_index=True)[1]
        first = np.flatnonzero(side * total[group] > 0)[keep]
    return _used(vertices, faces[np.sort(first)])


def _without_islands(
    vertices: np.ndarray, faces: np.ndarray, size: float, done: list[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Parts that are specks, or stand apart from the largest one, go."""
    ends = np.concatenate([faces[:, :2], faces[:, 1:]])
    links = sparse.coo_matrix((np.ones(len(ends), bool), (ends[:, 0], ends[:, 1])), shape=(len(vertices),) * 2)
    count, label = connected_components(links, directed=False)
    if count == 1:
        return vertices, faces
    of_face = label[faces[:, 0]]
    area = np.bincount(of_face, face_areas(vertices, faces), count)
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, label, vertices)
    np.maximum.at(high, label, vertices)
    main = int(np.argmax(area))
    gap = np.maximum(np.maximum(low[main] - high, low - high[main]), 0).max(axis=1)
    keep = (area > _SPECK * area.sum()) & (gap < _APART * size)
    if not keep.all():
        share = 100 * area[~keep].sum() / area.sum()
        done.append(f"dropped {int((~keep).sum()):,} of {count:,} separate parts ({share:.1f} % of the surface)")
    return _used(vertices, faces[keep[of_face]])


def _sound(vertices: np.ndarray, faces: np.ndarray, done: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Two triangles to every edge, all facing outwards."""
    before = len(faces)
    faces = _manifold(vertices, faces)
    if len(faces) < before:
        done.append(f"dropped {before - len(faces):,} triangles from edges that had three")
    faces, turned = orient(vertices, faces)
    if turned:
        done.append(f"turned {turned:,} triangles to face outwards")
    vertices, faces, holes, widest = fill_holes(vertices, faces)
    if holes:
        across = 100 * widest / max(float(np.ptp(vertices, axis=0).max()), 1e-12)
        done.append(f"closed {holes:,} holes, the widest across {across:.1f} % of the figure's size")
    return _used(vertices, faces)


def _manifold(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Remove the smallest faces on edges of three or five until there are none; four are two sheets that touch."""
    for _ in range(10):
        area = face_areas(vertices, faces)
        edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
        key = edges[:, 0] * len(vertices) + edges[:, 1]
        of_face = np.tile(np.arange(len(faces)), 3)
        order = np.lexsort((-area[of_face], key))
        ranked = key[order]
        first = np.r_[True, ranked[1:] != ranked[:-1]]
        rank = np.arange(len(ranked)) - np.maximum.accumulate(np.where(first, np.arange(len(ranked)), 0))
        odd = (np.bincount(np.cumsum(first) - 1) % 2 == 1)[np.cumsum(first) - 1]
        spare = np.unique(of_face[order][(rank >= 2) & odd])
        if len(spare) == 0:
            return faces
        faces = np.delete(faces, spare, axis=0)
    return faces
