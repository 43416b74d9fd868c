"""Correspondences by transferring a picture over the surface: what the model should look like against what is seen.

A source picture (the same camera at a selected frame or at the last frame, or another camera at this frame) is moved
over the mesh into the current view at the current pose; the dense flow from that prediction to the real image says
where each visible surface point should be. With selected frames as sources this does not drift; with the other camera
as source it is view-view consistency (Eq. 7) in least-squares form; with the last frame it is the flow tracking of the
paper's [4].
"""

from concurrent.futures import ThreadPoolExecutor

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt32

from jaxmocap._runtime import cores
from jaxmocap.character import Character, Pose, difference, retract
from jaxmocap.energies import SurfaceLines, surface_lines
from jaxmocap.observation import Frame, draw
from jaxmocap.refiners import Shooting

from ._compare import FlowSettings, compare
from ._least_squares import Rows, descend, free_prior
from ._views import View, current_views

FOLLOWED_SCALE = 0.02
"""Metres that count as 1 where a surface is followed."""


def follow_surface(
    character: Character,
    frame: Frame,
    sources: list[list[View]],
    base: Pose,
    pose: Pose,
    settings: FlowSettings,
    robust: float,
) -> tuple[Pose, Float[Array, "dof dof"]]:
    """Move a pose to where optical flow sees the surface of the sources, by two Gauss-Newton steps; return it with
    J^T J, of which a row is metres / `FOLLOWED_SCALE`.

    `sources[camera]` are pictures in which the pose is known, `robust` is the Geman-McClure scale in metres. A weak
    pull towards `base` decides where no row does; it is part of J^T J.
    """
    posed, ids, _ = draw(character, pose, frame.problem)
    views = current_views(frame.crops(), frame.problem, posed, ids)
    flows = surface_flow(character.faces, frame.problem.surface.near_faces, views, sources, settings)
    rows = tuple(Rows(lines, FOLLOWED_SCALE, robust) for lines in flows)
    start, pull = difference(character.skeleton, base, pose), character.skeleton.per_dof(root=0.1, angles=0.5)
    delta, hessian = descend(character, base, start, rows, (), free_prior(character, base, pull), Shooting(), steps=2)
    return retract(character.skeleton, base, delta), hessian + np.diag(pull)


def surface_flow(
    faces: Int[Array, "face 3"],
    near_faces: UInt32[Array, "face word"],
    views: list[View],
    sources: list[list[View]],
    settings: FlowSettings,
) -> list[SurfaceLines]:
    """Build rows for every view of the current frame and each of its sources; a pixel uses every source that sees it.

    `sources[camera]` is a list in order of preference, `near_faces` the bit table of Eq. 7.
    """
    pairs = [(view, source) for view, own in zip(views, sources, strict=True) for source in own]
    with ThreadPoolExecutor(cores()) as pool:
        rows = pool.map(lambda pair: _rows(faces, near_faces, pair[0], pair[1], settings), pairs)
        return [lines for found in rows for lines in found]


def _rows(
    faces: Int[Array, "face 3"],
    near_faces: UInt32[Array, "face word"],
    view: View,
    source: View,
    settings: FlowSettings,
) -> list[SurfaceLines]:
    """Rows of one view and source; as many for every frame, so that what uses them compiles once."""
    found = compare(faces, near_faces, view, source, settings)
    picked = pick_samples(found.good, settings.samples)
    alive = np.arange(settings.samples) < found.good.sum()
    row, column = np.divmod(picked, view.ids.shape[1])
    here = (np.stack([column, row], -1) + view.origin[::-1] + 0.5).astype(np.float32)
    shares = np.where(alive, found.weight[row, column], 0.0).astype(np.float32)
    pixels, targets, shares = jax.device_put((here, here + found.moved[row, column], shares))
    vertices, face = jax.device_put(view.vertices), view.ids[row, column]
    camera, other = (jax.device_put((one.intrinsics, one.cam_from_world)) for one in (view, source))
    lines = [surface_lines(vertices, faces, face, pixels, targets, shares, camera)]
    if source.same_time:
        there = jax.device_put(np.where(alive[:, None], found.source_pixel[row, column], 0.0).astype(np.float32))
        lines.append(surface_lines(vertices, faces, face, pixels, there, shares, camera, other))
    return lines


def pick_samples(good: Bool[np.ndarray, "height width"], samples: int) -> Int[np.ndarray, "sample"]:
    """Pick evenly spread flat indices of good pixels; index 0 fills up when there are too few (rows of weight 0)."""
    candidates = np.flatnonzero(good)
    if len(candidates) >= samples:
        return candidates[np.arange(samples) * len(candidates) // samples]
    return np.concatenate([candidates, np.zeros(samples - len(candidates), candidates.dtype)])
