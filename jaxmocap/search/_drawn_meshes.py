"""What searches draw: simplified meshes, and the part of a mesh that each group moves. Their shapes are few, so that
searches of different groups and characters share programs."""

from dataclasses import replace

import equinox as eqx
import numpy as np

from jaxmocap.character import VERTICES_STEP, Character, filled_up, simplify
from jaxmocap.energies import BodyPart, body_part
from jaxmocap.observation import Surface, filled_surface, simplified_surface

_LEAST_FACES = 500

Groups = tuple[tuple[str, tuple[int, ...]], ...]


class Mesh(eqx.Module):
    """A simplified character and its tables."""

    character: Character
    surface: Surface


def simplified_mesh(character: Character, surface: Surface, share: float) -> Mesh:
    """Simplify the mesh to this share of its faces, and fill it up (host)."""
    simple, nearest = simplify(character, max(round(share * character.faces.shape[0]), _LEAST_FACES))
    filled = filled_up(replace(simple, name="simplified"))
    tables = simplified_surface(surface, np.asarray(simple.faces), nearest)
    return Mesh(filled, filled_surface(tables, filled.faces.shape[0]))


def power_of_two(count: float, least: int = 256) -> int:
    """Round up to a power of two."""
    return max(least, 2 ** int(np.ceil(np.log2(max(count, 1)))))


def alike_parts(character: Character, groups: Groups) -> dict[str, BodyPart]:
    """Make the parts of all groups, those that share a search padded to the same shapes, which are few so that meshes
    share it too."""
    limbs, plain = character.skeleton.limbs, {name: body_part(character, dofs) for name, dofs in groups}
    parts = {}
    for name, dofs in groups:
        alike = [plain[o] for o, _ in groups if (o in limbs) == (name in limbs)]  # root and torso share one
        shapes = [(part.faces.shape[1], part.vertices.shape[0], part.dofs.shape[0]) for part in alike]
        num_faces, num_vertices, num_dofs = np.max(shapes, axis=0).tolist()
        num_faces = min(power_of_two(num_faces), character.faces.shape[0])
        num_vertices = max(-(-num_vertices // VERTICES_STEP) * VERTICES_STEP, num_faces // 2 + VERTICES_STEP)
        parts[name] = body_part(character, dofs, num_faces, num_vertices, num_dofs)
    return parts
