"""Colour models of surface and background elements, and the model distance psi (Eq. 3)."""

from typing import Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxmocap._results import InputError
from jaxmocap._types import Knob, knob

TAU = 1.0
"""The barrier of Eq. 3 for colours in [0, 1], and the distance of an element without a model."""

FAR = 1e6
"""Distance of a cluster that does not exist: beyond every barrier."""


class ColourSettings(eqx.Module):
    """How pixels become Gaussians and Gaussians become a distance (Eq. 3).

    We depart from the printed equation. With tau = 1 a plain Mahalanobis distance puts 80 % of a Gaussian's own pixels
    at the barrier, so covariances get a floor, `S + s0**2 I`, and the squared distance is divided by `kappa`. The
    literal reading is `ColourSettings(s0=0.15, kappa=1)` (a floor, nothing else) or `ColourSettings(s0=0.001, kappa=1)`
    (as printed). Use the same settings for foreground and background, or the ratio of Eq. 6 is biased.

    Attributes:
        s0: standard deviation of the covariance floor, colours in [0, 1].
        kappa: divisor of the squared distance.
        covariance: "full", "diag" (no correlation between channels) or "iso" (their mean variance).
        metric: "mahalanobis", or "euclidean": min over the cluster means of |c - mu|, no covariance, no kappa.
        weights: "off" as printed, or "neglog": add -2 log of the cluster's share of pixels to the squared distance.
        clusters: K of the paper.
        restarts: of k-means.
        iterations: of k-means.
        min_cluster: pixels a cluster needs; an element of n pixels gets min(K, max(1, n // min_cluster)) clusters.
    """

    s0: Knob = knob(0.05)
    kappa: Knob = knob(9.0)
    covariance: Literal["full", "diag", "iso"] = eqx.field(static=True, default="full")
    metric: Literal["mahalanobis", "euclidean"] = eqx.field(static=True, default="mahalanobis")
    weights: Literal["off", "neglog"] = eqx.field(static=True, default="off")
    clusters: int = eqx.field(static=True, default=5)
    restarts: int = eqx.field(static=True, default=2)
    iterations: int = eqx.field(static=True, default=20)
    min_cluster: int = eqx.field(static=True, default=8)


class ColourModel(eqx.Module):
    """The clusters of every element (triangle of the mesh or of the background grid), without floor or barrier.

    Plain statistics are stored, so `s0`, `kappa`, `tau` and the kind of covariance can be swept without fitting again.
    Any leading axes (camera, selected frame) may come before `element`.

    - `means`: RGB in [0, 1].
    - `covariances`: the upper triangle rr, rg, rb, gg, gb, bb, of the pixels about the mean.
    - `weights`: the cluster's share of the element's pixels; 0 beyond `cluster_count`.
    - `valid`: whether the element has a model at all.
    - `cluster_count`: clusters in use, which come first, largest first.
    """

    means: Float[Array, "*batch element cluster 3"]
    covariances: Float[Array, "*batch element cluster 6"]
    weights: Float[Array, "*batch element cluster"]
    valid: Bool[Array, "*batch element"]
    cluster_count: Int[Array, "*batch element"]

    def mean_colours(self) -> Float[Array, "*batch element 3"]:
        """Average the RGB of each element's pixels; zero where it has no model."""
        return jnp.sum(self.means * self.weights[..., None], axis=-2)


