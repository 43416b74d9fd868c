"""Masks as rows of the shape problem: contour points of the posed mesh, tied to the masks' outlines."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxmocap.camera import Cameras
from jaxmocap.capture import Capture
from jaxmocap.character import Character, Pose, skin
from jaxmocap.energies import ContourSettings, SurfaceLines, contour_lines
from jaxmocap.observation import FrameProblem, build_problem, draw, frame_rectangle, mask_edges, surface_of

OUTLINE_SCALE = 0.02
"""Distance from an outline that counts as one in the residual, metres."""
_WIDE_ROUNDS = 3  # the first ones look for outlines farther away
Masks = list[list[Bool[np.ndarray, "height width"] | None]]
Outlines = tuple[SurfaceLines, Float[Array, "frame row"], Float[Array, "frame row"]]


def mask_problems(
    capture: Capture, cameras: Cameras, character: Character, poses: dict[int, Pose], masks: Masks
) -> list[FrameProblem]:
    """Make one problem per frame, all of one size; its edges are the masks' outlines, none in a view without a mask."""
    surface = surface_of(character, None, cameras.num_cameras)
    posed = {frame: np.asarray(skin(character, pose)) for frame, pose in poses.items()}
    room = np.full(cameras.num_cameras, 30.0)
    rectangle = None
    for frame, vertices in posed.items():  # once to find the largest
        rectangle = frame_rectangle(vertices, cameras, frame, previous=rectangle, speed=room)
    problems = []
    for (frame, vertices), row in zip(posed.items(), masks, strict=True):
        rectangle = frame_rectangle(vertices, cameras, frame, previous=rectangle, speed=room)
        blank = np.zeros((rectangle.height, rectangle.width), bool)
        edges = [mask_edges(blank if mask is None else rectangle.crop(mask, c)) for c, mask in enumerate(row)]
        images = [capture.image(c, frame) for c in range(cameras.num_cameras)]
        problems.append(build_problem(images, rectangle, cameras, frame, vertices, surface, edges=edges))
    return problems


def outlines(character: Character, poses: Sequence[Pose], problems: list[FrameProblem], number: int) -> Outlines:
    """Tie contour points of the posed mesh to the masks (Gall et al. 2009), for round `number`.

    Every row has its scale and its Geman-McClure scale in metres; each array has a leading frame axis.
    """
    wide = number < _WIDE_ROUNDS
    settings = ContourSettings(
        reach=30 if wide else 15,
        step=6,
        capacity=512,
        inside=True,
        accept_cosine=jnp.asarray(0.5),
        accept_score=jnp.asarray(0.8),
    )
    lines = []
    for pose, problem in zip(poses, problems, strict=True):
        vertices, ids, inverse = draw(character, pose, problem)
        lines.append(contour_lines(vertices, character.faces, ids, inverse, problem, settings))
    together = jax.tree.map(lambda *leaves: jnp.stack(leaves), *lines)
    count = together.weight.shape
    return together, jnp.full(count, OUTLINE_SCALE), jnp.full(count, 0.06 if wide else 0.03)
