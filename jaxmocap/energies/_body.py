"""The part of the character that a group of DoFs moves, and drawing it over the rest of the body."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxmocap.character import Character, Pose, blend, skin
from jaxmocap.observation import FrameProblem
from jaxmocap.render import (
    BEHIND,
    Driver,
    Faces,
    KeyLayout,
    Places,
    WindowList,
    doubled_area,
    draw,
    empty_buffer,
    to_screen,
    window_list,
)


class BodyPart(eqx.Module):
    """Faces whose vertices depend on the DoFs of one group, with the vertices they use.

    `dofs` are the group's indices among all; `moves (face,)` says which faces of the whole mesh the part holds. Rows
    may be padded with faces of no area, and `dofs` with their number, which is none of them, so that groups share one
    compiled search.
    """

    num_faces: int = eqx.field(static=True)
    dofs: Int[Array, "group_dof"]
    faces: Int[Array, "3 part_face"]
    face_numbers: Int[Array, "part_face"]
    vertices: Float[Array, "part_vertex 3"]
    weights: Float[Array, "part_vertex bone"]
    moves: Bool[Array, "face"]

    @property
    def layout(self) -> KeyLayout:
        return KeyLayout.for_faces(self.num_faces)

    def unseen(self) -> "BodyPart":
        """Return the part without what draws it, which is enough to draw the rest of the body."""
        return BodyPart(
            num_faces=self.num_faces,
            dofs=self.dofs[:0],
            faces=self.faces[:, :0],
            face_numbers=self.face_numbers[:0],
            vertices=self.vertices[:0],
            weights=self.weights[:0],
            moves=self.moves,
        )

    def posed(self, character: Character, pose: Pose) -> Float[Array, "part_vertex 3"]:
        """Pose the part: its vertices in the world (Eq. 1)."""
        return blend(character.skeleton, pose, self.vertices, self.weights)


def body_part(
    character: Character, dofs: tuple[int, ...], least_faces: int = 0, least_vertices: int = 0, least_dofs: int = 0
) -> BodyPart:
    """Cut out the part of the mesh that `dofs` move (host); a root DoF moves everything.

    `dofs` are numbers among all, such as `skeleton.group("l_arm")`. With the `least_` numbers the part is filled up, so
    that several parts share their programs. Raises `ValueError` if no face depends on them.
    """
    skeleton = character.skeleton
    vertices, weights, faces = map(np.asarray, (character.vertices, character.weights, character.faces))
    moves = (weights[:, skeleton.bodies_moved_by(dofs)].sum(1) > 0)[faces].any(1)
    if not moves.any():
        raise ValueError(f"no face of the mesh depends on the DoFs {[skeleton.dof_names[d] for d in dofs]}")
    used, local = np.unique(faces[moves], return_inverse=True)
    local = local.reshape(-1, 3).T.astype(np.int32)
    more_faces, more_vertices = max(least_faces - local.shape[1], 0), max(least_vertices - len(used), 0)
    nothing = [skeleton.num_dofs] * max(least_dofs - len(dofs), 0)
    return BodyPart(
        num_faces=len(faces),
        dofs=jax.device_put(np.asarray([*dofs, *nothing], np.int32)),
        faces=jax.device_put(np.pad(local, ((0, 0), (0, more_faces)))),
        face_numbers=jax.device_put(np.pad(np.flatnonzero(moves).astype(np.int32), (0, more_faces))),
        vertices=jax.device_put(np.pad(vertices[used], ((0, more_vertices), (0, 0)), mode="edge")),
        weights=jax.device_put(np.pad(weights[used], ((0, more_vertices), (0, 0)), mode="edge")),
        moves=jax.device_put(moves),
    )


class GroupProblem(eqx.Module):
    """What all particles of one group share: they move `part` of the character from `pose`, seen in a `frame`."""

    character: Character
    part: BodyPart
    pose: Pose
    frame: FrameProblem

    @property
    def layout(self) -> KeyLayout:
        return self.part.layout


def base_buffers(
    group: GroupProblem, capacity: int
) -> tuple[Int[Array, "camera padded_height padded_width"], Int[Array, ""]]:
    """Draw the key buffers of the body without the part, one per view, and count the windows needed."""
    faces, frame, layout = group.character.faces, group.frame, group.layout
    vertices = skin(group.character, group.pose)
    numbers = jnp.arange(faces.shape[0], dtype=jnp.int32)

    def view(camera: Array) -> tuple[Array, Array]:
        screen = to_screen(vertices, frame.projection[camera], frame.origins[camera])
        drawn = Faces(faces.T, numbers, ~group.part.moves)
        listed, _ = window_list(screen, drawn, frame.size, frame.depth_range[camera], layout, capacity)
        return draw(empty_buffer(layout, *frame.size), listed, layout), listed.needed

    buffers, needed = lax.map(view, jnp.arange(frame.num_cameras, dtype=jnp.int32))
    return buffers, needed.max()


def part_windows(
    group: GroupProblem,
    vertices: Float[Array, "part_vertex 3"],
    camera: int | Int[Array, ""],
    capacity: int,
    driver: Driver | None = None,
) -> tuple[WindowList, Places]:
    """List the windows of the part in one view, and place the corners of its faces on the screen."""
    part, frame = group.part, group.frame
    screen = to_screen(vertices, frame.projection[camera], frame.origins[camera])
    drawn = Faces(part.faces, part.face_numbers)
    return window_list(screen, drawn, frame.size, frame.depth_range[camera], part.layout, capacity, driver)


def pixels_outside(places: Places, size: tuple[int, int], room: Float[Array, "4"]) -> Float[Array, ""]:
    """Sum the area, in pixels, of the front faces whose centre lies outside a rectangle but inside its picture.

    `places` are their corners, `room` is where the picture lies (`FrameProblem.room`): beyond it nothing is known.
    """
    (ax, bx, cx), (ay, by, cy) = places
    x, y, area = (ax + bx + cx) / 3, (ay + by + cy) / 3, 0.5 * doubled_area(places)
    outside = (x < -0.5) | (y < -0.5) | (x > size[1] - 0.5) | (y > size[0] - 0.5)
    top, left, bottom, right = room - 0.5
    outside &= (x >= left) & (y >= top) & (x <= right) & (y <= bottom)
    seen = jnp.maximum(jnp.maximum(ax, bx), cx) < BEHIND
    return jnp.where(outside & (area < 0) & seen, jnp.minimum(-area, 1e4), 0.0).sum()