def whitening(
    model: ColourModel, settings: ColourSettings
) -> tuple[Float[Array, "*batch element cluster 6"], Float[Array, "*batch element cluster"]]:
    """Compute W and an offset per cluster: |W (c - mu)|^2 + offset is the distance of Eq. 3 before the barrier.

    W is lower triangular, stored as its rows (w00, w10, w11, w20, w21, w22): the inverse Cholesky factor of the floored
    covariance over sqrt(kappa). The offset is `FAR` for clusters that do not exist. Under the Euclidean metric W is the
    identity and the caller takes the root.
    """
    exists = jnp.arange(model.means.shape[-2]) < model.cluster_count[..., None]
    exists = exists & model.valid[..., None]
    offset = jnp.where(exists, 0.0, FAR)
    if settings.weights == "neglog":
        offset = offset - 2 * jnp.log(jnp.where(exists, model.weights, 1.0)) / settings.kappa
    rr, rg, rb, gg, gb, bb = jnp.moveaxis(model.covariances, -1, 0)
    zero = jnp.zeros_like(rr)
    if settings.metric == "euclidean":
        one = jnp.ones_like(rr)
        return jnp.stack([one, zero, one, zero, zero, one], axis=-1), offset
    if settings.covariance != "full":
        rg, rb, gb = zero, zero, zero
    if settings.covariance == "iso":
        rr = gg = bb = (rr + gg + bb) / 3
    floor = settings.s0**2
    scale = 1 / jnp.sqrt(settings.kappa)
    l00 = jnp.sqrt(rr + floor)
    l10, l20 = rg / l00, rb / l00
    l11 = jnp.sqrt(jnp.maximum(gg + floor - l10**2, floor))
    l21 = (gb - l20 * l10) / l11
    l22 = jnp.sqrt(jnp.maximum(bb + floor - l20**2 - l21**2, floor))
    w00, w11, w22 = scale / l00, scale / l11, scale / l22
    w10 = -l10 / l11 * w00
    w21 = -l21 / l22 * w11
    w20 = -(l20 * w00 + l21 * w10) / l22
    return jnp.stack([w00, w10, w11, w20, w21, w22], axis=-1), offset


def distance(
    difference: Float[Array, "*#shape 3"],
    whiten: Float[Array, "*#shape 6"],
    offset: Float[Array, "*#shape"],
    settings: ColourSettings,
) -> Float[Array, "*shape"]:
    """Compute the distance to one cluster before the barrier, from c - mu and `whitening`."""
    r, g, b = difference[..., 0], difference[..., 1], difference[..., 2]
    w00, w10, w11, w20, w21, w22 = (whiten[..., i] for i in range(6))
    squared = (w00 * r) ** 2 + (w10 * r + w11 * g) ** 2 + (w20 * r + w21 * g + w22 * b) ** 2
    if settings.metric == "euclidean":
        positive = squared > 0
        squared = jnp.where(positive, jnp.sqrt(jnp.where(positive, squared, 1.0)), 0.0)
    return squared + offset


def psi(
    model: ColourModel,
    element_ids: Int[Array | np.ndarray, "*pixels"],
    colours: Float[Array | np.ndarray, "*pixels 3"],
    settings: ColourSettings | None = None,
) -> Float[Array, "*pixels"]:
    """Compute psi, the model distance of Eq. 3 with our floor.

    psi = min(min_k (c - mu_k)^T (S_k + s0^2 I)^-1 (c - mu_k) / kappa, tau).

    `element_ids` choose the element per pixel, colours are RGB in [0, 1]. The result is tau for a negative id and for
    an element without a model. Exact and differentiable; for whole images `psi_table` is faster. Raises `InputError`
    for colours of 8 bits.
    """
    if not jnp.issubdtype(colours.dtype, jnp.floating):
        raise InputError(f"colours have the type {colours.dtype}; RGB in [0, 1] was expected: divide 8 bits by 255.")
    settings = ColourSettings() if settings is None else settings
    whiten, offset = whitening(model, settings)
    known = jnp.asarray(element_ids) >= 0
    rows = jnp.where(known, element_ids, 0)
    difference = jnp.asarray(colours)[..., None, :] - model.means[rows]
    per_cluster = distance(difference, whiten[rows], offset[rows], settings)
    nearest = jnp.minimum(jnp.min(per_cluster, axis=-1), TAU)
    return jnp.where(known, nearest, TAU)
