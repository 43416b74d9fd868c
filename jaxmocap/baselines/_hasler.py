"""Hasler, Rosenhahn, Thormaehlen, Wand, Gall, Seidel: Markerless motion capture with unsynchronized moving cameras,
CVPR 2009, as the paper re-implements it: segment, fit the pose to the silhouette, repeat."""

from dataclasses import dataclass, field, replace

import cv2
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool

from jaxmocap.character import Pose
from jaxmocap.observation import (
    Edges,
    Frame,
    Observations,
    draw,
    mask_edges,
    signed_distance,
)
from jaxmocap.registration import RegistrationSettings, fit_to_masks

from ._colour_histograms import ColourHistograms, selected_histograms
from ._follower import Baseline, Follower, MaskSource, given_masks
from ._graph_cut import GridCut

_NODES = 100_000  # of one graph; larger pictures are cut at every second pixel, and so on


@dataclass(frozen=True)
class SegmentAndFit(Baseline):
    """Per frame, from the pose that autoregression predicts, `iterations` times: cut the person out of every view, with
    the colour densities of the selected frames (after the first time half of them are those of the last cut) and the
    drawn mesh as shape prior, then fit contours to the masks. The publication evolves a level set; a graph cut with the
    same unary terms minimises the same kind of energy.

    Attributes:
        iterations: of cutting and fitting; the paper reports 1 and 5.
        shape: weighs the squared distance to the drawn outline, nats per squared pixel of a person 270 pixels tall;
            ours, by the masks of four stories, as `contrast` is.
        farthest: such pixels beyond which a distance costs no more; ours.
        contrast: what an outline costs per pixel where the picture is flat, nats.
        fit: how contours are fitted; `rounds` of association.
        masks: given masks; their views are not segmented.
    """

    iterations: int = 5
    shape: float = 0.08
    farthest: float = 20.0
    contrast: float = 3.0
    fit: RegistrationSettings = field(default_factory=lambda: RegistrationSettings(rounds=6))
    masks: MaskSource | None = None

    name = "segment and fit"

    def learn_appearance(self, observations: Observations) -> list[ColourHistograms]:
        """Learn the colour densities of the selected frames."""
        return selected_histograms(observations)

    def find(self, worker: Follower, frame: Frame, start: Pose) -> Pose:
        pose, problem, crops = start, frame.problem, frame.crops()
        colours, given = list(worker.memory), given_masks(self.masks, frame)
        height, width = problem.size
        step = int(np.ceil(np.sqrt(height * width / _NODES)))
        pick = (slice(step // 2, None, step),) * 2
        small = [np.ascontiguousarray(crop[pick]) for crop in crops]
        cuts = [
            GridCut(picture.astype(float) / 255, self.contrast, 0.1 * self.contrast) if known is None else None
            for picture, known in zip(small, given, strict=True)
        ]
        for _ in range(self.iterations):
            _, ids, _ = draw(worker.character, pose, problem)
            masks = []
            for camera, (cut, known) in enumerate(zip(cuts, given, strict=True)):
                if cut is None:
                    masks.append(known)
                    continue
                body = np.asarray(ids[camera]) >= 0
                mask = self._segment(small[camera], cut, colours[camera], body[pick], step)
                masks.append(cv2.resize(mask.astype(np.uint8), body.shape[::-1], interpolation=cv2.INTER_NEAREST) > 0)
                now = ColourHistograms.fit([(crops[camera], masks[-1])])
                colours[camera] = now.mixed(worker.memory[camera], 0.5)
            edges = [mask_edges(mask) for mask in masks]
            outlined = replace(
                problem,
                edges=Edges(
                    jnp.asarray(np.stack([edge for edge, _ in edges])),
                    jnp.asarray(np.stack([way for _, way in edges]), jnp.float32),
                ),
            )
            pose = fit_to_masks(worker.character, pose, outlined, (), self.fit, [])
        return pose

    def _segment(
        self,
        picture: np.ndarray,
        cut: GridCut,
        colours: ColourHistograms,
        body: Bool[np.ndarray, "height width"],
        step: int,
    ) -> Bool[np.ndarray, "height width"]:
        person, ground = colours.costs(picture)
        if not body.any():
            return body
        tall = step * np.ptp(np.flatnonzero(body.any(1)))
        distance = np.clip(signed_distance(body) * step * 270.0 / max(tall, 1), -self.farthest, self.farthest)
        prior = self.shape * distance**2
        return cut.labels(person + np.where(distance < 0, prior, 0.0), ground + np.where(distance > 0, prior, 0.0))
