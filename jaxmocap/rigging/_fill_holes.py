"""Closing the holes of an oriented triangle mesh."""

import heapq

import numpy as np
from jaxtyping import Float, Int


def fill_holes(
    vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"]
) -> tuple[Int[np.ndarray, "filled 3"], int, float]:
    """The faces and those that fill every boundary loop, by cutting its shortest ears; how many loops there are, and
    the widest one's diameter. Neighbouring triangles must agree where outside is."""
    loops = _loops(faces)
    if not loops:
        return faces, 0, 0.0
    known = {tuple(edge) for edge in np.sort(_edges(faces), axis=1).tolist()}
    added: list[tuple[int, int, int]] = []
    for loop in loops:
        added += _clipped(loop, vertices, known)
    widest = max(float(np.linalg.norm(np.ptp(vertices[loop], axis=0))) for loop in loops)
    return np.concatenate([faces, np.array(added, faces.dtype).reshape(-1, 3)]), len(loops), widest


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


def _clipped(loop: list[int], vertices: np.ndarray, known: set[tuple[int, int]]) -> list[tuple[int, int, int]]:
    """Triangles over a loop: again and again the corner with the shortest chord, if that is no edge already."""
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
    rest = list(before)
    if left == 3:
        start = rest[0]
        triangles.append((before[start], start, after[start]))
    return triangles
