import numpy as np

from jaxmocap.metrics import nearest_on_surface

TRIANGLE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
FACE = np.array([[0, 1, 2]])


def _nearest(points, vertices=TRIANGLE, faces=FACE):
    face, barycentric = nearest_on_surface(np.asarray(points, float), vertices, faces)
    return np.einsum("mk,mkd->md", barycentric, vertices[faces[face]]), face, barycentric


def test_all_seven_regions_of_a_triangle():
    points = [[-1, -1, 2], [2, -0.5, 1], [-0.5, 3, 1], [0.4, -1, 1], [-2, 0.3, 1], [1, 1, -3], [0.2, 0.3, 5]]
    expected = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.4, 0, 0], [0, 0.3, 0], [0.5, 0.5, 0], [0.2, 0.3, 0]]
    assert np.allclose(_nearest(points)[0], expected)


def test_no_sampled_point_of_a_random_mesh_is_nearer():
    rng = np.random.default_rng(0)
    vertices, faces = rng.standard_normal((30, 3)), rng.integers(0, 30, (40, 3))
    points = 2 * rng.standard_normal((50, 3))
    nearest, _, barycentric = _nearest(points, vertices, faces)
    samples = np.einsum("sk,fkd->sfd", rng.dirichlet(np.ones(3) * 0.7, 4000), vertices[faces]).reshape(-1, 3)
    sampled = np.array([np.linalg.norm(samples - point, axis=1).min() for point in points])
    distance = np.linalg.norm(points - nearest, axis=1)
    assert np.all(distance <= sampled + 1e-12)
    assert np.all(distance >= sampled - 0.1)
    assert np.allclose(barycentric.sum(1), 1)
    assert barycentric.min() >= -1e-12


def test_degenerate_triangles_count_as_their_edges():
    line = np.array([[0.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0], [5.0, 5, 5]])
    nearest, _, _ = _nearest([[1.5, 1, 0], [-1, 0, 0], [5, 5, 6]], line, np.array([[0, 1, 2], [3, 3, 3]]))
    assert np.allclose(nearest, [[1.5, 0, 0], [0, 0, 0], [5, 5, 5]])
