"""Bray, Kohli, Torr: PoseCut, simultaneous segmentation and 3D pose estimation of humans using dynamic graph-cuts,
ECCV 2006."""

from dataclasses import dataclass
from typing import Literal

import jax.numpy as jnp
import numpy as np
from scipy.optimize import minimize

from jaxmocap.character import Pose, clamp, retract
from jaxmocap.motion import MotionHistory
from jaxmocap.observation import Frame, Observations, draw

from ._colour_histograms import ColourHistograms, around, selected_histograms
from ._cut_energy import CutEnergy, CutView
from ._follower import Baseline, Follower, MaskSource, given_masks
from ._graph_cut import GridCut
from ._stick_figure import StickFigure

_ROOT_REACH = (0.15, 0.15, 0.15, 0.4, 0.4, 0.4)
_ROOM = 0.15  # of the person's height, around the person, that is cut
_CERTAIN = 10.0  # nats that a label costs which a given mask denies
_DIFFERENCE = 0.1  # step of the stick figure's slopes, in units of the skeleton's initial spread
_TALL = 270.0  # pixels of the person for whom the settings are said


@dataclass(frozen=True)
class PoseCut(Baseline):
    """The pose whose best segmentation costs least: `min_pose sum_views min_x E(x, pose)`, where E has colour
    histograms from the selected frames, the body as soft shape prior, and a Potts term that is cheap along image edges.
    The inner minimum is a graph cut, the outer one is looked for from the last pose.

    The publication has a stick figure and Powell's method, `figure="sticks"` and `outer="powell"`, which goes group by
    group here; given true masks and last poses in three views they stayed 3.8 cm off in fast motion. The mesh and a
    quasi-Newton method (L-BFGS-B) on all degrees of freedom find what they miss (0.9).

    Attributes:
        steepness: how fast the prior falls, per pixel of a person 270 pixels tall; 1, ours.
        fatness: where it is 1/2, such pixels outside the body; 0, ours.
        contrast: the part of the Potts term that edges make cheap, nats at full size; 3, ours: with more, limbs are
            left out.
        constant: the part that edges leave alone, nats; 0.3, ours.
        pixels: the largest picture that is cut; larger ones are looked at every second pixel, and so on; 4000, ours.
        figure: the shape, the character's own "mesh", ours, or "sticks", capsules along its bones, the publication's.
        outer: how the pose is looked for, "descent", ours, or "powell", the publication's.
        iterations: of the descent at most; 40, ours.
        evaluations: cuts per group of Powell's method; 100, ours.
        masks: given masks; in their views colours say nothing.
    """

    steepness: float = 1.0
    fatness: float = 0.0
    contrast: float = 3.0
    constant: float = 0.3
    pixels: int = 4000
    figure: Literal["mesh", "sticks"] = "mesh"
    outer: Literal["descent", "powell"] = "descent"
    iterations: int = 40
    evaluations: int = 100
    masks: MaskSource | None = None

    name = "posecut"

    def learn_appearance(self, observations: Observations) -> tuple[StickFigure | None, list[ColourHistograms]]:
        """Make the stick figure, if it is asked for, and the histograms of the selected frames."""
        figure = StickFigure(observations.character) if self.figure == "sticks" else None
        return figure, selected_histograms(observations)

    def start(self, worker: Follower, history: MotionHistory, timestamp: float) -> Pose:
        """Begin at the last pose, as in the publication."""
        return history.pose

    def find(self, worker: Follower, frame: Frame, start: Pose) -> Pose:
        skeleton, energy = worker.character.skeleton, self.energy(worker, frame, start)
        unit = skeleton.initial_spread
        low = np.concatenate([-np.array(_ROOT_REACH), np.asarray(skeleton.lower - start.angles)])
        high = np.concatenate([np.array(_ROOT_REACH), np.asarray(skeleton.upper - start.angles)])
        low, high = np.minimum(np.maximum(low, -4 * unit), 0.0), np.maximum(np.minimum(high, 4 * unit), 0.0)
        look = self._powell if self.outer == "powell" else self._descent
        found = look(energy, unit, np.stack([low / unit, high / unit + 1e-6], 1), [d for _, d in skeleton.groups])
        return clamp(skeleton, retract(skeleton, start, jnp.asarray(found * unit, jnp.float32)))

    def energy(self, worker: Follower, frame: Frame, pose: Pose) -> CutEnergy:
        """Make the energy of a frame, around a pose."""
        figure, histograms = worker.memory
        view, given = worker.cameras.at(frame.number), given_masks(self.masks, frame)
        drawn = np.asarray(draw(worker.character, pose, frame.problem)[1]) >= 0
        views, heights = [], []
        for camera, (crop, known) in enumerate(zip(frame.crops(), given, strict=True)):
            window = around(drawn[camera], _ROOM)
            heights.append((window[0].stop - window[0].start) / (1 + 2 * _ROOM))
            step = int(np.ceil(np.sqrt(drawn[camera][window].size / self.pixels)))
            part = window[0].start + step // 2, window[1].start + step // 2
            pick = slice(part[0], window[0].stop, step), slice(part[1], window[1].stop, step)
            picture = np.ascontiguousarray(crop[pick])
            lens = np.asarray(view.intrinsics[camera], float), np.asarray(view.cam_from_world[camera], float)
            if known is None:
                costs = histograms[camera].costs(picture)
            else:
                costs = _CERTAIN * ~known[pick], _CERTAIN * known[pick]
            at = np.moveaxis(np.mgrid[pick][::-1], 0, -1).reshape(-1, 2) + frame.rectangle.origins[camera][::-1] + 0.5
            cut = GridCut(picture.astype(float) / 255, self.contrast / step, self.constant / step)
            views.append(CutView(window, step, at, lens, cut, *costs))
        steepness = self.steepness * _TALL / max(float(np.mean(heights)), 1.0)
        return CutEnergy(worker.character, pose, frame.problem, views, steepness, self.fatness, figure)

    def _descent(self, energy: CutEnergy, unit: np.ndarray, box: np.ndarray, groups: list) -> np.ndarray:
        """Descend in all degrees of freedom together."""
        best = minimize(
            lambda values: energy(values * unit),
            np.zeros(len(unit)),
            jac=lambda values: energy.slope(values * unit, _DIFFERENCE * unit) * unit,
            method="L-BFGS-B",
            bounds=box,
            options={"maxiter": self.iterations, "ftol": 1e-6},
        )
        return best.x

    def _powell(self, energy: CutEnergy, unit: np.ndarray, box: np.ndarray, groups: list) -> np.ndarray:
        """Look for the minimum in one group of degrees of freedom after the other."""
        found = np.zeros(len(unit))
        for dofs in groups:
            index = np.array(dofs)

            def moved(values: np.ndarray, index: np.ndarray = index, found: np.ndarray = found) -> np.ndarray:
                whole = found.copy()
                whole[index] = values
                return whole

            best = minimize(
                lambda values, moved=moved: energy(moved(values) * unit),
                found[index],
                method="Powell",
                bounds=box[index],
                options={"maxfev": self.evaluations, "xtol": 0.03, "ftol": 1e-5},
            )
            if best.fun < energy(found * unit):
                found = moved(best.x)
        return found
