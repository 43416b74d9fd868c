"""The background model of a selected frame, and how far a later image is from it (psi_b)."""

from collections.abc import Sequence
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Integer, PRNGKeyArray, UInt8
from scipy.ndimage import distance_transform_edt
from scipy.spatial import KDTree

from jaxmocap._results import InputError

from ._background_grid import GridSettings, grid_ids, grid_triangles, grid_vertices
from ._colour_model import TAU, ColourModel, ColourSettings
from ._fit_colours import fit_colour_models
from ._warp import GridWarp


class BackgroundModel(eqx.Module):
    """Colour models of the grid's triangles in one selected frame; with leading axes, of every camera and frame.

    `source` is the triangle a model was learnt in: its own index, or that of the nearest triangle with enough pixels.
    """

    colours: ColourModel
    source: Int[Array, "*batch triangle"]

    def __getitem__(self, index: int | tuple[int, ...] | Int[np.ndarray, "..."]) -> "BackgroundModel":
        """Return the model at an index of the leading axes, `model[camera, selected]`."""
        return jax.tree.map(lambda leaf: leaf[index], self)


def fit_background(
    image: UInt8[np.ndarray, "height width 3"],
    person_mask: Bool[np.ndarray, "height width"] | None,
    *,
    key: PRNGKeyArray,
    grid: GridSettings | None = None,
    colour: ColourSettings | None = None,
) -> BackgroundModel:
    """Fit the background model of one camera at one selected frame (Sec. 3.2, Fig. 4).

    Pixels of the person mask, grown by `grid.mask_dilation`, are left out; `None`: nobody is in the image. A triangle
    with fewer than `grid.min_pixels` others copies the nearest triangle that has a model. Raises `InputError` if the
    mask leaves none.
    """
    grid = GridSettings() if grid is None else grid
    height, width = image.shape[:2]
    vertices = grid_vertices(height, width, grid.rows, grid.columns)
    triangles = grid_triangles(grid.rows, grid.columns)
    ids = grid_ids(vertices, height, width, grid)
    if person_mask is not None and np.any(person_mask):
        near = np.asarray(distance_transform_edt(np.asarray(person_mask) == 0)) <= grid.mask_dilation
        ids = np.where(near, -1, ids)
    counts = np.bincount(ids[ids >= 0], minlength=len(triangles))
    enough = counts >= grid.min_pixels
    if not enough.any():
        raise InputError(
            f"The person mask leaves no background: no triangle of the {grid.rows} x {grid.columns} grid keeps "
            f"{grid.min_pixels} pixels; check that the mask is white on the person only."
        )
    colours = fit_colour_models(
        ids, image, len(triangles), key=key, settings=colour, min_pixels=max(grid.min_pixels, 1)
    )
    centres = vertices[triangles].mean(axis=1)
    source = np.flatnonzero(enough)[KDTree(centres[enough]).query(centres)[1]]
    source[enough] = np.flatnonzero(enough)
    return BackgroundModel(colours, jnp.arange(len(triangles)))[source]


def background_distance(
    table: Float[np.ndarray, "triangle colour"],
    warp: GridWarp,
    labels: Integer[np.ndarray, "height width"],
    *,
    origin: tuple[int, int] = (0, 0),
    grid: GridSettings | None = None,
) -> Float[np.ndarray, "height width"]:
    """Compute psi_b of every pixel of a window: the distance of Eq. 3 to the warped triangle that covers it.

    `table` is the `psi_table` of the selected frame's model, `warp` takes its grid to this frame (`rest` settles
    fold-overs), `labels` are the palette's of the window and `origin` the (y, x) of its first pixel in the whole image.
    """
    ids = grid_ids(warp.vertices, labels.shape[0], labels.shape[1], grid, rest=warp.rest, origin=origin)
    looked_up = np.asarray(table)[np.maximum(ids, 0), labels].astype(np.float32)
    return np.where(ids >= 0, looked_up, np.float32(TAU))


def nearest_selected(
    frame: int, selected: Sequence[int], blend: Literal["nearest", "min"] = "nearest"
) -> tuple[int, ...]:
    """Find the positions in `selected` of the frames whose background model serves `frame` (t^ of Sec. 4.1).

    `"nearest"`: the one closest in time, the earlier one on a tie. `"min"`: the last one before and the first one
    after, of which the smaller psi_b is taken, so that nothing jumps midway.
    """
    if len(selected) == 0:
        raise InputError("No frame is selected; name at least one in selected_frames.")
    order = sorted(range(len(selected)), key=lambda n: (abs(selected[n] - frame), selected[n]))
    if blend == "nearest" or selected[order[0]] == frame:
        return (order[0],)
    before = [n for n in order if selected[n] < frame]
    after = [n for n in order if selected[n] > frame]
    return tuple(side[0] for side in (before, after) if side)
