"""The Appearance record: what the person and the surroundings look like to every camera."""

from collections.abc import Sequence
from typing import Any, Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray, UInt8

from jaxmocap._results import InputError
from jaxmocap._types import Quality

from ._background import BackgroundModel, fit_background, nearest_selected
from ._background_grid import GridSettings
from ._colour_model import ColourSettings
from ._foreground import ForegroundModel, ForegroundSettings, fit_foreground
from ._palette import Palette, fit_palette, psi_table
from ._plate import PlateSettings
from ._warp import WarpSettings


class AppearanceSettings(eqx.Module):
    """All settings of the appearance stage. `AppearanceSettings()` is the paper.

    Attributes:
        colour: how pixels become Gaussians and Gaussians a distance.
        grid: the background grid.
        warp: how it is warped from a selected frame to another.
        foreground: which pixels teach a triangle its colours.
        plate: the clean plate.
        behind: what psi_b compares a pixel with: "grid", the colour models of the warped grid (the paper); "plate", the
            picture of the background that the selected frames and the frames tracked so far have shown, and the grid
            where none has; "none" takes every pixel for foreign (psi_b = tau), which leaves the background out of Eq. 6
            as in Fig. 11: contours then look for Canny edges, and `uncovered_scale` must not exceed 1.
        palette_size: colours of the psi tables.
    """

    colour: ColourSettings = eqx.field(default_factory=ColourSettings)
    grid: GridSettings = eqx.field(default_factory=GridSettings)
    warp: WarpSettings = eqx.field(default_factory=WarpSettings)
    foreground: ForegroundSettings = eqx.field(default_factory=ForegroundSettings)
    plate: PlateSettings = eqx.field(default_factory=PlateSettings)
    behind: Literal["grid", "plate", "none"] = eqx.field(static=True, default="grid")
    palette_size: int = eqx.field(static=True, default=1024)


class Appearance(eqx.Module):
    """Appearance models of a capture (Sec. 3.2).

    `background` has leading axes (camera, selected frame). `sizes` are (width, height) per camera as in `Cameras`,
    `selected_frames` is Gamma of the paper.
    """

    foreground: ForegroundModel
    background: BackgroundModel
    palette: Palette
    settings: AppearanceSettings
    selected_frames: tuple[int, ...] = eqx.field(static=True)
    sizes: tuple[tuple[int, int], ...] = eqx.field(static=True)

    def selected_for(self, frame: int) -> tuple[int, ...]:
        """Find the positions in `selected_frames` of the background models that serve a frame."""
        return nearest_selected(frame, self.selected_frames, self.settings.grid.blend)

    def foreground_table(self, camera: int, dtype: Any = jnp.float16) -> Float[Array, "face colour"]:
        """Return psi_f of every triangle at every palette colour, for one camera."""
        return psi_table(self.foreground.camera(camera), self.palette, self.settings.colour, dtype)

    def background_table(self, camera: int, selected: int, dtype: Any = jnp.float16) -> Float[Array, "triangle colour"]:
        """Return psi_b of every grid triangle at every palette colour, for one camera and selected frame."""
        return psi_table(self.background[camera, selected].colours, self.palette, self.settings.colour, dtype)


def fit_appearance(
    ids: Sequence[Sequence[Int[np.ndarray, "height width"]]],
    images: Sequence[Sequence[UInt8[np.ndarray, "height width 3"]]],
    facing: Sequence[Sequence[Float[np.ndarray, "..."]]],
    faces: Int[np.ndarray, "face 3"],
    selected_frames: Sequence[int],
    *,
    key: PRNGKeyArray,
    masks: Sequence[Sequence[Bool[np.ndarray, "height width"] | None]] | None = None,
    settings: AppearanceSettings | None = None,
) -> Appearance:
    """Learn all appearance models from the selected frames (Sec. 3.2).

    `ids[n][m]`, `images[n][m]`, `facing[n][m]` and `masks[n][m]` are those of camera m in the n-th selected frame, each
    of the whole image: rendered triangle per pixel, image, cosine of normal and view direction (per face or pixel) and
    person mask. Without a mask the rendered silhouette takes its place.
    """
    settings = AppearanceSettings() if settings is None else settings
    num_cameras = len(ids[0])
    foreground_key, background_key = jax.random.split(key)
    foreground = fit_foreground(
        ids,
        images,
        facing,
        faces,
        key=foreground_key,
        silhouettes=masks,
        settings=settings.foreground,
        colour=settings.colour,
    )
    person = [
        [_person(ids[n][m], None if masks is None else masks[n][m]) for m in range(num_cameras)]
        for n in range(len(selected_frames))
    ]
    backgrounds = [
        [
            fit_background(
                images[n][m],
                person[n][m],
                key=jax.random.fold_in(background_key, m * len(selected_frames) + n),
                grid=settings.grid,
                colour=settings.colour,
            )
            for n in range(len(selected_frames))
        ]
        for m in range(num_cameras)
    ]
    stack = lambda *leaves: jnp.stack(leaves)  # noqa: E731
    background = jax.tree.map(stack, *[jax.tree.map(stack, *camera) for camera in backgrounds])
    pixels = [_palette_pixels(images[n][m], person[n][m]) for n in range(len(images)) for m in range(num_cameras)]
    return Appearance(
        foreground,
        background,
        fit_palette(np.concatenate(pixels), settings.palette_size),
        settings,
        tuple(int(frame) for frame in selected_frames),
        tuple((image.shape[1], image.shape[0]) for image in images[0]),
    )


def _person(ids: np.ndarray, mask: np.ndarray | None) -> Bool[np.ndarray, "height width"]:
    return np.asarray(ids) >= 0 if mask is None else np.asarray(mask) != 0


def _palette_pixels(image: np.ndarray, person: np.ndarray) -> UInt8[np.ndarray, "pixel 3"]:
    """Sample an image such that the person has as many pixels as the background."""
    sides = [image[side] for side in (person, ~person) if side.any()]
    return np.concatenate([side[np.arange(10_000) * len(side) // 10_000] for side in sides])


def appearance_preset(quality: Quality) -> AppearanceSettings:
    """Choose the appearance settings that go with a preset.

    "paper" leaves triangles that were never seen without a model, and knows the background by the grid's colour models
    only. Raises `InputError` for another name.
    """
    if quality not in get_args(Quality):
        raise InputError(f"quality '{quality}' is unknown; choose {', '.join(get_args(Quality))}.")
    if quality == "paper":
        return AppearanceSettings()
    return AppearanceSettings(foreground=ForegroundSettings(unseen="nearest"), behind="plate")
