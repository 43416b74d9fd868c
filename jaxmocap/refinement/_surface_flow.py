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
from jaxtyping import Array, Bool, Int, UInt32

from jaxmocap._runtime import cores
from jaxmocap.energies import SurfaceLines, surface_lines

from ._compare import FlowSettings, compare
from ._views import View


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
