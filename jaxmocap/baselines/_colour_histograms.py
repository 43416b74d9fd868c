"""What a pixel's colour says about person and surroundings: histograms, as PoseCut and its relatives use them."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from jaxmocap.character import skin
from jaxmocap.observation import Observations, full_image_ids

_BINS = 32
_SURROUNDINGS = 0.4  # of the person's height, around the person


@dataclass(frozen=True)
class ColourHistograms:
    """Two RGB histograms of 32^3 bins with additive smoothing, as counts that sum to 1."""

    person: Float[np.ndarray, "32 32 32"]
    ground: Float[np.ndarray, "32 32 32"]

    @staticmethod
    def fit(
        pairs: list[tuple[UInt8[np.ndarray, "_ _ 3"], Bool[np.ndarray, "_ _"]]],
    ) -> "ColourHistograms":
        """Fit both histograms to pictures and masks of the person."""
        counts = np.zeros((2, _BINS, _BINS, _BINS))
        for picture, mask in pairs:
            for label in (0, 1):
                index = (picture[mask == bool(label)] // (256 // _BINS)).astype(np.intp)
                np.add.at(counts[label], tuple(index.T), 1.0)
        smooth = []
        for count in counts:
            blurred = count.copy()
            for axis in range(3):
                moved = np.moveaxis(blurred, axis, 0)
                padded = np.concatenate([moved[:1], moved, moved[-1:]])
                blurred = np.moveaxis(0.25 * padded[:-2] + 0.5 * padded[1:-1] + 0.25 * padded[2:], 0, axis)
            share = blurred / max(blurred.sum(), 1.0)
            smooth.append((share + 0.05 / _BINS**3) / (share.sum() + 0.05))
        return ColourHistograms(person=smooth[1], ground=smooth[0])

    def mixed(self, other: "ColourHistograms", share: float) -> "ColourHistograms":
        """Mix in this share of another pair."""
        person, ground = (
            (1 - share) * mine + share * theirs
            for mine, theirs in ((self.person, other.person), (self.ground, other.ground))
        )
        return ColourHistograms(person, ground)

    def costs(self, picture: UInt8[np.ndarray, "height width 3"]) -> tuple[np.ndarray, np.ndarray]:
        """Compute -log P of every pixel as person and as ground, nats, each (height, width)."""
        index = tuple((picture // (256 // _BINS)).astype(np.intp).transpose(2, 0, 1))
        return -np.log(self.person[index]), -np.log(self.ground[index])


def selected_histograms(observations: Observations) -> list[ColourHistograms]:
    """Fit one pair of histograms per camera to the selected frames.

    They are those of the masks, or of the registered silhouettes where there are none, and of the surroundings of the
    person.
    """
    found = []
    for camera in range(observations.cameras.num_cameras):
        pairs = []
        for frame, pose in observations.key_poses.items():
            picture = observations.capture.image(camera, frame)
            mask = observations.capture.mask(camera, frame)
            if mask is None:
                vertices = skin(observations.character, pose)
                mask = full_image_ids(observations.character, vertices, observations.cameras, frame)[camera] >= 0
            rows, columns = around(mask, _SURROUNDINGS)
            pairs.append((picture[rows, columns], mask[rows, columns]))
        found.append(ColourHistograms.fit(pairs))
    return found


def around(mask: Bool[np.ndarray, "height width"], share: float) -> tuple[slice, slice]:
    """Return rows and columns of a mask's box, widened on every side by this share of its height; all of them where it
    is empty."""
    x, y, width, height = cv2.boundingRect(mask.astype(np.uint8))
    if not width:
        return slice(0, mask.shape[0]), slice(0, mask.shape[1])
    room = round(share * height)
    return (
        slice(max(y - room, 0), min(y + height + room, mask.shape[0])),
        slice(max(x - room, 0), min(x + width + room, mask.shape[1])),
    )
