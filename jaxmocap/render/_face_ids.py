"""Face numbers and inverse depth of a posed mesh in every view."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxmocap._cache import cached_jit
from jaxmocap._shapes import check_shape

from ._draw import draw
from ._keys import KeyLayout, crop, empty_buffer
from ._windows import Faces, to_screen, window_list


def projection_matrices(
    intrinsics: Float[Array, "*camera 3 3"], cam_from_world: Float[Array, "*camera 4 4"]
) -> Float[Array, "*camera 3 4"]:
    """Compute K [R | t] per view."""
    return jnp.matmul(intrinsics, cam_from_world[..., :3, :], precision="highest")


@jax.jit
def inverse_depth_range(
    vertices: Float[Array, "vertex 3"], cam_from_world: Float[Array, "4 4"], slack: float = 0.0
) -> Float[Array, "2"]:
    """Find the smallest and largest inverse depth (1/metres) of the vertices.

    Both sides are widened by `slack` metres of depth.
    """
    depth = jnp.matmul(vertices, cam_from_world[2, :3], precision="highest") + cam_from_world[2, 3]
    nearest = jnp.maximum(depth.min() - slack - 1e-3, 0.05)
    farthest = jnp.maximum(depth.max() + slack + 1e-3, nearest + 1e-2)
    return jnp.stack([1.0 / farthest, 1.0 / nearest])


_Drawn = tuple[Int[Array, "*camera height width"], Float[Array, "*camera height width"], Int[Array, "*camera"]]
"""Face numbers, inverse depth, and the windows needed."""


@cached_jit
def _face_ids(
    vertices: Float[Array, "vertex 3"],
    faces: Int[Array, "face 3"],
    intrinsics: Float[Array, "camera 3 3"],
    cam_from_world: Float[Array, "camera 4 4"],
    origins: Int[Array, "camera 2"],
    height: int,
    width: int,
    capacity: int,
) -> _Drawn:
    layout = KeyLayout.for_faces(faces.shape[0])
    numbers = jnp.arange(faces.shape[0], dtype=jnp.int32)

    def one_view(view: tuple[Array, Array, Array]) -> _Drawn:
        projection, world, origin = view
        depth_range = inverse_depth_range(vertices, world)
        screen = to_screen(vertices, projection, origin)
        listed, _ = window_list(screen, Faces(faces.T, numbers), (height, width), depth_range, layout, capacity)
        keys = crop(draw(empty_buffer(layout, height, width), listed, layout))
        ids = layout.face(keys)
        inverse = jnp.where(ids >= 0, layout.inverse_depth(keys, depth_range), 0.0)
        return ids, inverse, listed.needed

    return jax.lax.map(one_view, (projection_matrices(intrinsics, cam_from_world), cam_from_world, origins))


def face_ids(
    vertices: Float[Array | np.ndarray, "vertex 3"],
    faces: Int[Array | np.ndarray, "face 3"],
    intrinsics: Float[Array | np.ndarray, "camera 3 3"],
    cam_from_world: Float[Array | np.ndarray, "camera 4 4"],
    origins: Int[Array | np.ndarray, "camera 2"],
    height: int,
    width: int,
) -> tuple[Int[Array, "camera height width"], Float[Array, "camera height width"]]:
    """Find which face is seen in each pixel of a rectangle per view.

    The mesh is posed, in metres in the world; faces are front-facing when counter-clockwise seen from outside, and only
    those are drawn. `origins` are the row and column of each rectangle's first pixel, 0 and 0 for the whole picture,
    and `height` and `width` its pixels. Returns face numbers (-1 where empty) and inverse depth (1/metres, 0 where
    empty). Called from the host: a capacity that overflows is doubled and drawn again. Raises `InputError` for arrays
    of other shapes.
    """
    cameras = len(intrinsics)
    check_shape("vertices", vertices, ("vertex", 3))
    check_shape("faces", faces, ("face", 3), "three vertex numbers a row")
    check_shape("intrinsics", intrinsics, (cameras, 3, 3))
    check_shape("cam_from_world", cam_from_world, (cameras, 4, 4), "of one frame")
    check_shape("origins", origins, (cameras, 2), "row and column of each rectangle's first pixel")
    given: tuple[Any, Any, Any, Any, Any] = (vertices, faces, intrinsics, cam_from_world, origins.astype(np.int32))
    capacity = 4096
    while capacity < faces.shape[0]:
        capacity *= 2
    while True:
        ids, inverse, needed = _face_ids(*given, height, width, capacity)
        if int(np.asarray(needed).max()) <= capacity:
            return ids, inverse
        capacity = 2 ** int(np.asarray(needed).max() - 1).bit_length()
