"""What every term of the search energy is."""

import abc
from typing import Any, NamedTuple

import equinox as eqx
from jaxtyping import Array, Bool, Float, Int

from jaxmocap.character import Character, Pose, Skeleton
from jaxmocap.observation import FrameProblem
from jaxmocap.render import Driver, SoftFaces, SoftSettings

from ._body import GroupProblem


class Drawn(NamedTuple):
    """One particle: its pose, the key buffers with the part drawn in, the tiles in which that changed a key, and the
    mesh pixels per view that lie outside the rectangle. With the `driver` "loop" it is scored alone, with "scatter" at
    once with all others."""

    pose: Pose
    buffers: Int[Array, "camera padded_height padded_width"]
    dirty: Bool[Array, "camera down across"]
    outside: Float[Array, "camera"]
    driver: Driver


class SoftDrawn(NamedTuple):
    """One pose with soft visibility: what each view sees of it, and where its vertices are on the screen."""

    character: Character
    pose: Pose
    frame: FrameProblem
    screens: Float[Array, "camera 3 vertex"]
    seen: SoftFaces
    settings: SoftSettings


class AbstractTerm(eqx.Module):
    """Score what a particle looks like. A new term is a file with `weight`, `name` and `score`.

    Optional are `prepare`, for what no particle changes, and `soft`, for gradients.
    """

    name: eqx.AbstractClassVar[str]
    weight: eqx.AbstractVar[Float[Array, ""]]

    def prepare(self, base: Int[Array, "camera padded_height padded_width"], group: GroupProblem) -> Any:
        """Prepare what all particles of a group share; `base` are the key buffers of the rest of the body."""
        return ()

    @abc.abstractmethod
    def score(self, prepared: Any, drawn: Drawn, group: GroupProblem) -> Float[Array, ""]:
        """Compute the term of one particle, unweighted."""

    def soft(self, drawn: SoftDrawn) -> Float[Array, ""]:
        """Compute the same with soft visibility, differentiable. Raises `ValueError` if the term has no such form."""
        raise ValueError(f"the term '{self.name}' has no soft form; leave it out of the energy")


class AbstractPoseTerm(AbstractTerm):
    """Score the pose itself, not what is drawn: a file with `weight`, `name` and `score_pose`."""

    @abc.abstractmethod
    def score_pose(self, skeleton: Skeleton, pose: Pose, frame: FrameProblem) -> Float[Array, ""]:
        """Compute the term of one pose, unweighted, differentiable."""

    def score(self, prepared: Any, drawn: Drawn, group: GroupProblem) -> Float[Array, ""]:
        return self.score_pose(group.character.skeleton, drawn.pose, group.frame)

    def soft(self, drawn: SoftDrawn) -> Float[Array, ""]:
        return self.score_pose(drawn.character.skeleton, drawn.pose, drawn.frame)
