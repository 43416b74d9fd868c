"""The smallest cut of an image's grid graph, by SciPy's maximum flow."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

_STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))
_UNITS = 100.0  # whole numbers per nat: SciPy's flow is one of integers


class GridCut:
    """`min_x sum_i U_i(x_i) + sum_(i,j) [x_i != x_j] w_ij` over the 8-neighbourhood, for labels 0 and 1.

    `w_ij = (contrast exp(-|c_i - c_j|^2 / (2 s^2)) + constant) / distance`, s^2 the mean squared difference of
    neighbours. The graph of one image is built once; every call changes the unary terms only.
    """

    def __init__(self, image: Float[np.ndarray, "height width 3"], contrast: float = 10.0, constant: float = 1.0):
        height, width = image.shape[:2]
        self.shape = (height, width)
        number = np.arange(height * width).reshape(height, width)
        pairs, gaps, lengths = [], [], []
        for down, right in _STEPS:
            here = (slice(0, height - down), slice(max(-right, 0), width - max(right, 0)))
            there = (slice(down, height), slice(max(right, 0), width + min(right, 0)))
            pairs.append(np.stack([number[here].ravel(), number[there].ravel()]))
            gaps.append(((image[here] - image[there]) ** 2).sum(-1).ravel())
            lengths.append(np.full(gaps[-1].shape, np.hypot(down, right)))
        gap, length = np.concatenate(gaps), np.concatenate(lengths)
        a, b = np.concatenate(pairs, axis=1)
        weights = np.rint(_UNITS * (contrast * np.exp(-gap / max(2 * gap.mean(), 1e-12)) + constant) / length)
        source, sink = height * width, height * width + 1
        every = number.ravel()
        ends = np.full(len(every), source), np.full(len(every), sink)
        rows = np.concatenate([a, b, ends[0], every, every, ends[1]])
        columns = np.concatenate([b, a, every, ends[0], ends[1], every])
        order = np.lexsort((columns, rows))
        place = np.empty(len(order), np.int64)
        place[order] = np.arange(len(order))
        pointers = np.searchsorted(rows[order], np.arange(sink + 2))
        data = np.zeros(len(order), np.int32)
        data[place[: 2 * len(a)]] = np.tile(weights, 2)
        self._sink = sink
        self._graph = csr_matrix((data, columns[order].astype(np.int32), pointers.astype(np.int32)), (sink + 1,) * 2)
        first = 2 * len(a)
        self._from_source = place[first : first + len(every)]
        self._to_sink = place[first + 2 * len(every) : first + 3 * len(every)]

    def _set(self, if_one: np.ndarray, if_zero: np.ndarray) -> float:
        """Capacities of the terminals; what both labels cost in any case."""
        one, zero = (np.rint(_UNITS * np.clip(costs, -1e4, 1e4)).ravel() for costs in (if_one, if_zero))
        least = np.minimum(one, zero)
        self._graph.data[self._from_source] = zero - least
        self._graph.data[self._to_sink] = one - least
        return float(least.sum())

    def energy(self, if_one: Float[np.ndarray, "height width"], if_zero: Float[np.ndarray, "height width"]) -> float:
        """Compute the least energy, nats; `if_one` and `if_zero` are what each label costs."""
        sure = self._set(if_one, if_zero)
        sink = self._sink
        return (sure + float(maximum_flow(self._graph, sink - 1, sink).flow_value)) / _UNITS

    def labels(
        self, if_one: Float[np.ndarray, "height width"], if_zero: Float[np.ndarray, "height width"]
    ) -> Bool[np.ndarray, "height width"]:
        """Mark where the best labelling says 1: the side of the source, which pays `if_zero` where it is cut off."""
        self._set(if_one, if_zero)
        sink = self._sink
        left = self._graph - maximum_flow(self._graph, sink - 1, sink).flow
        left.eliminate_zeros()
        reached = breadth_first_order(left, sink - 1, return_predecessors=False)
        ones = np.zeros(sink + 1, bool)
        ones[reached] = True
        return ones[: sink - 1].reshape(self.shape)
