"""The part of the character that a group of DoFs moves, and drawing it over the rest of the body."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxmocap.character import Character, Pose, body_transforms, skin
from jaxmocap.observation import FrameProblem
from jaxmocap.render import Jobs, KeyLayout, draw, empty_buffer, to_screen, window_jobs


class BodyPart(eqx.Module):
    """Faces whose vertices depend on the DoFs of one group, with the vertices they use.

    `moves (face,)` says which faces of the whole mesh these are. `dofs` are the group's indices into the 39.
    """

    name: str = eqx.field(static=True)
    dofs: tuple[int, ...] = eqx.field(static=True)
    num_faces: int = eqx.field(static=True)
    faces: Int[Array, "3 part_face"]
    face_numbers: Int[Array, "part_face"]
    vertices: Float[Array, "part_vertex 3"]
    weights: Float[Array, "part_vertex bone"]
    moves: Bool[Array, "face"]

    @property
    def layout(self) -> KeyLayout:
        return KeyLayout.for_faces(self.num_faces)

    def posed(self, character: Character, pose: Pose) -> Float[Array, "part_vertex 3"]:
        """The part's vertices in the world (Eq. 1)."""
        bones = body_transforms(character.skeleton, pose)[:, :3].reshape(-1, 12)
        blended = (self.weights @ bones).reshape(-1, 3, 4)
        return jnp.einsum("vij,vj->vi", blended[:, :, :3], self.vertices) + blended[:, :, 3]


def body_part(character: Character, name: str, dofs: tuple[int, ...]) -> BodyPart:
    """The part of the mesh moved by `dofs` (host). A root DoF moves everything."""
    skeleton = character.skeleton
    weights, faces = np.asarray(character.weights), np.asarray(character.faces)
    if min(dofs) < 6:
        bodies = set(range(len(skeleton.body_names)))
    else:
        bodies = {skeleton.dof_body[d - 6] for d in dofs}
        for body, parent in enumerate(skeleton.parents):
            if parent in bodies:
                bodies.add(body)
    vertex_moves = weights[:, sorted(bodies)].sum(1) > 0
    moves = vertex_moves[faces].any(1)
    if not moves.any():
        raise ValueError(f"no face of the mesh depends on the DoFs of '{name}'")
    used, local = np.unique(faces[moves], return_inverse=True)
    return BodyPart(
        name=name,
        dofs=tuple(dofs),
        num_faces=len(faces),
        faces=jnp.asarray(local.reshape(-1, 3).T.astype(np.int32)),
        face_numbers=jnp.asarray(np.flatnonzero(moves).astype(np.int32)),
        vertices=jnp.asarray(np.asarray(character.vertices)[used]),
        weights=jnp.asarray(weights[used]),
        moves=jnp.asarray(moves),
    )


class Region(NamedTuple):
    """The pixels that are scored anew for every particle: corner (row, column) inside the rectangle per view, one size."""

    corners: Int[Array, "camera 2"]
    size: tuple[int, int]

    def cut(self, values: Array, camera: int, step: int = 1, border: int = 0) -> Array:
        """The region of a (height, width, ...) array of one view, every `step`-th pixel; `border` skips a key buffer's border."""
        corner = (self.corners[camera, 0] + border, self.corners[camera, 1] + border)
        start = corner + (0,) * (values.ndim - 2)
        window = lax.dynamic_slice(values, start, self.size + values.shape[2:])
        return window[::step, ::step]


def region_mask(region: Region, camera: int, height: int, width: int) -> Bool[Array, "height width"]:
    """True inside the region of one view."""
    row, column = jnp.arange(height)[:, None], jnp.arange(width)[None, :]
    top, left = region.corners[camera, 0], region.corners[camera, 1]
    return (row >= top) & (row < top + region.size[0]) & (column >= left) & (column < left + region.size[1])


def base_buffers(
    character: Character, part: BodyPart, pose: Pose, problem: FrameProblem, capacity: int
) -> tuple[Int[Array, "camera padded_height padded_width"], Int[Array, ""]]:
    """Key buffers of the body without the part at `pose`, one per view, and the number of windows needed."""
    vertices = skin(character, pose)
    height, width = problem.size
    numbers = jnp.arange(character.faces.shape[0], dtype=jnp.int32)
    buffers, needed = [], []
    for camera in range(problem.num_cameras):
        screen = to_screen(vertices, problem.projection[camera], problem.origins[camera])
        jobs = window_jobs(
            screen, character.faces.T, numbers, ~part.moves, height, width, problem.depth_range[camera], part.layout, capacity
        )  # fmt: skip
        buffers.append(draw(empty_buffer(part.layout, height, width), jobs, part.layout))
        needed.append(jobs.needed)
    return jnp.stack(buffers), jnp.stack(needed).max()


def part_jobs(
    part: BodyPart, vertices: Float[Array, "part_vertex 3"], problem: FrameProblem, camera: int, capacity: int
) -> tuple[Jobs, Float[Array, "3 part_vertex"]]:
    """Windows of the part in one view, and its vertices on the screen."""
    height, width = problem.size
    screen = to_screen(vertices, problem.projection[camera], problem.origins[camera])
    jobs = window_jobs(
        screen, part.faces, part.face_numbers, None, height, width, problem.depth_range[camera], part.layout, capacity
    )  # fmt: skip
    return jobs, screen


def pixels_outside(
    screen: Float[Array, "3 vertex"], faces: Int[Array, "3 face"], corner: Int[Array, "2"], size: tuple[int, int]
) -> Float[Array, ""]:
    """Area, in pixels, of the front faces whose centre lies outside a region."""
    x, y, inverse = screen[0][faces], screen[1][faces], screen[2][faces]
    area = 0.5 * ((x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0]))
    cx, cy = x.mean(0) - corner[1], y.mean(0) - corner[0]
    outside = (cx < -0.5) | (cy < -0.5) | (cx > size[1] - 0.5) | (cy > size[0] - 0.5)
    return jnp.where(outside & (area < 0) & (inverse.min(0) > 0), jnp.minimum(-area, 1e4), 0.0).sum()


