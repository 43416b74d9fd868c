"""What PoseCut takes for the shape of a person: a stick figure of capsules."""

import numpy as np
from jaxtyping import Float
from scipy.spatial.distance import cdist

from jaxmocap.character import Character

_BONES = (
    ("pelvis", "spine"), ("spine", "thorax"), ("thorax", "neck"), ("neck", "head"), ("head", "head_top"),
    ("l_hip", "r_hip"), ("l_shoulder", "r_shoulder"),
    *((f"{s}_{a}", f"{s}_{b}") for s in "lr" for a, b in (
        ("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"), ("ankle", "toe"),
        ("heel", "toe"),
    )),
)  # fmt: skip


class StickFigure:
    """The bones as capsules whose radius is the mean distance of the skin that is nearest to each."""

    def __init__(self, character: Character):
        names = character.skeleton.landmark_names
        bones = [bone for bone in _BONES if all(name in names for name in bone)]
        self.ends = np.array([[names.index(name) for name in bone] for bone in bones])
        rest = np.asarray(character.skeleton.landmarks, np.float64)
        skin = np.asarray(character.vertices, np.float64)
        a, b = rest[self.ends[:, 0]], rest[self.ends[:, 1]]
        along = np.linspace(0, 1, 9)[:, None, None]
        distance = np.min([cdist(skin, place) for place in a + along * (b - a)], axis=0)
        nearest = distance.argmin(1)
        count = np.bincount(nearest, minlength=len(bones))
        radius = np.bincount(nearest, distance.min(1), minlength=len(bones)) / np.maximum(count, 1)
        self.radius = np.where(count > 0, radius, radius[count > 0].min())

    def distance(
        self,
        landmarks: Float[np.ndarray, "landmark 3"],
        intrinsics: Float[np.ndarray, "3 3"],
        cam_from_world: Float[np.ndarray, "4 4"],
        pixels: Float[np.ndarray, "pixel 2"],
    ) -> Float[np.ndarray, "pixel"]:
        """Measure the pixels from each point of the image to the nearest capsule, negative inside."""
        local = landmarks @ cam_from_world[:3, :3].T + cam_from_world[:3, 3]
        depth = np.maximum(local[:, 2:], 0.1)
        screen = (local @ intrinsics.T)[:, :2] / depth
        a, b = screen[self.ends[:, 0]], screen[self.ends[:, 1]]
        radius = intrinsics[0, 0] * self.radius / depth[self.ends, 0].mean(1)
        way = b - a
        square = np.maximum((way**2).sum(1), 1e-9)
        x, y = pixels[:, 0, None] - a[:, 0], pixels[:, 1, None] - a[:, 1]
        share = np.clip((x * way[:, 0] + y * way[:, 1]) / square, 0.0, 1.0)
        return (np.hypot(x - share * way[:, 0], y - share * way[:, 1]) - radius).min(1)
