"""How far two silhouettes agree."""

import numpy as np
from jaxtyping import Bool, Float


def intersection_over_union(
    a: Bool[np.ndarray, "*view height width"], b: Bool[np.ndarray, "*view height width"], empty: float = np.nan
) -> Float[np.ndarray, "*view"]:
    """Divide the intersection of masks by their union, for each view; `empty` where neither mask has a pixel."""
    union = np.count_nonzero(a | b, axis=(-2, -1))
    both = np.count_nonzero(a & b, axis=(-2, -1))
    return np.where(union > 0, both / np.maximum(union, 1), empty)
