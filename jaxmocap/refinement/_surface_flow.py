"""Correspondences by transferring a picture over the surface: what the model should look like against what is seen.

A source picture (the same camera at a selected frame or at the last frame, or another camera at this frame) is moved
over the mesh into the current view at the current pose; the dense flow from that prediction to the real image says
where each visible surface point should be. With selected frames as sources this does not drift; with the other camera
as source it is view-view consistency (Eq. 7) in least-squares form; with the last frame it is the flow tracking of the
paper's [4].
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Literal, NamedTuple

import cv2
import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt8, UInt32

from jaxmocap._runtime import cores
from jaxmocap.camera import Cameras
from jaxmocap.character import Character, Pose, skin
from jaxmocap.energies import SurfaceLines, surface_lines
from jaxmocap.observation import FrameProblem, flow_agrees, flow_both_ways, sample_picture, squared_length
from jaxmocap.render import face_ids

from ._transfer import View, transfer

MARGIN = 3
"""Pixels from the silhouette that flow does not tell of."""

FACING = 0.25
"""Least cosine between a face's normal and the direction to either camera."""

COLOUR = 0.2
"""Largest grey difference of a match that is believed, 0 to 1."""

LONGEST = 25.0
"""Longest flow that is believed, pixels."""


@dataclass(frozen=True)
class Source:
    """A picture whose pose is known: image, camera, posed mesh, and the faces seen in it (full image, -1 where empty).

    `same_time` marks another camera at the current frame: its surface points then follow the pose being refined.
    """

    image: UInt8[np.ndarray, "height width 3"]
    intrinsics: Float[Array, "3 3"]
    cam_from_world: Float[Array, "4 4"]
    vertices: Float[Array, "vertex 3"]
    ids: Int[Array, "source_height source_width"]
    origin: tuple[int, int] = (0, 0)
    same_time: bool = False


def picture_source(
    character: Character,
    cameras: Cameras,
    image: UInt8[np.ndarray, "height width 3"],
    frame: int,
    camera: int,
    pose: Pose,
) -> Source:
    """Make a source of one camera's picture of a frame whose pose is known."""
    view = cameras.at(frame)
    vertices = skin(character, pose)
    width, height = cameras.sizes[camera]
    intrinsics, cam_from_world = np.asarray(view.intrinsics)[camera], np.asarray(view.cam_from_world)[camera]
    corner = np.zeros((1, 2), np.int32)
    ids, _ = face_ids(vertices, character.faces, intrinsics[None], cam_from_world[None], corner, height, width)
    return Source(image, intrinsics, cam_from_world, vertices, np.asarray(ids)[0])


def padded(
    crop: UInt8[np.ndarray, "height width 3"], origin: Int[np.ndarray, "2"]
) -> UInt8[np.ndarray, "rows columns 3"]:
    """Put the crop at its row and column in an image that is black elsewhere, so that pixels keep their coordinates."""
    whole = np.zeros((crop.shape[0] + int(origin[0]), crop.shape[1] + int(origin[1]), 3), np.uint8)
    whole[int(origin[0]) :, int(origin[1]) :] = crop
    return whole


def same_time_sources(
    pictures: Sequence[UInt8[np.ndarray, "_ _ 3"]],
    problem: FrameProblem,
    vertices: Float[Array, "vertex 3"],
    ids: Sequence[np.ndarray] | np.ndarray | Int[Array, "camera height width"],
) -> list[Source]:
    """Make sources, for the other views, of what every view shows at the current frame.

    `pictures` keep the coordinates of the whole image (`padded`), `ids` are those of the rectangles.
    """
    intrinsics, cam_from_world = np.asarray(problem.intrinsics), np.asarray(problem.cam_from_world)
    views = zip(pictures, intrinsics, cam_from_world, ids, np.asarray(problem.origins).tolist(), strict=True)
    return [Source(p, k, t, vertices, seen, (row, column), same_time=True) for p, k, t, seen, (row, column) in views]


@dataclass(frozen=True)
class FlowSettings:
    """How closely optical flow looks at the surface. Not in the paper.

    Attributes:
        samples: rows per view and source; 800.
        preset: of OpenCV's DIS flow: "ultrafast", "fast" or "medium"; "medium".
    """

    samples: int = 800
    preset: Literal["ultrafast", "fast", "medium"] = "medium"


def _view(
    intrinsics: Float[Array | np.ndarray, "3 3"],
    cam_from_world: Float[Array | np.ndarray, "4 4"],
    vertices: Float[Array, "vertex 3"],
    ids: Int[Array | np.ndarray, "rows columns"],
    origin: tuple[int, int],
) -> View:
    return View(np.asarray(intrinsics), np.asarray(cam_from_world), np.asarray(vertices), np.asarray(ids), origin)


def _grey(image: np.ndarray) -> np.ndarray:
    return cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)


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
    greys = [_grey(image) for image in images]
    pairs = [(camera, source) for camera in range(problem.num_cameras) for source in sources[camera]]

    def one(pair: tuple[int, Source]) -> list[SurfaceLines]:
        camera, source = pair
        return _one_source(character, vertices, host_ids[camera], greys[camera], camera, problem, source, settings)

    with ThreadPoolExecutor(cores()) as pool:
        return [lines for found in pool.map(one, pairs) for lines in found]


