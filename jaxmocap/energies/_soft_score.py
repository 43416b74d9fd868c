"""Eq. 5 with soft visibility: one pose, differentiable."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from jaxmocap.character import Character, Pose, skin
from jaxmocap.observation import FrameProblem
from jaxmocap.render import SoftFaces, SoftSettings, soft_faces, to_screen

from ._search_energy import SearchEnergy
from ._term import SoftDrawn


class SoftScore(NamedTuple):
    """`total`, `terms (term,)` unweighted, and the `needed` windows, pixels and shares of the busiest view, to be held
    against `SoftSettings`: what does not fit is left out."""

    total: Float[Array, ""]
    terms: Float[Array, "term"]
    needed: Int[Array, "3"]


def soft_score(
    energy: SearchEnergy, character: Character, pose: Pose, problem: FrameProblem, settings: SoftSettings | None = None
) -> SoftScore:
    """Score one pose by Eq. 5 with soft visibility, for `jax.grad` and `vmap`.

    In the limit of zero `settings.width` it is the energy of the search. Differentiable in pose, vertices, cameras,
    weights and colours.

    Every pixel is shared by the faces that cover parts of it (`soft_faces`): in Eq. 6 each pays its share of the
    covered cost and what is left pays the uncovered cost; in Eq. 7 each looks for its own partner, and near faces count
    by their share of the partner's pixel. Raises `ValueError` for a term that only knows key buffers.
    """
    settings = SoftSettings() if settings is None else settings
    vertices = skin(character, pose)
    faces = character.faces.T
    height, width = problem.size

    def look(view: tuple[Array, Array, Array]) -> tuple[Array, SoftFaces]:
        projection, origin, depths = view
        screen = to_screen(vertices, projection, origin)
        return screen, soft_faces(screen, faces, height, width, depths, settings)

    screens, seen = lax.map(look, (problem.projection, problem.origins, problem.depth_range))
    drawn = SoftDrawn(character, pose, problem, screens, seen, settings)
    terms = jnp.stack([term.soft(drawn) for term in energy.terms])
    return SoftScore(energy.weighted(terms), terms, seen.needed.max(0))
