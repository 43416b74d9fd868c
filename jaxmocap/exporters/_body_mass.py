"""Masses of the bodies: de Leva's table (1996), and the capsules where that does not reach."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxmocap.character import Character, capsules

DENSITY = 1000.0
"""Kilograms per cubic metre, of a person who breathes quietly, to one or two per cent."""


class _Segment(NamedTuple):
    """A segment of de Leva's Table 4, the mean of women and men; per cent.

    Attributes:
        mass: of the whole body's.
        ends: the landmarks between which it lies, where our body has the same.
        centre: from the first to the second, where the centre of mass lies.
        across: radius of gyration across this line (the mean of his two), of its length.
        along: the same about the line.
    """

    mass: float
    ends: tuple[str, str] | None = None
    centre: float = 50.0
    across: float = 0.0
    along: float = 0.0


_SEGMENTS = {
    "head": _Segment(6.81),
    "upper_arm": _Segment(2.63, ("shoulder", "elbow"), 57.63, 27.3, 15.3),
    "forearm": _Segment(1.50, ("elbow", "wrist"), 45.67, 26.5, 10.75),
    "hand": _Segment(0.585),
    "thigh": _Segment(14.47, ("hip", "knee"), 38.54, 34.7, 15.55),
    "shank": _Segment(4.57, ("knee", "ankle"), 44.38, 26.05, 9.8),
    "foot": _Segment(1.33, ("heel", "toe"), 42.15, 27.0, 13.15),
}
"""The neck counts to the head."""
_TRUNK = ("pelvis", "abdomen", "chest", "clavicle")
_TRUNK_MASS = 43.015
"""Per cent (ibid.), shared by the capsules' volumes: our trunk is cut in other places than his."""
_THINNEST = 0.02
"""Metres: the radius of a body without skin of its own, so that it has some mass."""


class BodyMass(NamedTuple):
    """Of each body, in the rest pose.

    Attributes:
        masses: kilograms.
        centres: of mass, metres.
        inertias: about the centre of mass, kg m^2.
    """

    masses: Float[np.ndarray, " bone"]
    centres: Float[np.ndarray, "bone 3"]
    inertias: Float[np.ndarray, "bone 3 3"]


def body_mass(character: Character, total: float | None = None) -> BodyMass:
    """Share out the person's mass, `total` kilograms; by default what the mesh encloses weighs as much as water.

    Arms and legs have de Leva's masses, centres of mass and radii of gyration. Head and hands have his mass in a solid
    capsule, the parts of the trunk share his by the volumes of theirs, as solid cylinders. A body he does not know is
    a capsule as dense as the others.
    """
    skeleton, around = character.skeleton, capsules(character)
    parts = [name.removeprefix("l_").removeprefix("r_") for name in skeleton.body_names]
    trunk = np.isin(parts, _TRUNK)
    way, radii = around.ends - around.starts, np.maximum(around.radii, _THINNEST)
    lengths = np.linalg.norm(way, axis=1)
    cylinders, balls = np.pi * radii**2 * lengths, 4 / 3 * np.pi * radii**3
    volumes = cylinders + balls
    shares = np.array([_SEGMENTS[part].mass if part in _SEGMENTS else np.nan for part in parts])
    shares[trunk] = _TRUNK_MASS * volumes[trunk] / volumes[trunk].sum()
    known = np.isfinite(shares)
    shares[~known] = volumes[~known] * (shares[known].sum() / volumes[known].sum() if known.any() else 1.0)
    masses = (_weight(character) if total is None else total) * shares / shares.sum()
    straight = np.where(trunk & (lengths > 0), 1.0, cylinders / volumes)  # the part that is a cylinder
    along = radii**2 * (straight / 2 + (1 - straight) * 2 / 5)
    across = straight * (lengths**2 / 12 + radii**2 / 4) + (1 - straight) * (
        2 / 5 * radii**2 + lengths**2 / 4 + 3 / 8 * lengths * radii
    )
    centres = 0.5 * (around.starts + around.ends)
    for number, (name, part) in enumerate(zip(skeleton.body_names, parts, strict=True)):
        segment = _SEGMENTS.get(part, _Segment(0.0))
        ends = [f"{name[:2]}{point}" for point in segment.ends or ()]
        if ends and set(ends) <= set(skeleton.landmark_names):
            a, b = (np.asarray(skeleton.landmark(point), np.float64) for point in ends)
            centres[number], way[number] = a + segment.centre / 100 * (b - a), b - a
            across[number], along[number] = (np.array([segment.across, segment.along]) / 100) ** 2 * ((b - a) @ (b - a))
    way /= np.maximum(np.linalg.norm(way, axis=1), 1e-9)[:, None]
    outer = way[:, :, None] * way[:, None, :]
    inertias = across[:, None, None] * np.eye(3) + (along - across)[:, None, None] * outer
    return BodyMass(masses, centres, masses[:, None, None] * inertias)


def _weight(character: Character) -> float:
    """Weigh what the mesh encloses, kilograms."""
    a, b, c = np.asarray(character.vertices, np.float64)[np.asarray(character.faces)].swapaxes(0, 1)
    return DENSITY * abs(float(np.einsum("fi,fi->", a, np.cross(b, c)))) / 6
