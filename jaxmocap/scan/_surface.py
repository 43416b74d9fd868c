"""A surface that several pictures agree on: a visual hull is drawn in to where neighbouring views show the same."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse
from scipy.sparse.linalg import spsolve

from jaxmocap.geometry import faces_within, pack_rows, uniform_laplacian, vertex_normals
from jaxmocap.refinement import FlowSettings, View, compare
from jaxmocap.render import face_ids

from ._hull import Views, mask_distances

WIDEST = 40.0
"""Degrees between two views, seen from the person, at which their pictures are still compared."""

NEIGHBOURS = 2
"""Views that each view is compared with at most, the nearest ones."""

BELIEVED = 0.05
"""Metres from the surface beyond which neither pictures nor outlines are believed."""

SAME = 5
"""Edge steps within which two faces count as the same place (Eq. 7)."""

ROBUST = 0.01
"""Metres at which what one pixel says counts a quarter (Geman and McClure 1985)."""

OUTLINE, STIFF, FAIR = 5.0, 30.0, 40.0
"""Weights of a pixel of an outline, of bending the offset and of bending the surface, where a pixel that two pictures
agree on counts 1."""

SETTLED = 0.0006
"""Metres that a round moves the surface by, root mean square, below which it is the last."""


class _Pulls(NamedTuple):
    """Say of places on the surface (a face and the weights of its corners) how far to move along the normal, metres."""

    face: Int[np.ndarray, " pull"]
    shares: Float[np.ndarray, "pull 3"]
    offset: Float[np.ndarray, " pull"]
    weight: Float[np.ndarray, " pull"]


def refine_surface(
    vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"], views: Views, rounds: int = 10
) -> Float[np.ndarray, "vertex 3"]:
    """Move the vertices of a hull along their normals to where pictures agree and outlines match.

    Each round transfers every picture over the surface into its neighbours and takes the optical flow that is left
    (as view-view consistency, Eq. 7, in least-squares form): the two rays of a match meet where the surface is.
    Outlines pull from where the mesh ends to where the mask does. Between them the offsets are smooth, and so is the
    surface; one sparse linear system per round. There are at most so many `rounds`, and fewer where views are many.
    """
    near, distances = pack_rows(faces_within(faces, SAME)), mask_distances(views.masks)
    pairs, laplacian = _neighbours(views, vertices), uniform_laplacian(faces, len(vertices))
    bending = (laplacian.T @ laplacian).tocsc()
    for _ in range(rounds):
        drawn = draw_views(vertices, faces, views)
        normals = vertex_normals(vertices, faces)
        pulls = [_agreement(faces, normals, near, drawn[here], drawn[there]) for here, there in pairs]
        pulls += [_outline(faces, normals, *one) for one in zip(distances, drawn, strict=True)]
        offsets = _offsets(vertices, faces, normals, pulls, bending)
        vertices = _evened(vertices + normals * offsets[:, None], faces, laplacian)
        if np.sqrt(np.mean(offsets**2)) < SETTLED:
            break
    return vertices


def _evened(vertices: np.ndarray, faces: np.ndarray, laplacian: sparse.csr_array) -> np.ndarray:
    """Slide vertices within the surface, halfway to the middle of their neighbours."""
    normals, way = vertex_normals(vertices, faces), -0.5 * (laplacian @ vertices)
    return vertices + way - normals * np.einsum("vi,vi->v", way, normals)[:, None]


def draw_views(vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"], views: Views) -> list[View]:
    """Draw the mesh into every view."""
    height, width = views.grey.shape[1:]
    pictures = zip(views.grey, views.intrinsics, views.cam_from_world, strict=True)
    triangles, corner, drawn = faces.astype(np.int32), np.zeros((1, 2), np.int32), []
    for placed, (grey, intrinsics, cam_from_world) in zip(views.placed(vertices), pictures, strict=True):
        points = placed.astype(np.float32)
        ids, _ = face_ids(points, triangles, intrinsics[None], cam_from_world[None], corner, height, width)
        drawn.append(View(grey, intrinsics, cam_from_world, placed, np.asarray(ids)[0]))
    return drawn


def _neighbours(views: Views, vertices: np.ndarray) -> list[tuple[int, int]]:
    """List ordered pairs of views that look at the person from nearly the same side."""
    rotation, translation = views.cam_from_world[:, :3, :3], views.cam_from_world[:, :3, 3]
    towards = -np.einsum("vji,vj->vi", rotation, translation) - vertices.mean(0)
    towards = towards / np.linalg.norm(towards, axis=1, keepdims=True)
    cosine = towards @ towards.T
    np.fill_diagonal(cosine, -1.0)
    nearest = np.argsort(-cosine, axis=1)[:, :NEIGHBOURS]
    least = np.cos(np.radians(WIDEST))
    return [(view, int(other)) for view, row in enumerate(nearest) for other in row if cosine[view, other] > least]


def _rays(view: View, pixels: Float[np.ndarray, "pixel 2"]) -> tuple[np.ndarray, np.ndarray]:
    """Cast rays through pixels: the camera's centre and directions of depth 1, in the world (host, double)."""
    homogeneous = np.concatenate([pixels, np.ones((len(pixels), 1))], axis=1)
    inside = homogeneous @ np.linalg.inv(view.intrinsics.astype(np.float64)).T
    rotation, translation = view.cam_from_world[:3, :3].astype(np.float64), view.cam_from_world[:3, 3]
    return -rotation.T @ translation, inside @ rotation


