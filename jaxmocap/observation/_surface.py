"""What is known of the character's surface: how far every face is from every colour, and which faces are neighbours."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt32

from jaxmocap._cache import cached_jit
from jaxmocap.appearance import TAU, Appearance, ColourSettings, ForegroundModel, distance, whitening
from jaxmocap.character import Character
from jaxmocap.geometry import faces_within, pack_rows

GEODESIC_STEPS = 5
"""Eq. 7: partners at most five triangles apart correspond."""


class Clusters(eqx.Module):
    """The colour models behind `Surface.colour_distance`, for looking at single pixels without a palette: the means of
    their Gaussians, `whitening` and offset of Eq. 3."""

    means: Float[Array, "camera face cluster 3"]
    whiten: Float[Array, "camera face cluster 6"]
    offset: Float[Array, "camera face cluster"]
    settings: ColourSettings

    def distance(self, camera: Int[Array, "*#n"], face: Int[Array, "*#n"], colour: Float[Array, "*#n 3"]) -> Array:
        """Compute psi_f of Eq. 3, exactly."""
        gap = colour[..., None, :] - self.means[camera, face]
        each = distance(gap, self.whiten[camera, face], self.offset[camera, face], self.settings)
        return jnp.minimum(each.min(-1), TAU)


class Surface(eqx.Module):
    """What is known of the character's surface, the same for all frames.

    `colour_distance (camera, face, colour)`: psi_f of Eq. 3 for every palette colour, tau where a face has no model.
    `near_faces (face, word)`: bit table of faces at most five edge steps apart (Eq. 7). `mean_colour` is the mean RGB
    of a face's model, meaningful where `has_colour`. `clusters` is None for a mesh without models of its own.
    """

    colour_distance: Float[Array, "camera face colour"]
    near_faces: UInt32[Array, "face word"]
    mean_colour: Float[Array, "camera face 3"]
    has_colour: Bool[Array, "camera face"]
    clusters: Clusters | None = None


def surface_of(character: Character, appearance: Appearance | None, num_cameras: int) -> Surface:
    """Make the character's tables for scoring.

    Without an appearance (registration) every face is at distance tau.
    """
    faces = np.asarray(character.faces)
    near = jax.device_put(pack_rows(faces_within(faces, GEODESIC_STEPS)))
    if appearance is None:
        return Surface(
            jnp.ones((num_cameras, len(faces), 1), jnp.float16),
            near,
            jnp.zeros((num_cameras, len(faces), 3)),
            jnp.zeros((num_cameras, len(faces)), bool),
        )
    tables = jnp.stack([appearance.foreground_table(camera) for camera in range(num_cameras)])
    mean_colours, known, clusters = _clusters(appearance.foreground, appearance.settings.colour)
    return Surface(tables, near, mean_colours, known, clusters)


@cached_jit
def _clusters(
    foreground: ForegroundModel, colour: ColourSettings
) -> tuple[Float[Array, "camera face 3"], Bool[Array, "camera face"], Clusters]:
    clusters = Clusters(foreground.colours.means, *whitening(foreground.colours, colour), colour)
    return foreground.mean_colours(), foreground.source > 0, clusters


def simplified_surface(
    surface: Surface, faces: Int[np.ndarray, "simple 3"], nearest: Int[np.ndarray, "face"]
) -> Surface:
    """Make the tables of a simplified mesh (`character.simplify`).

    A face is as near to a colour as the nearest of the faces it stands for, and geodesic steps are longer.
    """
    count, order = len(faces), np.argsort(nearest, kind="stable")
    present, first = np.unique(nearest[order], return_index=True)
    tables, mean_colour = np.asarray(surface.colour_distance), np.asarray(surface.mean_colour)
    known_faces = np.asarray(surface.has_colour)
    merged = np.ones((tables.shape[0], count, tables.shape[2]), tables.dtype)
    colours, known = np.zeros((tables.shape[0], count, 3), np.float32), np.zeros((tables.shape[0], count), bool)
    for camera in range(len(tables)):
        merged[camera, present] = np.minimum.reduceat(tables[camera][order], first, axis=0)
        has = known_faces[camera]
        weights = np.bincount(nearest, has, minlength=count)
        known[camera] = weights > 0
        for channel in range(3):
            total = np.bincount(nearest, np.where(has, mean_colour[camera, :, channel], 0.0), minlength=count)
            colours[camera, :, channel] = total / np.maximum(weights, 1)
    steps = max(1, round(GEODESIC_STEPS * np.sqrt(count / len(nearest))))
    near = jax.device_put(pack_rows(faces_within(faces, steps)))
    return Surface(jax.device_put(merged), near, jax.device_put(colours), jax.device_put(known))


def filled_surface(surface: Surface, num_faces: int) -> Surface:
    """Make the tables of a mesh that is filled up to so many faces (`character.filled_up`): they are never seen."""
    more = num_faces - surface.near_faces.shape[0]
    words = -(-num_faces // 32) - surface.near_faces.shape[1]

    def filled(values: Array, fill: float = 0) -> Array:
        return jnp.pad(values, ((0, 0), (0, more), *[(0, 0)] * (values.ndim - 2)), constant_values=fill)

    clusters = surface.clusters
    if clusters is not None:
        means, whiten, offset = map(filled, (clusters.means, clusters.whiten, clusters.offset))
        clusters = Clusters(means, whiten, offset, clusters.settings)
    return Surface(
        filled(surface.colour_distance, 1.0),
        jnp.pad(surface.near_faces, ((0, more), (0, words))),
        filled(surface.mean_colour),
        filled(surface.has_colour),
        clusters,
    )
