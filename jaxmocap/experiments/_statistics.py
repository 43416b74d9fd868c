"""Medians, spread and paired differences; never the best of many."""

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.stats import bootstrap

_SAMPLES = 10_000


def fewest_pairs(share: float = 0.95) -> int:
    """Return how many pairs it takes to say with this certainty where the median is: 6 for 95 %.

    The median lies between the least and the largest of n differences in all but 2^(1 - n) of cases.
    """
    return math.ceil(1 - math.log2(1 - share) - 1e-9)


class Summary(NamedTuple):
    """Of the errors of several runs, centimetres: how many are finite, their median, and the quartiles."""

    count: int
    median: float
    low: float
    high: float


class Difference(NamedTuple):
    """A paired comparison: the median of theirs minus ours, and its bootstrap interval, NaN of too few pairs."""

    pairs: int
    median: float
    low: float
    high: float

    @property
    def sure(self) -> bool:
        """Whether the interval excludes zero."""
        return self.low > 0 or self.high < 0


def summary(values: Iterable[float | None]) -> Summary:
    """Summarise errors by median and quartiles; NaN and None do not count."""
    known = np.array([value for value in values if value is not None and np.isfinite(value)], float)
    if not len(known):
        return Summary(0, float("nan"), float("nan"), float("nan"))
    return Summary(len(known), *(float(np.percentile(known, share)) for share in (50, 25, 75)))


def paired_difference(
    ours: Float[np.ndarray, "pair"], theirs: Float[np.ndarray, "pair"], share: float = 0.95, seed: int = 0
) -> Difference:
    """Take the median of `theirs - ours`, with the interval that holds this share of the medians of resampled pairs.

    The interval is that of the percentile bootstrap (Efron 1979), `scipy.stats.bootstrap`. Pairs in which one is not
    finite do not count. Fewer than `fewest_pairs` have no interval (NaN): that of resampled medians would hold the true
    one in half of all cases for two pairs, and in three of four for three.
    """
    both = np.isfinite(ours) & np.isfinite(theirs)
    gaps = (np.asarray(theirs, float) - np.asarray(ours, float))[both]
    if len(gaps) == 0:
        return Difference(0, float("nan"), float("nan"), float("nan"))
    if len(gaps) < fewest_pairs(share):
        return Difference(len(gaps), float(np.median(gaps)), float("nan"), float("nan"))
    found = bootstrap(
        (gaps,),
        np.median,
        n_resamples=_SAMPLES,
        confidence_level=share,
        method="percentile",
        rng=np.random.default_rng(seed),
    ).confidence_interval
    return Difference(len(gaps), float(np.median(gaps)), float(found.low), float(found.high))


def compare(ours: Sequence[dict[str, Any]], theirs: Sequence[dict[str, Any]], metric: str) -> Difference:
    """Take the `paired_difference` of two sets of rows, paired by capture and seed.

    Seeds of one capture are alike: where there are several captures, each counts once, with its median over the seeds.
    """
    values = [
        {(row["capture"], row["seed"]): row.get(metric) for row in rows if row["status"] == "done"}
        for rows in (ours, theirs)
    ]
    pairs = [
        (capture, mine, other)
        for (capture, seed), mine in values[0].items()
        if mine is not None and (other := values[1].get((capture, seed))) is not None
    ]
    captures = sorted({capture for capture, _, _ in pairs})
    if len(captures) > 1:
        gaps = [np.median([other - mine for name, mine, other in pairs if name == capture]) for capture in captures]
    else:
        gaps = [other - mine for _, mine, other in pairs]
    return paired_difference(np.zeros(len(gaps)), np.array(gaps, float))
