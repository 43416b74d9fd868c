"""Similarity transforms between point sets and between sets of cameras."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class Similarity:
    """target = scale * rotation @ source + translation."""

    scale: float
    rotation: Float[np.ndarray, "3 3"]
    translation: Float[np.ndarray, "3"]

    def __call__(self, points: Float[np.ndarray, "*shape 3"]) -> Float[np.ndarray, "*shape 3"]:
        return self.scale * points @ self.rotation.T + self.translation

    def cameras(self, cam_from_source: Float[np.ndarray, "*shape 4 4"]) -> Float[np.ndarray, "*shape 4 4"]:
        """Move cameras: cam_from_target, with translations in the target's units."""
        result = np.array(cam_from_source, np.float64)
        result[..., :3, :3] = cam_from_source[..., :3, :3] @ self.rotation.T
        result[..., :3, 3] = self.scale * cam_from_source[..., :3, 3] - result[..., :3, :3] @ self.translation
        return result

    @property
    def angle(self) -> float:
        """Angle of the rotation, radians."""
        return float(np.arccos(np.clip((np.trace(self.rotation) - 1) / 2, -1, 1)))


IDENTITY = Similarity(1.0, np.eye(3), np.zeros(3))


def fit_similarity(
    source: Float[np.ndarray, "point 3"], target: Float[np.ndarray, "point 3"], *, with_scale: bool = True
) -> Similarity:
    """Fit the similarity with least squared distance (Umeyama, PAMI 1991, Eqs. 40-43): never a reflection."""
    source, target = np.asarray(source, np.float64), np.asarray(target, np.float64)
    source_mean, target_mean = source.mean(0), target.mean(0)
    centred_source, centred_target = source - source_mean, target - target_mean
    rotation, stretch = _procrustes(centred_target.T @ centred_source)
    spread = np.sum(centred_source**2)
    scale = float(stretch / spread) if with_scale and spread > 0 else 1.0
    return Similarity(scale, rotation, target_mean - scale * rotation @ source_mean)


def align_cameras(source: Float[np.ndarray, "camera 4 4"], target: Float[np.ndarray, "camera 4 4"]) -> Similarity:
    """Fit the similarity target_world_from_source_world between two sets of poses of the same cameras.

    `source` and `target` are `cam_from_world`. The rotation fits the cameras' orientations and their centres at once
    (the centres divided by their spread), so that it is well defined for two static cameras, or one. Scale and
    translation then fit the centres; without any spread of centres the scale is 1.
    """
    source, target = np.asarray(source, np.float64), np.asarray(target, np.float64)
    source_centres, target_centres = camera_centres(source), camera_centres(target)
    source_mean, target_mean = source_centres.mean(0), target_centres.mean(0)
    a, b = source_centres - source_mean, target_centres - target_mean
    spread_a, spread_b = np.sum(a**2), np.sum(b**2)
    orientations = np.einsum("nji,njk->ik", target[:, :3, :3], source[:, :3, :3])
    smallest = 1e-6 * len(source)
    positions = b.T @ a * len(source) / np.sqrt(spread_a * spread_b) if min(spread_a, spread_b) > smallest else 0.0
    rotation, _ = _procrustes(orientations + positions)
    scale = float(np.sum(b * (a @ rotation.T)) / spread_a) if spread_a > smallest else 1.0
    scale = scale if scale > 0 else 1.0
    return Similarity(scale, rotation, target_mean - scale * rotation @ source_mean)


def camera_residuals(similarity: Similarity, source: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Measure what `align_cameras` leaves per camera: distance of centres (metres of the target), angle (radians)."""
    distance = np.linalg.norm(similarity(camera_centres(source)) - camera_centres(target), axis=-1)
    turned = source[:, :3, :3] @ similarity.rotation.T
    cosine = (np.einsum("nij,nij->n", turned, target[:, :3, :3]) - 1) / 2
    return distance, np.arccos(np.clip(cosine, -1, 1))


def _procrustes(correlation: np.ndarray) -> tuple[np.ndarray, float]:
    """Find the rotation R of largest tr(R^T correlation), and that value."""
    left, values, right = np.linalg.svd(correlation)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right)) or 1.0])
    return (left * signs) @ right, float(values @ signs)


def camera_centres(cam_from_world: Float[np.ndarray, "camera 4 4"]) -> Float[np.ndarray, "camera 3"]:
    """Find where cameras stand in the world."""
    return -np.einsum("nji,nj->ni", cam_from_world[:, :3, :3], cam_from_world[:, :3, 3])
