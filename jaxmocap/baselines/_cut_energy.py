"""PoseCut's energy of a frame: what the best segmentation costs in which a person's shape is expected."""

from typing import NamedTuple

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxmocap.character import Character, Pose, landmark_positions, retract
from jaxmocap.observation import FrameProblem, draw

from ._graph_cut import GridCut
from ._stick_figure import StickFigure


class CutView(NamedTuple):
    """One view's window, of which every `step`-th pixel is cut.

    Attributes:
        window: rows and columns of the rectangle.
        step: pixels between those that are cut.
        pixels: where they are in the full image, (x, y).
        lens: intrinsics and cam_from_world.
        cut: the graph.
        person: what the colour costs as person, nats.
        ground: what it costs as surroundings.
    """

    window: tuple[slice, slice]
    step: int
    pixels: Float[np.ndarray, "pixel 2"]
    lens: tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "4 4"]]
    cut: GridCut
    person: Float[np.ndarray, "row column"]
    ground: Float[np.ndarray, "row column"]


@jax.jit
def _moved(character: Character, pose: Pose, delta: Array) -> tuple[Pose, Array]:
    pose = retract(character.skeleton, pose, delta)
    return pose, landmark_positions(character.skeleton, pose)


def outline_distance(body: Bool[np.ndarray, "height width"]) -> Float[np.ndarray, "height width"]:
    """Measure the pixels from each pixel's centre to the outline of a drawn body, negative inside."""
    outside, inside = (cv2.distanceTransform(part.astype(np.uint8), cv2.DIST_L2, 5) for part in (~body, body))
    return np.where(body, 0.5 - inside, outside - 0.5)


class CutEnergy:
    """`sum_views min_x E(x, pose)` as a function of increments (dof,) of a pose; nats per pixel.

    The prior of a pixel is a logistic function of its distance to the shape: `steepness` per pixel, 1/2 at `fatness`
    pixels outside. The shape is the stick figure, or the drawn mesh where there is none.
    """

    def __init__(
        self,
        character: Character,
        pose: Pose,
        problem: FrameProblem,
        views: list[CutView],
        steepness: float,
        fatness: float,
        figure: StickFigure | None,
    ):
        self.character, self.pose, self.problem, self.views = character, pose, problem, views
        self.steepness, self.fatness, self.figure = steepness, fatness, figure

    def costs(self, delta: Float[np.ndarray, "dof"]) -> list[tuple[np.ndarray, np.ndarray]]:
        """Compute of every view what each pixel costs as person and as surroundings."""
        pose, landmarks = _moved(self.character, self.pose, jnp.asarray(delta, jnp.float32))
        bodies, places = [], np.asarray(landmarks, np.float64)
        if self.figure is None:
            bodies = np.asarray(draw(self.character, pose, self.problem)[1]) >= 0
        found = []
        for camera, view in enumerate(self.views):
            if self.figure is None:
                pick = slice(view.step // 2, None, view.step)
                away = outline_distance(bodies[camera][view.window])[pick, pick]
            else:
                away = self.figure.distance(places, *view.lens, view.pixels).reshape(view.cut.shape)
            away = self.steepness * (away - self.fatness)
            found.append((view.person + np.logaddexp(0, away), view.ground + np.logaddexp(0, -away)))
        return found

    def __call__(self, delta: Float[np.ndarray, "dof"]) -> float:
        """Compute the energy."""
        pairs = zip(self.views, self.costs(delta), strict=True)
        return sum(view.cut.energy(*costs) / costs[0].size for view, costs in pairs)

    def slope(self, delta: Float[np.ndarray, "dof"], steps: Float[np.ndarray, "dof"]) -> Float[np.ndarray, "dof"]:
        """Differentiate by central differences of these steps, at the segmentation that is best at `delta`.

        There the segmentation's own change counts nothing, so that there is one cut in all.
        """
        labels = [view.cut.labels(*costs) for view, costs in zip(self.views, self.costs(delta), strict=True)]

        def at(moved: np.ndarray) -> float:
            pairs = zip(labels, self.costs(moved), strict=True)
            return sum(float(np.where(label, one, zero).mean()) for label, (one, zero) in pairs)

        moves = steps * np.eye(len(delta))
        return np.array([at(delta + move) - at(delta - move) for move in moves]) / (2 * steps)
