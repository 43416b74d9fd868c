"""K-means per element: from labelled pixels to a `ColourModel`."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray, UInt8

from ._colour_model import ColourModel, ColourSettings

BUCKETS = (128, 1024)
"""Pixels per element are padded to one of these counts; above the last, every n-th pixel is used. A call takes 9 and
71 ms, and its program a second and a half to compile."""
CHUNK = 256
"""Elements per compiled call: their number is padded to a multiple, so two programs serve every capture."""


def _labels(pixels: Float[Array, "3 pixel"], means: Float[Array, "cluster 3"], alive: Array) -> tuple[Array, Array]:
    """Nearest living mean per pixel, and its squared distance."""
    label = jnp.zeros(pixels.shape[1], jnp.int32)
    nearest = jnp.full(pixels.shape[1], jnp.inf)
    for k in range(means.shape[0]):
        squared = jnp.where(alive[k], jnp.sum((pixels - means[k][:, None]) ** 2, axis=0), jnp.inf)
        label = jnp.where(squared < nearest, k, label)
        nearest = jnp.minimum(nearest, squared)
    return label, nearest


def _members(label: Int[Array, " pixel"], mask: Float[Array, " pixel"], clusters: int) -> Float[Array, "cluster pixel"]:
    return jnp.where(label == jnp.arange(clusters)[:, None], mask, 0.0)


def _seed(pixels: Array, mask: Array, clusters: int, key: PRNGKeyArray) -> Array:
    """k-means++: every further mean is a pixel drawn with probability proportional to its squared distance."""
    draws, last = jax.random.uniform(key, (clusters,)), jnp.sum(mask > 0).astype(jnp.int32) - 1

    def add(k: Array, found: tuple[Array, Array]) -> tuple[Array, Array]:
        nearest, means = found
        cumulative = jnp.cumsum(nearest)
        chosen = jnp.sum(cumulative <= draws[k] * cumulative[-1])
        mean = pixels[:, jnp.minimum(chosen, last)]
        squared = jnp.sum((pixels - mean[:, None]) ** 2, axis=0) * mask
        return jnp.where(k == 0, squared, jnp.minimum(nearest, squared)), means.at[k].set(mean)

    start = (jnp.where(mask > 0, 1.0, 0.0), jnp.zeros((clusters, pixels.shape[0])))
    return jax.lax.fori_loop(0, clusters, add, start)[1]


def _cluster_one(pixels: Array, count: Array, seed: Array, key: PRNGKeyArray, settings: ColourSettings) -> Any:
    """Clusters of one element: means, covariances, weights and their number. Pixels beyond `count` are padding."""
    clusters = settings.clusters
    mask = (jnp.arange(pixels.shape[1]) < count).astype(jnp.float32)
    wanted = jnp.clip(count // settings.min_cluster, 1, clusters)
    alive = jnp.arange(clusters) < wanted
    extended = jnp.concatenate([pixels, jnp.ones_like(pixels[:1])])

    def lloyd(_: Any, means: Array) -> Array:
        members = _members(_labels(pixels, means, alive)[0], mask, clusters)
        sums = jnp.matmul(members, extended.T, precision="highest")
        return jnp.where(sums[:, 3:] > 0, sums[:, :3] / jnp.maximum(sums[:, 3:], 1.0), means)

    def attempt(attempt_key: PRNGKeyArray) -> tuple[Array, Array]:
        means = _seed(pixels, mask, clusters, attempt_key)
        means = jax.lax.fori_loop(0, settings.iterations, lloyd, means)
        return means, jnp.sum(_labels(pixels, means, alive)[1] * mask)

    means, inertia = jax.vmap(attempt)(jax.random.split(jax.random.fold_in(key, seed), settings.restarts))
    means = means[jnp.argmin(inertia)]

    # A cluster below min_cluster pixels gives them to its neighbours; the largest one always stays.
    sizes = jnp.sum(_members(_labels(pixels, means, alive)[0], mask, clusters), axis=1)
    alive = alive & ((sizes >= settings.min_cluster) | (jnp.arange(clusters) == jnp.argmax(sizes)))
    members = _members(_labels(pixels, means, alive)[0], mask, clusters)
    sizes = jnp.sum(members, axis=1)
    divisor = jnp.maximum(sizes, 1.0)[:, None]
    means = jnp.matmul(members, pixels.T, precision="highest") / divisor
    centred = pixels[None] - means[:, :, None]
    r, g, b = centred[:, 0], centred[:, 1], centred[:, 2]
    products = jnp.stack([r * r, r * g, r * b, g * g, g * b, b * b], axis=1)
    covariances = jnp.sum(products * members[:, None, :], axis=2) / divisor
    order = jnp.argsort(-sizes, stable=True)
    weights = sizes / jnp.maximum(jnp.sum(sizes), 1.0)
    return means[order], covariances[order], weights[order], jnp.sum(sizes > 0)


@eqx.filter_jit
def _cluster_chunk(pixels: Any, counts: Any, seeds: Any, key: PRNGKeyArray, settings: ColourSettings) -> Any:
    one = lambda row: _cluster_one(row[0], row[1], row[2], key, settings)  # noqa: E731
    return jax.lax.map(one, (pixels, counts, seeds), batch_size=32)


def _padded(colours: np.ndarray, start: int, count: int, size: int) -> np.ndarray:
    """`size` pixels of one element: all of them and padding, or evenly spread ones if there are more."""
    rows = np.arange(size) if count <= size else np.arange(size) * count // size
    return colours[start + np.minimum(rows, max(count - 1, 0))]


def fit_colour_models(
    element_ids: Int[Array | np.ndarray, "..."],
    colours: Float[Array | np.ndarray, "... 3"] | UInt8[np.ndarray, "... 3"],
    num_elements: int,
    *,
    key: PRNGKeyArray,
    settings: ColourSettings | None = None,
    min_pixels: int = 1,
) -> ColourModel:
    """Fit the colour model of every element to its pixels: K-means, then one Gaussian per cluster (Sec. 3.2).

    `element_ids` (negative: ignored) and `colours` (RGB in [0, 1], or uint8) list the pixels in any order. Elements
    with fewer than `min_pixels` get no model. k-means++ seeding, `settings.restarts` starts, fixed seed per element:
    the same pixels in the same order and the same key give the same bits. An element uses at most 1,024 of its pixels,
    evenly spread. Runs on the host around two compiled programs; returns the models of `num_elements` elements.
    """
    settings = ColourSettings() if settings is None else settings
    ids = np.asarray(element_ids).reshape(-1)
    rgb = np.asarray(colours)
    rgb = rgb.reshape(-1, 3).astype(np.float32) / (255 if rgb.dtype == np.uint8 else 1)
    rgb = rgb[ids >= 0]
    ids = ids[ids >= 0]
    order = np.argsort(ids, kind="stable")
    rgb = rgb[order]
    counts = np.bincount(ids, minlength=num_elements)
    starts = np.cumsum(counts) - counts

    clusters = settings.clusters
    means = np.zeros((num_elements, clusters, 3), np.float32)
    covariances = np.zeros((num_elements, clusters, 6), np.float32)
    weights = np.zeros((num_elements, clusters), np.float32)
    cluster_count = np.zeros(num_elements, np.int32)
    valid = counts >= max(min_pixels, 1)
    for lower, size in zip((0, *BUCKETS[:-1]), BUCKETS, strict=True):
        upper = np.inf if size == BUCKETS[-1] else size
        chosen = np.flatnonzero(valid & (counts > lower) & (counts <= upper))
        for begin in range(0, len(chosen), CHUNK):
            rows = chosen[begin : begin + CHUNK]
            pixels = np.zeros((CHUNK, 3, size), np.float32)
            used = np.zeros(CHUNK, np.int32)
            seeds = np.zeros(CHUNK, np.int32)
            for i, row in enumerate(rows):
                pixels[i] = _padded(rgb, int(starts[row]), int(counts[row]), size).T
            used[: len(rows)] = np.minimum(counts[rows], size)
            seeds[: len(rows)] = rows
            result = _cluster_chunk(pixels, used, seeds, key, settings)
            for target, source in zip((means, covariances, weights, cluster_count), result, strict=True):
                target[rows] = np.asarray(source)[: len(rows)]
    return ColourModel(
        jnp.asarray(means),
        jnp.asarray(covariances),
        jnp.asarray(weights),
        jnp.asarray(valid),
        jnp.asarray(cluster_count),
    )
