"""Closing the holes of an oriented triangle mesh."""

import heapq
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


class Filled(NamedTuple):
    """A mesh whose `holes` boundary loops are closed; `widest` is the largest one's diameter."""

    vertices: Float[np.ndarray, "vertex 3"]
    faces: Int[np.ndarray, "face 3"]
    holes: int
    widest: float


def fill_holes(vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"]) -> Filled:
    """Fill every boundary loop by cutting its shortest ears, or by a fan where that would repeat edges. Neighbouring
    triangles must agree where outside is."""
    loops = _loops(faces)
    if not loops:
        return Filled(vertices, faces, 0, 0.0)
    known = {tuple(edge) for edge in np.sort(_edges(faces), axis=1).tolist()}
    added: list[tuple[int, int, int]] = []
    middles: list[np.ndarray] = []
    for loop in loops:
        triangles, rest = _clipped(loop, vertices, known)
        added += triangles
        if rest:
            middle = len(vertices) + len(middles)
            middles.append(vertices[rest].mean(axis=0))
            added += [(rest[number - 1], vertex, middle) for number, vertex in enumerate(rest)]
    widest = max(float(np.linalg.norm(np.ptp(vertices[loop], axis=0))) for loop in loops)
    vertices = np.concatenate([vertices, np.array(middles).reshape(-1, 3)])
    return Filled(vertices, np.concatenate([faces, np.array(added, faces.dtype).reshape(-1, 3)]), len(loops), widest)


def _edges(faces: np.ndarray) -> np.ndarray:
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def _loops(faces: np.ndarray) -> list[list[int]]:
    """Closed walks along edges that only one face has, against that face's direction; no vertex twice in one."""
    edges = _edges(faces)
    size = int(faces.max()) + 1
    forward, backward = edges[:, 0] * size + edges[:, 1], edges[:, 1] * size + edges[:, 0]
    free = edges[~np.isin(forward, backward)]
    onward: dict[int, list[int]] = {}
    for start, end in free.tolist():
        onward.setdefault(end, []).append(start)
    loops = []
    while onward:
        path, at = [], next(iter(onward))
        place: dict[int, int] = {}
        while at in onward:
            if at in place:  # a loop closes; what led to it goes on from here
                loop = path[place[at] :]
                loops.append(loop)
                path = path[: place[at]]
                for vertex in loop:
                    place.pop(vertex, None)
            place[at] = len(path)
            path.append(at)
            ways = onward[at]
            step = ways.pop()
            if not ways:
                del onward[at]
            at = step
        if at in place:
            loops.append(path[place[at] :])
    return [loop for loop in loops if len(loop) >= 3]


def _clipped(
    loop: list[int], vertices: np.ndarray, known: set[tuple[int, int]]
) -> tuple[list[tuple[int, int, int]], list[int]]:
    """Triangles over a loop, again and again the corner with the shortest chord if that is no edge already, and what
    is left of the loop."""
    before = {vertex: loop[number - 1] for number, vertex in enumerate(loop)}
    after = {vertex: loop[(number + 1) % len(loop)] for number, vertex in enumerate(loop)}
    chord = lambda v: float(np.linalg.norm(vertices[before[v]] - vertices[after[v]]))  # noqa: E731
    heap = [(chord(vertex), vertex) for vertex in loop]
    heapq.heapify(heap)
    triangles, left = [], len(loop)
    while left > 3 and heap:
        length, vertex = heapq.heappop(heap)
        if vertex not in before or length != chord(vertex):
            continue
        a, b = before[vertex], after[vertex]
        edge = (min(a, b), max(a, b))
        if edge in known:
            continue
        known.add(edge)
        triangles.append((a, vertex, b))
        after[a], before[b] = b, a
        del before[vertex], after[vertex]
        left -= 1
        for corner in (a, b):
            heapq.heappush(heap, (chord(corner), corner))
    rest = [next(iter(before))]
    while (vertex := after[rest[-1]]) != rest[0]:
        rest.append(vertex)
    if left > 3:
        return triangles, rest
    return [*triangles, (rest[0], rest[1], rest[2])], []
