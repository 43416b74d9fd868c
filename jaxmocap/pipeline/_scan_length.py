"""A known length in a scan's pictures, such as a door: its two ends, marked in some of them, tell the scale."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from pydantic import FiniteFloat

from jaxmocap._results import InputError
from jaxmocap.camera import Cameras, View, pixel_rays, project, triangulate
from jaxmocap.capture import Undistortion

SHORTEST, LONGEST = 0.02, 20.0
"""Metres that a known length may have."""

NARROWEST = 5.0
"""Degrees that the lines of sight to an end must differ by: below, slips of a mark along them are not noticed."""

APART, LEAST_APART = 0.006, 3.0
"""Share of a picture's longer side by which a mark may miss where all of them together put its end, and pixels that
it may in any case."""

UNCERTAIN = 0.04
"""Share by which a pixel of error in the marks may change the length."""

TALL = (0.4, 3.8)
"""Metres that the largest silhouette of a person may measure across, from corner to corner."""

_SHOWN = 5  # names in a message

Pixel = tuple[float, float]


class MeasuredLength(NamedTuple):
    """How a known length was found in pictures.

    Attributes:
        metres: that it has.
        pictures: in which it is marked and that have a camera.
        off_pixels: by which the worst mark misses where all put its end together, pixels of the recorded picture.
        percent_per_pixel: standard deviation of the length, per cent, if every mark is off by a pixel.
    """

    metres: FiniteFloat
    pictures: int
    off_pixels: FiniteFloat
    percent_per_pixel: FiniteFloat


@dataclass(frozen=True)
class KnownLength:
    """A length in metres, and its ends in the pictures of these names, pixels.

    Raises `InputError` for a length that nothing has, for marks in fewer than two pictures, and for marks that are no
    two different pixels.
    """

    metres: float
    marks: Mapping[str, tuple[Pixel, Pixel]]

    def __post_init__(self) -> None:
        if not SHORTEST < self.metres < LONGEST:
            raise InputError(f"--known-length is {self.metres:g}; metres were expected, {SHORTEST} to {LONGEST:g}.")
        if len(self.marks) < 2:
            raise InputError(
                f"--known-length is marked in {', '.join(self.marks) or 'no picture'}; mark both of its ends in two "
                "pictures or more, taken from different directions."
            )
        for name, ends in self.marks.items():
            if np.shape(ends) != (2, 2) or not np.isfinite(ends).all():
                raise InputError(f"--known-length marks {ends} in {name}; two pixels were expected, X,Y:X,Y.")
            if np.array_equal(*ends):
                raise InputError(f"--known-length marks one pixel twice in {name}; mark the two ends of the length.")

    def refuse_outside(self, pictures: Path, names: Sequence[str], size: tuple[int, int]) -> None:
        """Raise `InputError` for marks in pictures that there are not, or outside them; `size` is theirs."""
        for name, ends in self.marks.items():
            if name not in names:
                there = f"{', '.join(names[:_SHOWN])}{' and so on' if len(names) > _SHOWN else ''}"
                raise InputError(f"--known-length names {name!r}, and the pictures in {pictures} are called {there}.")
            for x, y in ends:
                if not (0 <= x <= size[0] and 0 <= y <= size[1]):
                    raise InputError(
                        f"--known-length marks {x:g},{y:g} in {name}, outside of its {size[0]} x {size[1]} pixels; "
                        f"give pixels as they are counted in {pictures}."
                    )

    def scale(
        self, pictures: Sequence[str], cameras: Cameras, recorded: tuple[int, int]
    ) -> tuple[Cameras, MeasuredLength]:
        """Scale the cameras of the `pictures`, which have these names, to metres.

        Cameras have one frame; marks are in pixels of the pictures as `recorded` (width, height), which may have been
        made smaller since. Raises `InputError` where fewer than two of the marked pictures have a camera, where these
        see an end along nearly one line, and where marks do not agree or are too near to each other to tell the length.
        """
        names = [name for name in self.marks if name in pictures]
        if len(names) < 2:
            lost = ", ".join(name for name in self.marks if name not in names)
            raise InputError(
                f"--known-length is marked in {lost}, which could not be placed among the other pictures; mark it in "
                "two that were."
            )
        marked = cameras.only([pictures.index(name) for name in names])
        view, pixels = marked.at(0), self._ideal(names, marked, recorded)
        _refuse_narrow(names, view, pixels)
        larger = max(recorded) / max(cameras.sizes[0])
        found, per_pixel, off = map(float, _measured(pixels, view))
        if not off <= max(APART * max(cameras.sizes[0]), LEAST_APART):
            raise InputError(_disagreement(names, view, pixels, larger * off))
        share = per_pixel / found / larger
        if not share <= UNCERTAIN:
            raise InputError(
                f"the marks of --known-length in {_listed(names)} are too near to each other: a pixel of error in them "
                f"is {100 * share:.0f} % of the length; mark something longer, or in pictures that show it larger."
            )
        scaled = replace(cameras, cam_from_world=cameras.cam_from_world.at[..., :3, 3].multiply(self.metres / found))
        return scaled, MeasuredLength(self.metres, len(names), round(larger * off, 2), round(100 * share, 3))

    def _ideal(self, names: Sequence[str], cameras: Cameras, recorded: tuple[int, int]) -> Float[Array, "picture 2 2"]:
        """Map the marks in some pictures to pixels of these as they are now, without distortion."""
        smaller = np.divide(cameras.sizes[0], recorded)
        lenses = zip(cameras.intrinsics, cameras.distortion, cameras.sizes, strict=True)
        pixels = [
            Undistortion(np.asarray(k), np.asarray(d), size).points(smaller * self.marks[name])
            for name, (k, d, size) in zip(names, lenses, strict=True)
        ]
        return jnp.asarray(np.stack(pixels), jnp.float32)


@jax.jit
def _measured(
    pixels: Float[Array, "picture 2 2"], view: View
) -> tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]]:
    """Measure a length, by how much a pixel of error in every mark changes it, and by how many pixels the worst mark
    misses where all put its end; infinite where that is behind a camera."""

    def length(pixels: Float[Array, "picture 2 2"]) -> tuple[Float[Array, ""], Float[Array, "2 3"]]:
        ends = triangulate(view, pixels, jnp.ones(pixels.shape[:2]))
        return jnp.linalg.norm(ends[1] - ends[0]), ends

    (found, ends), per_pixel = jax.value_and_grad(length, has_aux=True)(pixels)
    shown, depth = project(view.intrinsics, view.cam_from_world, ends[None])
    off = jnp.where(depth > 0, jnp.linalg.norm(shown - pixels, axis=-1), jnp.inf)
    return found, jnp.linalg.norm(per_pixel), off.max()


def _refuse_narrow(names: Sequence[str], view: View, pixels: Float[Array, "picture 2 2"]) -> None:
    """Raise `InputError` where the lines of sight to an end are nearly one line, from one side or from both."""
    rays = np.asarray(pixel_rays(view.intrinsics, view.cam_from_world, pixels)[1], np.float64)
    sines = [np.linalg.norm(np.cross(one, other), axis=-1) for one, other in combinations(rays, 2)]
    widest = float(np.degrees(np.arcsin(np.clip(np.max(sines, axis=0), 0, 1))).min())
    if not widest >= NARROWEST:
        raise InputError(
            f"{_listed(names)} see the ends of --known-length along lines only {widest:.1f} degrees apart; mark it in "
            "pictures that were taken from directions 30 to 90 degrees apart."
        )


def _disagreement(names: Sequence[str], view: View, pixels: Float[Array, "picture 2 2"], off: float) -> str:
    """Say which marks do not agree: of more than two pictures the one without which the others agree best."""
    blamed = _listed(names)
    if len(names) > 2:
        others = [np.delete(np.arange(len(names)), one) for one in range(len(names))]
        rests = [_measured(pixels[kept], View(view.intrinsics[kept], view.cam_from_world[kept]))[2] for kept in others]
        blamed = f"{names[int(np.argmin(rests))]} and the others"
    found = f"one lies {off:.0f} pixels from where all together put it"
    found = found if np.isfinite(off) else "all together they put an end behind a camera"
    return (
        f"the marks of --known-length in {blamed} do not show the same two ends: {found}; mark the same end first in "
        "every picture, and look at the pixels."
    )


def _listed(names: Sequence[str]) -> str:
    return f"{', '.join(names[:-1])} and {names[-1]}"


def refuse_giant(length: MeasuredLength, extent: float) -> None:
    """Raise `InputError` where a silhouette would measure so many metres across as no person does."""
    if not TALL[0] <= extent <= TALL[1]:
        raise InputError(
            f"with a known length of {length.metres:g} m the person's silhouette is {extent:.2g} m across; look at the "
            "metres of --known-length and at the marks."
        )
