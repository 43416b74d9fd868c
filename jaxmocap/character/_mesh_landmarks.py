"""Landmarks read off the surface: nose, eyes and ears from the head, toes and heels from the feet."""

from collections.abc import Mapping

import numpy as np


def mesh_landmarks(
    vertices: np.ndarray, body_weights: Mapping[str, np.ndarray], places: Mapping[str, np.ndarray], height: float
) -> dict[str, np.ndarray]:
    """Positions (metres, rest frame) of the landmarks the mesh shows; `body_weights` holds one column per body."""
    found = {}
    if (head := vertices[body_weights["head"] > 0.5]).size:
        found.update(_face(head, places, height))
    for side, sign in (("l", 1.0), ("r", -1.0)):
        foot = vertices[body_weights[f"{side}_foot"] > 0.5]
        if len(foot) >= 8:
            found[f"{side}_toe"] = foot[np.argmax(foot[:, 2])]
            found[f"{side}_big_toe"] = foot[np.argmax(foot @ np.array([-0.5 * sign, 0.0, 1.0]))]
            found[f"{side}_small_toe"] = foot[np.argmax(foot @ np.array([sign, 0.0, 0.8]))]
            low = foot[foot[:, 1] < foot[:, 1].min() + 0.04 * height]
            found[f"{side}_heel"] = low[np.argmin(low[:, 2])]
    return found


def _face(head: np.ndarray, places: Mapping[str, np.ndarray], height: float) -> dict[str, np.ndarray]:
    """The nose is the foremost point; ears and eyes follow at ordinary heights above it, on the surface."""
    middle = places["neck"][0]
    centre = np.abs(head[:, 0] - middle) < 0.02 * height
    upper = head[:, 1] > head[:, 1].max() - 0.12 * height
    candidates = head[centre & upper]
    if len(candidates) == 0:
        return {}
    nose = candidates[np.argmax(candidates[:, 2])].copy()
    nose[0] = middle
    found = {"nose": nose}
    for side, sign in (("l", 1.0), ("r", -1.0)):
        eye = nose + height * np.array([0.018 * sign, 0.02, -0.01])
        nearest = head[np.argmin(np.sum((head - eye)[:, :2] ** 2, axis=1) + 1e3 * (head[:, 2] < places["neck"][2]))]
        found[f"{side}_eye"] = np.array([eye[0], eye[1], nearest[2]])
        band = head[np.abs(head[:, 1] - nose[1] - 0.01 * height) < 0.02 * height]
        found[f"{side}_ear"] = band[np.argmax(sign * band[:, 0])]
    return found
