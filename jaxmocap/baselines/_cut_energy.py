"""PoseCut's energy of a frame: what the best segmentation costs in which a person's shape is expected."""

from typing import NamedTuple

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.special import expit

from jaxmocap.character import Character, Pose, landmark_positions, retract, skin
from jaxmocap.observation import FrameProblem, draw, unit_gradient

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


class Outline(NamedTuple):
    """What surrounds a drawn body, at every pixel: the distance from its centre to the outline in pixels, negative
    inside, the way outwards, (dx, dy), and the face at the nearest point of the outline."""

    away: Float[np.ndarray, "row column"]
    outwards: Float[np.ndarray, "row column 2"]
    face: Int[np.ndarray, "row column"]


def outline_of(ids: Int[np.ndarray, "row column"]) -> Outline:
    """Measure a drawn body (face ids, -1 empty) that shows at least one pixel."""
    body = (ids >= 0).astype(np.uint8)
    rim = (body > 0) & (cv2.erode(body, np.ones((3, 3), np.uint8), borderValue=1) == 0)
    if not rim.any():
        rim = body > 0
    distance, number = cv2.distanceTransformWithLabels(
        (~rim).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    label = np.asarray(number, np.intp)
    at = np.zeros((label.max() + 1, 2), np.intp)
    at[label[rim]] = np.argwhere(rim)
    nearest = at[label]
    away = np.where(body > 0, -distance - 0.5, distance - 0.5)
    way = (np.moveaxis(np.indices(ids.shape), 0, -1) - nearest)[..., ::-1] * np.where(body > 0, -1.0, 1.0)[..., None]
    slope = unit_gradient(cv2.GaussianBlur(away.astype(np.float32), (0, 0), 1.0))
    length = np.linalg.norm(way, axis=-1, keepdims=True)
    outwards = np.where(length > 0, way / np.maximum(length, 1e-9), slope)
    return Outline(away, outwards, ids[nearest[..., 0], nearest[..., 1]])


@jax.jit
def _landmarks(character: Character, pose: Pose, delta: Array) -> Array:
    return landmark_positions(character.skeleton, retract(character.skeleton, pose, delta))


@jax.jit
def _moved(character: Character, pose: Pose, delta: Array) -> Pose:
    return retract(character.skeleton, pose, delta)


@jax.jit
def _pushed(character: Character, pose: Pose, delta: Array, force: Float[Array, "vertex 3"]) -> Float[Array, "dof"]:
    """Turn slopes over the vertices into slopes over the increment."""
    _, back = jax.vjp(lambda moved: skin(character, retract(character.skeleton, pose, moved)), delta)
    return back(force)[0]


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
        self.faces = np.asarray(character.faces)

    def __call__(self, delta: Float[np.ndarray, "dof"]) -> float:
        """Compute the energy."""
        costs = [self._costs(view, away) for view, away in zip(self.views, self._distances(delta), strict=True)]
        return sum(view.cut.energy(*pair) / pair[0].size for view, pair in zip(self.views, costs, strict=True))

    def slope(self, delta: Float[np.ndarray, "dof"], steps: Float[np.ndarray, "dof"]) -> Float[np.ndarray, "dof"]:
        """Differentiate at the segmentation that is best at `delta`: how it changes itself counts nothing there.

        An outline moves as the surface at its nearest point does. For the stick figure central differences of `steps`
        are taken.
        """
        if self.figure is None:
            return self._slope_of_mesh(delta)
        pairs = [self._costs(view, away) for view, away in zip(self.views, self._distances(delta), strict=True)]
        labels = [view.cut.labels(*pair) for view, pair in zip(self.views, pairs, strict=True)]

        def at(moved: np.ndarray) -> float:
            costs = [self._costs(view, away) for view, away in zip(self.views, self._distances(moved), strict=True)]
            return sum(float(np.where(label, *pair).mean()) for label, pair in zip(labels, costs, strict=True))

        moves = steps * np.eye(len(delta))
        return np.array([at(delta + move) - at(delta - move) for move in moves]) / (2 * steps)

    def _distances(self, delta: np.ndarray) -> list[np.ndarray]:
        """Measure the pixels that are cut to the shape, of every view."""
        change = jnp.asarray(delta, jnp.float32)
        if self.figure is None:
            return [outline.away for outline in self._outlines(_moved(self.character, self.pose, change))]
        places = np.asarray(_landmarks(self.character, self.pose, change), np.float64)
        return [self.figure.distance(places, *view.lens, view.pixels).reshape(view.cut.shape) for view in self.views]

    def _outlines(self, pose: Pose) -> list[Outline]:
        """Draw the body; what surrounds it at the pixels that are cut, of every view."""
        drawn, found = np.asarray(draw(self.character, pose, self.problem)[1]), []
        for ids, view in zip(drawn, self.views, strict=True):
            part, pick = ids[view.window], slice(view.step // 2, None, view.step)
            if (part >= 0).any():
                found.append(Outline(*(values[pick, pick] for values in outline_of(part))))
            else:  # it has left the window: as far away as it can be
                shape = view.cut.shape
                far, nowhere = float(max(part.shape)), np.zeros((*shape, 2))
                found.append(Outline(np.full(shape, far), nowhere, np.zeros(shape, np.int32)))
        return found

    def _costs(self, view: CutView, away: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute what each pixel costs as person and as surroundings."""
        away = self.steepness * (away - self.fatness)
        return view.person + np.logaddexp(0, away), view.ground + np.logaddexp(0, -away)

    def _slope_of_mesh(self, delta: np.ndarray) -> np.ndarray:
        change = jnp.asarray(delta, jnp.float32)
        pose = _moved(self.character, self.pose, change)
        vertices = np.asarray(skin(self.character, pose), np.float64)
        force = np.zeros_like(vertices)
        for view, outline in zip(self.views, self._outlines(pose), strict=True):
            label = view.cut.labels(*self._costs(view, outline.away))
            steep = self.steepness * expit(self.steepness * np.where(label, 1, -1) * (outline.away - self.fatness))
            push = np.where(label, -steep, steep) / label.size
            corners = self.faces[outline.face]
            intrinsics, cam_from_world = view.lens
            local = vertices[corners].mean(-2) @ cam_from_world[:3, :3].T + cam_from_world[:3, 3]
            depth = np.maximum(local[..., 2:], 0.1)
            along = push[..., None] * outline.outwards * np.diag(intrinsics)[:2] / depth
            inwards = -np.sum(along * local[..., :2] / depth, -1, keepdims=True)
            world = np.concatenate([along, inwards], -1) @ cam_from_world[:3, :3] / 3
            np.add.at(force, corners.reshape(-1), np.repeat(world.reshape(-1, 3), 3, axis=0))
        return np.asarray(_pushed(self.character, self.pose, change, jnp.asarray(force, jnp.float32)), np.float64)