def _on_surface(
    vertices: np.ndarray, faces: np.ndarray, face: np.ndarray, centre: np.ndarray, rays: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Meet rays with the planes of their faces: the points, and the weights of the faces' corners."""
    a, b, c = (vertices[faces[face, corner]] for corner in range(3))
    normal = np.cross(b - a, c - a)
    with np.errstate(divide="ignore", invalid="ignore"):
        along = np.einsum("pi,pi->p", a - centre, normal) / np.einsum("pi,pi->p", rays, normal)
        point = centre + along[:, None] * rays
        double = np.einsum("pi,pi->p", normal, normal)
        first = np.einsum("pi,pi->p", np.cross(b - point, c - point), normal) / double
        second = np.einsum("pi,pi->p", np.cross(c - point, a - point), normal) / double
    return point, np.clip(np.stack([first, second, 1 - first - second], axis=1), 0.0, 1.0)


def _agreement(
    faces: np.ndarray,
    normals: np.ndarray,
    near: np.ndarray,
    view: View,
    source: View,
) -> _Pulls:
    """Pull the surface to where the matches of two views lie."""
    found = compare(faces, near, view, source, FlowSettings())
    row, column = np.nonzero(found.good & (found.weight > 0.05))
    pixel = np.stack([column, row], axis=-1) + 0.5
    face = view.ids[row, column]
    centre, rays = _rays(view, pixel)
    point, shares = _on_surface(view.vertices, faces, face, centre, rays)
    _, moved = _rays(view, pixel + found.moved[row, column])
    other, others = _rays(source, found.source_pixel[row, column])
    apart = np.einsum("pk,pki->pi", shares, (view.vertices - source.vertices)[faces[face]])
    met = _meeting(centre, moved, other + apart, others)
    normal = np.einsum("pk,pki->pi", shares, normals[faces[face]])
    offset = np.einsum("pi,pi->p", met - point, normal)
    weight = found.weight[row, column] / (1 + (offset / ROBUST) ** 2) ** 2
    believed = np.abs(offset) < BELIEVED  # nor where a ray grazes its face and meets it nowhere
    return _Pulls(face[believed], shares[believed], offset[believed], weight[believed])


def _meeting(centre: np.ndarray, rays: np.ndarray, other: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Find the points halfway between pairs of rays where they pass each other."""
    apart = other - centre
    aa, bb = np.einsum("pi,pi->p", rays, rays), np.einsum("pi,pi->p", others, others)
    ab, ad, bd = (np.einsum("pi,pi->p", *pair) for pair in ((rays, others), (rays, apart), (others, apart)))
    rest = np.maximum(aa * bb - ab**2, 1e-12)
    first, second = (ad * bb - bd * ab) / rest, (ad * ab - bd * aa) / rest
    return 0.5 * (centre + first[:, None] * rays + other + second[:, None] * others)


def _outline(faces: np.ndarray, normals: np.ndarray, distances: np.ndarray, view: View) -> _Pulls:
    """Pull the mesh's outline in one view to that of the mask."""
    covered = np.pad(view.ids >= 0, 1, mode="edge")
    inner = covered[:-2, 1:-1] & covered[2:, 1:-1] & covered[1:-1, :-2] & covered[1:-1, 2:]
    row, column = np.nonzero((view.ids >= 0) & ~inner)
    face = view.ids[row, column]
    centre, rays = _rays(view, np.stack([column, row], axis=-1) + 0.5)
    corner = view.vertices[faces[face]].mean(1)
    depth = (corner - centre) @ view.cam_from_world[2, :3].astype(np.float64)
    offset = (distances[row, column] - 0.5) * depth / view.intrinsics[0, 0]
    outward = np.einsum("pi,pi->p", normals[faces[face]].mean(1), rays / np.linalg.norm(rays, axis=1, keepdims=True))
    square = np.sqrt(np.clip(1 - outward**2, 0.0, 1.0))  # how far the normal lies in the picture
    believed = np.abs(offset) < BELIEVED
    shares = np.full((int(believed.sum()), 3), 1 / 3)
    return _Pulls(face[believed], shares, offset[believed], OUTLINE * square[believed])


def _offsets(
    vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray, pulls: list[_Pulls], bending: sparse.csc_array
) -> Float[np.ndarray, " vertex"]:
    """Solve for the offset of every vertex along its normal, metres."""
    face, shares, offset, weight = (np.concatenate(column) for column in zip(*pulls, strict=True))
    row = np.repeat(np.arange(len(face)), 3)
    moved = sparse.csr_array((shares.ravel(), (row, faces[face].ravel())), shape=(len(face), len(vertices)))
    weighted = sparse.diags_array(weight) @ moved
    along = [sparse.diags_array(normals[:, axis]) for axis in range(3)]
    fair = sum(normal @ bending @ normal for normal in along)
    rough = sum(normal @ (bending @ vertices[:, axis]) for axis, normal in enumerate(along))
    matrix = moved.T @ weighted + STIFF * bending + FAIR * fair + 1e-6 * sparse.eye_array(len(vertices))
    return np.asarray(spsolve(sparse.csc_array(matrix), weighted.T @ offset - FAIR * rough))
