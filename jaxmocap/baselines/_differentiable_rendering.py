"""Loper, Black: OpenDR, an approximate differentiable renderer, ECCV 2014, as a tracker: a coloured body is drawn, and
followed down the gradient of what it looks like."""

from dataclasses import replace
from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Shaped

from jaxmocap._types import Knob, Quality, knob
from jaxmocap.energies import AbstractTerm, Drawn, GroupProblem, SearchEnergy, SoftDrawn
from jaxmocap.render import SoftFaces, crop
from jaxmocap.search import PolishPlan
from jaxmocap.track import Tracker


class RenderedColours(AbstractTerm):
    """Mean squared difference of RGB between the pixels that the body covers and its own colours there, over the views.

    Only covered pixels count, as in the pose tracking of the publication, which the paper holds against it: the ground
    behind the body says nothing. A body may leave the person as long as it finds her colours elsewhere. Faces whose
    colour no selected frame has shown are passed over.

    Attributes:
        weight: of the squared difference of colours in [0, 1]; 100, so that 0.1 in one channel counts 1; ours.
    """

    weight: Knob = knob(100.0)

    name: ClassVar[str] = "rendered_colours"

    def score(self, prepared: tuple[()], drawn: Drawn, group: GroupProblem) -> Float[Array, ""]:
        """Compare every covered pixel with the mean colour of its face."""
        surface, face = group.frame.surface, group.layout.face(crop(drawn.buffers))
        rows = jnp.arange(len(face))[:, None, None]
        gap = surface.mean_colour[rows, face] - group.frame.image
        share = (face >= 0) & surface.has_colour[rows, face]
        return _mean(jnp.sum(gap**2, -1), share, (1, 2)).mean()

    def soft(self, drawn: SoftDrawn) -> Float[Array, ""]:
        """Let each face count by the share of a pixel that it shows."""

        def view(view: tuple[SoftFaces, Array, Array, Array]) -> Array:
            own, colours, known, image = view
            face = jnp.maximum(own.face, 0)
            gap = colours[face] - image.reshape(-1, 3)[own.pixel][:, None]
            share = own.share * (own.live[:, None] * (own.face >= 0) * known[face])
            return _mean(jnp.sum(gap**2, -1), share, (0, 1))

        surface = drawn.frame.surface
        views = (drawn.seen, surface.mean_colour, surface.has_colour, drawn.frame.image)
        return jax.lax.map(view, views).mean()


def _mean(
    values: Float[Array, "*view a b"], share: Shaped[Array, "*view a b"], axes: tuple[int, ...]
) -> Float[Array, "*view"]:
    """Average by share; a view that shows nothing of the body is as far off as colours can be."""
    total = jnp.sum(share, axes)
    return jnp.where(total > 0, jnp.sum(values * share, axes) / jnp.maximum(total, 1e-6), 3.0)


def differentiable_rendering(quality: Quality = "normal") -> Tracker:
    """Make a tracker that goes downhill on `RenderedColours` through the soft rasteriser, from the last pose.

    There is no search, no optical flow, no background, no refinement and no solving of the whole clip. OpenDR draws
    vertex colours and compares image pyramids by the dogleg method; here faces have the mean colours of the selected
    frames, the pictures are compared at one size, and the method is BFGS.
    """
    return replace(
        Tracker.preset(quality),
        search_energy=SearchEnergy((RenderedColours(),)),
        search=None,
        polish=PolishPlan(steps=40),
        backward_search=None,
        refine=None,
        flow_start=False,
        prediction=False,
        clip=None,
    )
