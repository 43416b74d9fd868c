"""The paper's marker protocol (Section "Quantitative Evaluation")."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from jaxmocap._results import InputError
from jaxmocap.character import Character
from jaxmocap.geometry import IDENTITY, Similarity, fit_similarity
from jaxmocap.motion import Motion

from ._surface import nearest_on_surface, surface_points, triangle_frames
from ._truth import sample


@dataclass(frozen=True)
class MarkerError:
    """Distances in metres, NaN where a marker is not seen or was not seen in the first frame.

    Attributes:
        faces: the triangle that each marker is attached to; -1 for a marker not seen in the first frame.
        barycentric: where on that triangle.
        distances: the paper's, the marker against its fixed surface point.
        offset_corrected: as if the marker stood off the surface by a constant vector in its triangle's frame, the mean
            over the frames.
        realigned: after all markers are moved rigidly, once for the sequence, onto the surface points; not comparable
            with the paper.
    """

    faces: Int[np.ndarray, " marker"]
    barycentric: Float[np.ndarray, "marker 3"]
    distances: Float[np.ndarray, "frame marker"]
    offset_corrected: Float[np.ndarray, "frame marker"]
    realigned: Float[np.ndarray, "frame marker"]

    @property
    def per_frame(self) -> Float[np.ndarray, " frame"]:
        """The mean over the markers seen in each frame, metres."""
        return frame_means(self.distances)


def marker_error(
    character: Character,
    motion: Motion,
    markers: Float[np.ndarray, "sample marker 3"],
    marker_times: Float[np.ndarray, " sample"] | None = None,
    *,
    truth_from_world: Similarity = IDENTITY,
) -> MarkerError:
    """Measure markers against the tracked surface: each against the point nearest to it in the motion's first frame.

    `markers` are world positions in metres, NaN where not seen: one row per frame of the motion, or one per entry of
    `marker_times` (seconds, on the clock of `motion.timestamps`), between which they are interpolated linearly.
    `truth_from_world` brings the motion's world to the markers'. Raises `InputError` if rows and frames do not match or
    no marker is seen in the first frame.
    """
    markers = np.asarray(markers, np.float64)
    if markers.ndim != 3 or markers.shape[2] != 3:
        raise InputError(f"Markers have shape {markers.shape}; (frames, markers, 3) was expected.")
    if marker_times is not None:
        markers = sample(np.asarray(marker_times, np.float64), markers, motion.timestamps)
    if len(markers) != len(motion):
        raise InputError(f"There are {len(markers)} rows of markers for {len(motion)} frames; give marker_times too.")
    seen = np.all(np.isfinite(markers), axis=-1)
    attached = np.flatnonzero(seen[0])
    if len(attached) == 0:
        raise InputError(f"No marker is seen in frame {motion.frames[0]}, the first evaluated; start where some are.")
    faces_of_mesh = np.asarray(character.faces)
    mesh = truth_from_world(_first_mesh(character, motion))
    faces, barycentric = nearest_on_surface(markers[0, attached], mesh, faces_of_mesh)
    corners = truth_from_world(_corners(character, motion, faces_of_mesh[faces]))
    points = surface_points(corners, barycentric)

    residual = np.where(seen[:, attached, None], markers[:, attached] - points, np.nan)
    frames = triangle_frames(corners)
    local = np.einsum("tmij,tmi->tmj", frames, residual)
    constant = np.nanmean(local, axis=0)
    moved = _realign(markers[:, attached], points, seen[:, attached])
    return MarkerError(
        faces=_spread(faces, attached, markers.shape[1], -1),
        barycentric=_spread(barycentric, attached, markers.shape[1], np.nan),
        distances=_spread(np.linalg.norm(residual, axis=-1).T, attached, markers.shape[1], np.nan).T,
        offset_corrected=_spread(np.linalg.norm(local - constant, axis=-1).T, attached, markers.shape[1], np.nan).T,
        realigned=_spread(np.linalg.norm(moved - points, axis=-1).T, attached, markers.shape[1], np.nan).T,
    )


def marker_statistics(distances: Float[np.ndarray, "frame marker"]) -> dict[str, float]:
    """Give the paper's figures, centimetres: mean, min and max over frames of the mean over visible markers; `p95` over
    single points."""
    per_frame = frame_means(distances)
    per_frame = per_frame[np.isfinite(per_frame)] * 100
    return {
        "mean": float(per_frame.mean()),
        "min": float(per_frame.min()),
        "max": float(per_frame.max()),
        "p95": float(np.percentile(distances[np.isfinite(distances)], 95) * 100),
    }


def frame_means(distances: Float[np.ndarray, "frame point"]) -> Float[np.ndarray, " frame"]:
    """Average the finite points of each frame; NaN where a frame has none."""
    finite = np.isfinite(distances)
    count = finite.sum(1)
    total = np.where(finite, distances, 0.0).sum(1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _first_mesh(character: Character, motion: Motion) -> np.ndarray:
    return _skin(np.asarray(character.vertices), np.asarray(character.weights), motion.body_transforms[:1])[0]


def _corners(character: Character, motion: Motion, faces: np.ndarray) -> np.ndarray:
    """Skin the three corners of some faces in every frame, (T, M, 3, 3), and no other vertex."""
    used, where = np.unique(faces, return_inverse=True)
    vertices = np.asarray(character.vertices)[used]
    weights = np.asarray(character.weights)[used]
    return _skin(vertices, weights, motion.body_transforms)[:, where.reshape(faces.shape)]


def _skin(vertices: np.ndarray, weights: np.ndarray, transforms: np.ndarray) -> np.ndarray:
    """Eq. 1 over all frames, in double precision."""
    blended = np.einsum("vb,tbij->tvij", weights, transforms[:, :, :3].astype(np.float64), optimize=True)
    return np.einsum("tvij,vj->tvi", blended[..., :3], vertices) + blended[..., 3]


def _realign(markers: np.ndarray, points: np.ndarray, seen: np.ndarray) -> np.ndarray:
    similarity = fit_similarity(markers[seen], points[seen], with_scale=False)
    return np.where(seen[..., None], similarity(markers), np.nan)


def _spread(values: np.ndarray, positions: np.ndarray, count: int, fill: float) -> np.ndarray:
    """`values` put at `positions` of a first axis of length `count`."""
    spread = np.full((count, *values.shape[1:]), fill, dtype=values.dtype)
    spread[positions] = values
    return spread
