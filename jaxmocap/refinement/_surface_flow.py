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
from jaxtyping import Array, Bool, Float, Int, UInt8

from jaxmocap._runtime import cores
from jaxmocap.character import Character
from jaxmocap.energies import SurfaceLines, surface_lines
from jaxmocap.observation import FrameProblem

from ._compare import FlowSettings, compare, grey
from ._sources import Source


def surface_flow(
    character: Character,
    vertices: Float[Array, "vertex 3"],
    ids: Int[Array, "camera height width"],
    images: list[UInt8[np.ndarray, "height width 3"]],
    problem: FrameProblem,
    sources: list[list[Source]],
    settings: FlowSettings,
) -> list[SurfaceLines]:
    """Build rows for every view and source; a pixel uses every source that sees it.

    `images` are the rectangles of the current frame, `sources[camera]` is a list in order of preference.
    """
    host_ids = np.asarray(ids)
    greys = [grey(image) for image in images]
    pairs = [(camera, source) for camera in range(problem.num_cameras) for source in sources[camera]]

    def one(pair: tuple[int, Source]) -> list[SurfaceLines]:
        camera, source = pair
        return _one_source(character, vertices, host_ids[camera], greys[camera], camera, problem, source, settings)

    with ThreadPoolExecutor(cores()) as pool:
        return [lines for found in pool.map(one, pairs) for lines in found]


def _one_source(
    character: Character,
    vertices: Float[Array, "vertex 3"],
    ids: Int[np.ndarray, "height width"],
    target: UInt8[np.ndarray, "height width"],
    camera: int,
    problem: FrameProblem,
    source: Source,
    settings: FlowSettings,
) -> list[SurfaceLines]:
    """Rows of one view and source; as many for every frame, so that what uses them compiles once."""
    view = jax.device_put((np.asarray(problem.intrinsics)[camera], np.asarray(problem.cam_from_world)[camera]))
    found = compare(character, vertices, ids, target, camera, problem, source, settings)
    picked = pick_samples(found.good, settings.samples)
    alive = np.arange(settings.samples) < found.good.sum()
    row, column = np.divmod(picked, ids.shape[1])
    origin = np.asarray(problem.origins)[camera]
    here = (np.stack([column, row], -1) + origin[::-1] + 0.5).astype(np.float32)
    shares = np.where(alive, found.weight[row, column], 0.0).astype(np.float32)
    pixels, targets, shares = jax.device_put((here, here + found.moved[row, column], shares))
    face = ids[row, column]
    lines = [surface_lines(vertices, character.faces, face, pixels, targets, shares, view)]
    if source.same_time:
        other = (source.intrinsics, source.cam_from_world)
        there = jax.device_put(np.where(alive[:, None], found.source_pixel[row, column], 0.0).astype(np.float32))
        lines.append(surface_lines(vertices, character.faces, face, pixels, there, shares, view, other))
    return lines


def pick_samples(good: Bool[np.ndarray, "height width"], samples: int) -> Int[np.ndarray, "sample"]:
    """Pick evenly spread flat indices of good pixels; index 0 fills up when there are too few (rows of weight 0)."""
    candidates = np.flatnonzero(good)
    if len(candidates) >= samples:
        return candidates[np.arange(samples) * len(candidates) // samples]
    return np.concatenate([candidates, np.zeros(samples - len(candidates), candidates.dtype)])
