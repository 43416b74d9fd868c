"""Making triangles agree where outside is, and closing the holes between them."""

import heapq
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order, connected_components


def orient(
    vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"]
) -> tuple[Int[np.ndarray, "face 3"], int]:
    """Turn faces so that neighbours agree and every connected part encloses a positive volume; count those turned.

    Edges of more or fewer than two faces connect nothing.
    """
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    low, high = directed.min(axis=1), directed.max(axis=1)
    key = low * len(vertices) + high
    of_face = np.tile(np.arange(len(faces)), 3)
    order = np.argsort(key, kind="stable")
    ranked = key[order]
    first = np.flatnonzero(np.r_[True, ranked[1:] != ranked[:-1]])
    pairs = first[np.diff(np.r_[first, len(ranked)]) == 2]
    a, b = order[pairs], order[pairs + 1]
    opposed = (directed[a, 0] == directed[b, 0]).astype(np.int8)  # the same direction along an edge: they disagree
    flip = _parities(of_face[a], of_face[b], opposed, len(faces))
    turned = np.where(flip[:, None], faces[:, ::-1], faces)
    links = sparse.coo_matrix((np.ones(len(a), bool), (of_face[a], of_face[b])), shape=(len(faces),) * 2)
    count, part = connected_components(links, directed=False)
    p, q, r = (vertices[turned[:, corner]] for corner in range(3))
    centre = np.stack([np.bincount(part, p[:, axis], count) for axis in range(3)], axis=1)
    centre /= np.bincount(part, minlength=count)[:, None]
    p, q, r = p - centre[part], q - centre[part], r - centre[part]
    volume = np.bincount(part, np.einsum("fi,fi->f", p, np.cross(q, r)), count)
    turned = np.where((volume < 0)[part][:, None], turned[:, ::-1], turned)
    return turned, int(np.sum(flip ^ (volume < 0)[part]))


def _parities(a: np.ndarray, b: np.ndarray, opposed: np.ndarray, count: int) -> np.ndarray:
    """Per face whether to turn it, walking from face to face."""
    rows, columns = np.concatenate([a, b]), np.concatenate([b, a])
    values = np.concatenate([opposed, opposed]) + 1
    graph = sparse.csr_matrix((values, (rows, columns)), shape=(count, count))
    flip = np.zeros(count, bool)
    _, label = connected_components(graph, directed=False)
    if not opposed.any():
        return flip
    uneven = np.unique(label[a[opposed > 0]])
    for part in uneven:
        start = int(np.flatnonzero(label == part)[0])
        walk, before = breadth_first_order(graph, start, directed=False)
        steps = np.asarray(graph[before[walk[1:]], walk[1:]]).ravel() > 1
        for face, source, step in zip(walk[1:], before[walk[1:]], steps, strict=True):
            flip[face] = flip[source] ^ step
    return flip


class Filled(NamedTuple):
    """A mesh whose `holes` boundary loops are closed; `widest` is the largest one's diameter."""

    vertices: Float[np.ndarray, "vertex 3"]
    faces: Int[np.ndarray, "face 3"]
    holes: int
    widest: float


def fill_holes(vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"]) -> Filled:
    """Fill every boundary loop by cutting its shortest ears, or by a fan where that would repeat edges.

    Neighbouring triangles must agree where outside is.
    """
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
    """Find closed walks along edges that only one face has, against that face's direction; no vertex twice in one."""
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
