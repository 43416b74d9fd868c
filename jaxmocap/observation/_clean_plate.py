"""The clean plate of a camera while a sequence is tracked: what is behind the person, learnt frame by frame."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from jaxmocap.appearance import (
    AppearanceSettings,
    GridWarp,
    Plate,
    plate_distance,
    renewed_plate,
    warp_grid,
    warped_plate,
)

from ._flow import FrameFlow, Image, frame_flow

Window = tuple[slice, slice]

LATTICE = 8
"""The flow of every LATTICE-th background pixel carries the grid."""


@dataclass
class CleanPlate:
    """State of one camera (host): the plate expected at `frame`, the image seen there and where the person is, and the
    plate `renewed` with that image once the frame has been tracked."""

    settings: AppearanceSettings
    frame: int
    plate: Plate
    image: UInt8[np.ndarray, "height width 3"]
    person: Bool[np.ndarray, "height width"]
    renewed: Plate | None = None

    def at(
        self,
        frame: int,
        image: UInt8[np.ndarray, "height width 3"],
        person: Bool[np.ndarray, "height width"],
        flow: Callable[[Image, Image], FrameFlow] = frame_flow,
    ) -> "CleanPlate":
        """Return the plate at `frame`, before that frame is learnt; `person` is where the person is expected, `flow`
        computes the flow from the plate's frame to this one."""
        if frame == self.frame:
            return self
        warp = neighbour_warp(flow(self.image, image), self.person, person, self.settings)
        plate = warped_plate(self.plate if self.renewed is None else self.renewed, warp, self.settings.grid)
        return CleanPlate(self.settings, frame, plate, image, person)

    def distance(self, window: Window) -> Float[np.ndarray, "height width"]:
        """Compute psi_b in a window (rows, columns) of the image."""
        settings = self.settings
        plate = Plate(self.plate.picture[window], self.plate.known[window])
        return plate_distance(plate, self.image[window], settings.plate)

    def learnt(self, person: Bool[np.ndarray, "height width"], window: Window) -> "CleanPlate":
        """Return the plate after its frame has been tracked."""
        renewed = renewed_plate(self.plate, self.image, person, window, self.settings.plate)
        return CleanPlate(self.settings, self.frame, self.plate, self.image, person, renewed)


def neighbour_warp(
    flow: FrameFlow,
    person_before: Bool[np.ndarray, "height width"],
    person_after: Bool[np.ndarray, "height width"],
    settings: AppearanceSettings,
    growth: int = 10,
) -> GridWarp:
    """Warp the grid from a frame to the next one by the dense flow beside the person."""
    (height, width), size = person_before.shape, flow.agrees.shape[::-1]
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * growth + 1, 2 * growth + 1))
    masks = []
    for mask in (person_before, person_after):
        grown = cv2.dilate((mask != 0).astype(np.uint8), kernel)
        masks.append(cv2.resize(grown, size, interpolation=cv2.INTER_NEAREST) > 0)
    row, column = (a.ravel() for a in np.mgrid[LATTICE // 2 : size[1] : LATTICE, LATTICE // 2 : size[0] : LATTICE])
    start = np.stack([column, row], -1) + 0.5
    end = start + flow.forward[row, column]
    landing = np.clip(end.astype(int), 0, [size[0] - 1, size[1] - 1])
    keep = flow.agrees[row, column] & ~masks[0][row, column] & ~masks[1][landing[:, 1], landing[:, 0]]
    ratio = np.array([width / size[0], height / size[1]])
    matches = start[keep] * ratio, end[keep] * ratio
    stiffness = min(settings.warp.alphas)  # so many points need no choice: it always falls on the least
    return warp_grid(*matches, (height, width), replace(settings.warp, alphas=(stiffness,)), grid=settings.grid)
