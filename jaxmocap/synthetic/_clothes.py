"""The actor's colours, a function of the point of the skin at rest, so that they move with the body."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from ._body import SIDE_JOINTS, sheared
from ._textures import noise_volume, sample_noise

Style = Literal["patterned", "uniform", "plain sleeves"]


def _f32(values: object) -> np.ndarray:
    return np.asarray(values, np.float32)


_SKIN = _f32((0.86, 0.66, 0.54))
_HAIR = _f32((0.24, 0.16, 0.11))
_SHIRT = _f32(((0.88, 0.86, 0.80), (0.75, 0.16, 0.16), (0.16, 0.30, 0.58)))
_TROUSERS = _f32(((0.25, 0.30, 0.47), (0.52, 0.55, 0.62)))
_PLAIN_SHIRT, _PLAIN_TROUSERS = _f32((0.42, 0.52, 0.46)), _f32((0.33, 0.34, 0.38))
_SHOES = _f32((0.50, 0.22, 0.14))


@dataclass(frozen=True)
class Outfit:
    """A seeded set of clothes.

    Attributes:
        noise: the grain of the cloth.
        style: "patterned": striped and blotched shirt with short sleeves, mottled trousers; "uniform": shirt with long
            sleeves and trousers of one plain colour each, so that arms in front of the torso hardly show; "plain
            sleeves": the patterned shirt with long sleeves of one plain colour, along which nothing tells where the
            elbow is.
        channels: which of red, green and blue the clothes show as each.
    """

    noise: Float[np.ndarray, "n n n"]
    style: Style = "patterned"
    channels: tuple[int, int, int] = (0, 1, 2)

    @classmethod
    def make(cls, seed: int, style: Style = "patterned", channels: tuple[int, int, int] = (0, 1, 2)) -> "Outfit":
        return cls(noise_volume(np.random.default_rng([seed, 2])), style, channels)

    def colours(self, points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point 3"]:
        """Colour points of the 1.75 m template's skin at rest: RGB in [0, 1], whose square is the reflectance."""
        points = points.astype(np.float32)
        side, height = np.abs(points[:, 0]), points[:, 1]
        straight = sheared(points)[:, 1]
        arm = (side > 0.16) & (straight > 1.28)
        head = (side < 0.12) & (height > 1.482 - 0.35 * points[:, 2])
        grain = sample_noise(self.noise, points, 0.011)
        long_sleeves = self.style != "patterned"
        sleeve_end = np.float32(SIDE_JOINTS["wrist"][0] - 0.015 if long_sleeves else SIDE_JOINTS["elbow"][0] - 0.03)
        bare = (arm & (side > sleeve_end)) | head
        legs = ~arm & (height < 0.985)
        shoes = height < 0.098
        colour = self._shirt(points, arm, side)
        for chosen, paint in ((legs, self._trousers), (shoes, self._shoes), (bare, self._skin)):
            if chosen.any():
                colour[chosen] = paint(points[chosen])
        colour[~bare] = colour[~bare][:, self.channels]
        hair = head & (height > 1.635 + 0.62 * points[:, 2] + 0.006 * grain)
        colour[hair] = _HAIR * (1 + 0.35 * sample_noise(self.noise, points[hair] * _f32((1, 0.35, 1)), 0.012))[:, None]
        colour *= (1 + np.float32(0.05) * grain)[:, None]
        return np.clip(colour, 0.02, 0.98)

    def _shirt(self, points: np.ndarray, arm: np.ndarray, side: np.ndarray) -> np.ndarray:
        if self.style == "uniform":
            return np.tile(_PLAIN_SHIRT, (len(points), 1))
        along = np.where(arm, side, points[:, 1])
        bend = np.float32(0.012) * sample_noise(self.noise, points + np.float32(1.7), 0.09)
        stripe = _step(np.sin((along + bend) * np.float32(2 * np.pi / 0.075)), 0.25)[:, None]
        colour = (1 - stripe) * _SHIRT[0] + stripe * _SHIRT[1]
        blotch = _step(sample_noise(self.noise, points, 0.075) - np.float32(0.75), 0.12)[:, None]
        colour = (1 - blotch) * colour + blotch * _SHIRT[2]
        colour *= (1 + np.float32(0.08) * sample_noise(self.noise, points + np.float32(0.4), 0.03))[:, None]
        if self.style == "plain sleeves":
            colour[arm] = _PLAIN_SHIRT
        return colour

    def _trousers(self, points: np.ndarray) -> np.ndarray:
        if self.style == "uniform":
            return np.tile(_PLAIN_TROUSERS, (len(points), 1))
        patch = _step(sample_noise(self.noise, points + np.float32(3.1), 0.065) - np.float32(0.45), 0.35)[:, None]
        colour = (1 - patch) * _TROUSERS[0] + patch * _TROUSERS[1]
        colour = colour * (1 + np.float32(0.13) * sample_noise(self.noise, points + np.float32(0.9), 0.025))[:, None]
        seam = np.abs(points[:, 2] + np.float32(0.01)) < 0.013
        outside = np.abs(points[:, 0]) > 0.11
        colour[seam & outside] = (0.80, 0.62, 0.22)
        colour[points[:, 1] > 0.957] = (0.14, 0.10, 0.08)
        return colour

    def _shoes(self, points: np.ndarray) -> np.ndarray:
        colour = _SHOES * (1 + np.float32(0.2) * sample_noise(self.noise, points, 0.03))[:, None]
        colour[points[:, 1] < 0.022] = (0.85, 0.85, 0.82)
        laces = (np.abs(np.sin(points[:, 2] * np.float32(np.pi / 0.022))) > 0.75) & (points[:, 1] > 0.055)
        colour[laces & (points[:, 2] > 0.02)] = (0.88, 0.88, 0.85)
        return colour

    def _skin(self, points: np.ndarray) -> np.ndarray:
        mottled = sample_noise(self.noise, points + np.float32(5.3), 0.04)[:, None]
        colour = _SKIN * (1 + mottled * _f32((0.05, 0.08, 0.09)))
        x, y, z = np.abs(points[:, 0]), points[:, 1], points[:, 2]
        front = (z > 0.05) & (y > 1.5)
        eye = np.square(x - 0.031) / 0.014**2 + np.square(y - 1.650) / 0.008**2
        colour[front & (eye < 1)] = (0.92, 0.92, 0.90)
        colour[front & (np.square(x - 0.031) + np.square(y - 1.650) < 0.0062**2)] = (0.12, 0.09, 0.08)
        brow = np.abs(y - 1.671 + 0.12 * np.abs(x - 0.03)) < 0.0045
        colour[front & brow & (x > 0.012) & (x < 0.052)] = _HAIR
        colour[front & (np.abs(y - 1.578) < 0.0075) & (x < 0.024)] = (0.68, 0.34, 0.32)
        watch = (points[:, 0] > 0.525) & (points[:, 0] < 0.548)
        colour[watch & (y < 1.3)] = (0.10, 0.10, 0.12)
        return colour


def _step(value: np.ndarray, width: float) -> np.ndarray:
    """Rise from 0 below -width to 1 above +width, straight between."""
    return np.clip(np.float32(0.5) + value / np.float32(2 * width), 0, 1)


@dataclass(frozen=True)
class Subject:
    """What is drawn of a person.

    Attributes:
        rest: vertices at rest in template size, for the colours.
        faces: triangles.
        outfit: clothes.
    """

    rest: Float[np.ndarray, "vertex 3"]
    faces: Int[np.ndarray, "face 3"]
    outfit: Outfit
