"""Bray, Kohli, Torr: PoseCut, simultaneous segmentation and 3D pose estimation of humans using dynamic graph-cuts,
ECCV 2006."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.optimize import minimize
from scipy.spatial.distance import cdist

from jaxmocap.character import Character, Pose, Skeleton, clamp, landmark_positions, retract
from jaxmocap.motion import MotionHistory
from jaxmocap.observation import Frame, Observations

from ._colour_histograms import ColourHistograms, selected_histograms
from ._follower import Baseline, Follower
from ._graph_cut import GridCut

_BONES = (
    ("pelvis", "spine"), ("spine", "thorax"), ("thorax", "neck"), ("neck", "head"), ("head", "head_top"),
    ("l_hip", "r_hip"), ("l_shoulder", "r_shoulder"),
    *((f"{s}_{a}", f"{s}_{b}") for s in "lr" for a, b in (
        ("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"), ("ankle", "toe"),
        ("heel", "toe"),
    )),
)  # fmt: skip
_ROOT_REACH = (0.15, 0.15, 0.15, 0.4, 0.4, 0.4)


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


@jax.jit
def _landmarks(skeleton: Skeleton, pose: Pose, delta: Array) -> Array:
    return landmark_positions(skeleton, retract(skeleton, pose, delta))


@dataclass(frozen=True)
class PoseCut(Baseline):
    """The pose whose best segmentation costs least: `min_pose sum_views min_x E(x, pose)`, where E has colour
    histograms from the selected frames, a stick figure as soft shape prior, and a Potts term that is cheap along image
    edges. The inner minimum is a graph cut, the outer one Powell's method group by group from the last pose.

    `steepness` is how fast the prior falls (per pixel of a person 270 pixels tall), `fatness` where it is 1/2 (pixels
    outside the capsules), `contrast` and `constant` the Potts term at full size, `evaluations` the cuts per group,
    `pixels` the largest picture that is cut: larger ones are looked at every second pixel, and so on. With a stronger
    Potts term thin limbs are cheaper left out than cut out. The publication re-uses flows (dynamic cuts), which changes
    the time and not the result.
    """

    steepness: float = 1.0
    fatness: float = 0.0
    contrast: float = 3.0
    constant: float = 0.3
    evaluations: int = 100
    pixels: int = 1800

    name = "posecut"

    def learn_appearance(self, observations: Observations) -> tuple[StickFigure, list[ColourHistograms]]:
        """Make the stick figure, and the histograms of the selected frames."""
        return StickFigure(observations.character), selected_histograms(observations)

    def start(self, worker: Follower, history: MotionHistory) -> Pose:
        """Begin at the last pose, as in the publication."""
        return history.pose

    def find(self, worker: Follower, frame: Frame, start: Pose) -> Pose:
        skeleton, energy = worker.character.skeleton, self.energy(worker, frame, start)
        unit, found = skeleton.initial_spread, np.zeros(skeleton.num_dofs)
        low = np.concatenate([-np.array(_ROOT_REACH), np.asarray(skeleton.lower - start.angles)])
        high = np.concatenate([np.array(_ROOT_REACH), np.asarray(skeleton.upper - start.angles)])
        low, high = np.minimum(np.maximum(low, -4 * unit), 0.0), np.maximum(np.minimum(high, 4 * unit), 0.0)
        for _, dofs in skeleton.groups:
            index = np.array(dofs)

            def moved(values: np.ndarray, index=index, found=found) -> np.ndarray:
                delta = found.copy()
                delta[index] = values * unit[index]
                return delta

            best = minimize(
                lambda values, moved=moved: energy(moved(values)),
                found[index] / unit[index],
                method="Powell",
                bounds=list(zip(low[index] / unit[index], high[index] / unit[index] + 1e-6, strict=True)),
                options={"maxfev": self.evaluations, "xtol": 0.03, "ftol": 1e-5},
            )
            if best.fun < energy(found):
                found = moved(best.x)
        return clamp(skeleton, retract(skeleton, start, jnp.asarray(found, jnp.float32)))

    def energy(self, worker: Follower, frame: Frame, pose: Pose):
        """Make a function of increments (dof,) of a pose: the sum over views of the smallest cut, nats per pixel."""
        figure, histograms = worker.memory
        view, rectangle = worker.cameras.at(frame.number), frame.rectangle
        step = int(np.ceil(np.sqrt(rectangle.height * rectangle.width / self.pixels)))
        first = step // 2
        views = []
        for camera, whole in enumerate(frame.crops()):
            crop = whole[first::step, first::step]
            rows, columns = np.mgrid[: crop.shape[0], : crop.shape[1]] * step + first + 0.5
            row, column = rectangle.origins[camera]
            at = np.stack([columns.ravel() + column, rows.ravel() + row], 1)
            cut = GridCut(crop.astype(float) / 255, self.contrast / step, self.constant / step)
            lens = np.asarray(view.intrinsics[camera], float), np.asarray(view.cam_from_world[camera], float)
            views.append((at, cut, histograms[camera].costs(np.ascontiguousarray(crop)), lens))
        tall = rectangle.height / 1.4

        def energy(delta: np.ndarray) -> float:
            places = _landmarks(worker.character.skeleton, pose, jnp.asarray(delta, jnp.float32))
            landmarks, total = np.asarray(places, np.float64), 0.0
            for at, cut, (person, ground), lens in views:
                away = figure.distance(landmarks, *lens, at).reshape(cut.shape) - self.fatness
                away = self.steepness * 270.0 / tall * away
                total += cut.energy(person + np.logaddexp(0, away), ground + np.logaddexp(0, -away)) / away.size
            return total

        return energy