class Comparison(NamedTuple):
    """A source transferred into a view: where each pixel's surface point lies in the source, whether it is seen there
    too, whether its flow may be believed, the flow in pixels, and how much structure there is."""

    source_pixel: Float[np.ndarray, "height width 2"]
    seen: Bool[np.ndarray, "height width"]
    good: Bool[np.ndarray, "height width"]
    moved: Float[np.ndarray, "height width 2"]
    weight: Float[np.ndarray, "height width"]


def compare(
    character: Character,
    vertices: Float[Array, "vertex 3"],
    ids: Int[np.ndarray, "height width"],
    target: UInt8[np.ndarray, "height width"],
    camera: int,
    problem: FrameProblem,
    source: Source,
    settings: FlowSettings,
) -> Comparison:
    """Compute the flow from what a source predicts of one view (`ids`, grey picture `target`) to what is seen."""
    origins = np.asarray(problem.origins).tolist()
    intrinsics, cam_from_world = np.asarray(problem.intrinsics)[camera], np.asarray(problem.cam_from_world)[camera]
    view = _view(intrinsics, cam_from_world, vertices, ids, tuple(origins[camera]))
    shown = _view(source.intrinsics, source.cam_from_world, source.vertices, source.ids, source.origin)
    faces, near_faces = np.asarray(character.faces), np.asarray(problem.surface.near_faces)
    return compare_views(faces, near_faces, view, target, shown, _grey(source.image), settings)


def compare_views(
    faces: Int[np.ndarray, "face 3"],
    near_faces: UInt32[np.ndarray, "face word"],
    view: View,
    target: UInt8[np.ndarray, "height width"],
    source: View,
    source_picture: UInt8[np.ndarray, "_ _"],
    settings: FlowSettings,
) -> Comparison:
    """Compare as `compare` does, where both views of the mesh are at hand; pictures are grey."""
    source_pixel, seen, cosine = transfer(faces, near_faces, view, source)
    weight, moved = np.zeros(seen.shape, np.float32), np.zeros((*seen.shape, 2), np.float32)
    good = np.zeros(seen.shape, bool)
    box = _box_of(seen)
    if box is not None:
        transferred = sample_picture(source_picture, source_pixel[box][..., 0], source_pixel[box][..., 1])
        seen_here, target_here = seen[box], target[box]
        gain = float(np.clip(target_here[seen_here].mean() / max(transferred[seen_here].mean(), 1.0), 0.5, 2.0))
        predicted = np.where(seen_here, np.clip(transferred * gain, 0, 255), target_here).astype(np.uint8)
        forward, backward = flow_both_ways(predicted, target_here, settings.preset)
        good[box] = usable(seen_here, cosine[box], forward, backward, predicted, target_here)
        weight[box], moved[box] = textured(predicted), forward
    return Comparison(source_pixel, seen, good, moved, weight)


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


def _box_of(seen: Bool[np.ndarray, "height width"], border: int = 24) -> tuple[slice, slice] | None:
    """Rows and columns around the pixels seen, or None when they are too few to compare."""
    if seen.sum() < 200:
        return None
    rows, columns = np.flatnonzero(seen.any(1)), np.flatnonzero(seen.any(0))
    return (
        slice(max(int(rows[0]) - border, 0), int(rows[-1]) + border + 1),
        slice(max(int(columns[0]) - border, 0), int(columns[-1]) + border + 1),
    )


def usable(
    seen: Bool[np.ndarray, "height width"],
    cosine: Float[np.ndarray, "height width"],
    forward: np.ndarray,
    backward: np.ndarray,
    predicted: np.ndarray,
    target: np.ndarray,
) -> Bool[np.ndarray, "height width"]:
    """Mark the pixels whose flow may be believed."""
    size = 2 * MARGIN + 1
    good = cv2.erode(seen.astype(np.uint8), np.ones((size, size), np.uint8), borderValue=0) > 0
    good &= (cosine > FACING) & flow_agrees(forward, backward)
    good &= squared_length(forward) < LONGEST**2
    height, width = target.shape
    there = np.arange(width) + 0.5 + forward[..., 0], np.arange(height)[:, None] + 0.5 + forward[..., 1]
    found = sample_picture(target, *there)
    return good & (np.abs(found.astype(np.float32) - predicted) < 255 * COLOUR)


def textured(picture: UInt8[np.ndarray, "height width"]) -> Float[np.ndarray, "height width"]:
    """Measure how far the surroundings of a pixel tell where it is, in [0, 1): 0 where they are flat or an edge."""
    structure = cv2.cornerMinEigenVal(cv2.GaussianBlur(picture, (0, 0), 1.0), 9, ksize=3)
    structure = np.maximum(structure, 0.0)  # rounding makes it negative where the picture is flat
    return structure / (structure + 2e-4)


def pick_samples(good: Bool[np.ndarray, "height width"], samples: int) -> Int[np.ndarray, "sample"]:
    """Pick evenly spread flat indices of good pixels; index 0 fills up when there are too few (rows of weight 0)."""
    candidates = np.flatnonzero(good)
    if len(candidates) >= samples:
        return candidates[np.arange(samples) * len(candidates) // samples]
    return np.concatenate([candidates, np.zeros(samples - len(candidates), candidates.dtype)])
