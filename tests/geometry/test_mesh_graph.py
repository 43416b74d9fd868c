"""The dual graph of a mesh against breadth-first search."""

from collections import deque

import numpy as np
import pytest

from jaxmocap.geometry import face_adjacency, face_components, faces_within, pack_rows


def grid_mesh(rows=4, columns=5):
    """A sheet of squares, each cut into two triangles."""
    corner = lambda i, j: i * (columns + 1) + j  # noqa: E731
    faces = []
    for i in range(rows):
        for j in range(columns):
            a, b, c, d = corner(i, j), corner(i, j + 1), corner(i + 1, j), corner(i + 1, j + 1)
            faces += [(a, c, b), (b, c, d)]
    return np.array(faces)


def edges_of(face):
    return {frozenset((face[k], face[(k + 1) % 3])) for k in range(3)}


def steps_between(faces):
    """Number of shared edges to cross between all pairs of faces, by breadth-first search; -1 where there is no way."""
    neighbours = [
        [j for j in range(len(faces)) if j != i and edges_of(faces[i]) & edges_of(faces[j])] for i in range(len(faces))
    ]
    steps = np.full((len(faces), len(faces)), -1)
    for start in range(len(faces)):
        steps[start, start] = 0
        queue = deque([start])
        while queue:
            here = queue.popleft()
            for there in neighbours[here]:
                if steps[start, there] < 0:
                    steps[start, there] = steps[start, here] + 1
                    queue.append(there)
    return steps


@pytest.fixture(scope="module")
def two_sheets():
    sheet = grid_mesh()
    return np.concatenate([sheet, sheet + sheet.max() + 1])


def test_adjacency_is_one_step_of_the_search(two_sheets):
    np.testing.assert_array_equal(face_adjacency(two_sheets).toarray(), steps_between(two_sheets) == 1)


@pytest.mark.parametrize("reach", [0, 1, 2, 5])
def test_faces_within_some_steps_are_those_of_the_search(two_sheets, reach):
    steps = steps_between(two_sheets)
    np.testing.assert_array_equal(faces_within(two_sheets, reach).toarray(), (steps >= 0) & (steps <= reach))


def test_an_edge_of_three_faces_joins_them_all():
    fan = np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]])
    np.testing.assert_array_equal(face_adjacency(fan).toarray(), ~np.eye(3, dtype=bool))


def test_faces_that_share_only_a_corner_are_not_adjacent():
    bow_tie = np.array([[0, 1, 2], [0, 3, 4]])
    assert face_adjacency(bow_tie).nnz == 0
    assert face_components(bow_tie)[0] == 2


def test_bits_say_what_the_table_says():
    rng = np.random.default_rng(0)
    faces = grid_mesh(7, 9)  # 126 faces: four words, the last one not full
    table = faces_within(faces, 3)
    words = pack_rows(table)
    assert words.shape == (126, 4)
    assert words.dtype == np.uint32
    dense = table.toarray()
    for i, j in rng.integers(0, 126, (500, 2)):
        assert (int(words[i, j // 32]) >> int(j % 32)) & 1 == dense[i, j]
    assert np.all(words[:, 3] >> np.uint32(126 - 96) == 0)


def test_components_are_the_sheets(two_sheets):
    count, labels = face_components(two_sheets)
    half = len(two_sheets) // 2
    assert count == 2
    assert len(set(labels[:half])) == len(set(labels[half:])) == 1
    assert labels[0] != labels[-1]
