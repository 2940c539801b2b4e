"""95 % intervals: of a mean by a bootstrap that resamples clusters, of a rate by Wilson's formula.

Queries about one assembly are not independent, for they share its kits and its view; nor are those about one part,
which may come back in the scene of another assembly. So whole clusters are drawn, with replacement, and a mean is the
ratio of two sums, of values and of their counts. Where neither clustering contains the other, both are resampled, and
their deviations are added and scaled to the variance of two-way clustering: that by one plus that by the other less
that by both (Cameron, Gelbach and Miller 2011, eq. 2.8). All draws come from one seed: equal input gives equal
intervals, for every method and metric.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from kit1000.errors import InputError, checked
from kit1000.rng import stream

DRAWS = 2000  # moves an end of an interval by some 1.5 % of the width from seed to seed
SEED = 2026
TAIL = 0.025  # of the draws lies beyond each end of an interval
ENDS = (TAIL, 1 - TAIL)
Z = 1.959963984540054  # beyond it lies TAIL of the standard normal distribution
AT_ONCE = 1 << 16  # clusters drawn in one step: half a megabyte, stays in the cache


def bootstrap_means(
    columns: ArrayLike, clusterings: Sequence[ArrayLike], draws: int = DRAWS, seed: int = SEED
) -> np.ndarray:
    """(draws, m): the means of m columns of values in each resample of the clusters, the same for all columns.

    Where all values are in one cluster, every mean is the same: the spread between clusters is unknown.

    Args:
        columns: (n, m) finite, n >= 1, in any unit.
        clusterings: one or two, each (n,) labels, integers (the fastest) or text; values of equal labels are drawn
            together.
        draws: number of resamples.
        seed: of all resamples.
    """
    columns = checked("values", columns, ("n", "m"))
    if not len(columns):
        raise InputError("values: none, and a mean needs at least one")
    if draws < 1:
        raise InputError(f"draws: expected at least 1, got {draws}")
    coarsest = _coarsest(_numbered(clusterings, len(columns)))
    rng = stream(seed, "bootstrap")
    resampled = [_resampled_means(columns, labels, draws, rng) for labels in coarsest]
    if len(resampled) == 1:
        return resampled[0]
    scales = np.array([_two_way_scale(column, *coarsest) for column in columns.T])
    means = columns.mean(axis=0)
    return means + scales * (resampled[0] - means + resampled[1] - means)


def rate_interval(passed: ArrayLike, clusterings: Sequence[ArrayLike]) -> tuple[float, float]:
    """Wilson's 95 % interval (lo, hi) of the share of True in (n,) bool, with as many trials as its clusters amount to.

    The trials are n over the design effect (Kish 1965), the variance of the share with clusters over that without, but
    at least 1. Where all values are equal no effect shows: then there are as many trials as clusters, of the clustering
    with fewer.
    """
    column = np.asarray(passed, np.float64)
    if not len(column):
        return wilson_interval(0.0, 0)
    numbered = _numbered(clusterings, len(column))
    fewest = min(int(labels.max()) + 1 for labels in numbered)
    alone = _variance(column, np.arange(len(column)))
    if fewest == 1 or alone == 0:
        return wilson_interval(float(column.mean()), fewest)
    effect = _clustered_variance(column, _coarsest(numbered)) / alone
    return wilson_interval(float(column.mean()), len(column) / max(effect, 1.0))


def wilson_interval(share: float, n: float) -> tuple[float, float]:
    """Wilson's 95 % interval (lo, hi) of a rate, from the share of successes in n trials; all of (0, 1) after none."""
    if not (0 <= share <= 1 and n >= 0):
        raise InputError(f"a rate: expected a share of 0 to 1 in 0 trials or more, got {share:g} in {n:g}")
    if n == 0:
        return 0.0, 1.0
    zz = Z * Z
    centre = (share + zz / (2 * n)) / (1 + zz / n)
    half = Z / (1 + zz / n) * np.sqrt(share * (1 - share) / n + zz / (4 * n * n))
    lo = 0.0 if share == 0 else float(centre - half)  # exact at the ends, where rounding leaves 1e-17
    hi = 1.0 if share == 1 else float(centre + half)
    return lo, hi


def _numbered(clusterings: Sequence[ArrayLike], n: int) -> list[np.ndarray]:
    """Each clustering as numbers (n,) from 0 without gaps."""
    labelled = [np.asarray(labels) for labels in clusterings]
    if not 1 <= len(labelled) <= 2 or any(labels.shape != (n,) for labels in labelled):
        shapes = ", ".join(str(labels.shape) for labels in labelled) or "none"
        raise InputError(f"clusters: expected one or two labels for each of {n} values, got shape {shapes}")
    return [np.unique(labels, return_inverse=True)[1] for labels in labelled]


def _coarsest(clusterings: list[np.ndarray]) -> list[np.ndarray]:
    """The clusterings without one whose every cluster lies within a cluster of the other."""
    if len(clusterings) == 1:
        return clusterings
    first, second = clusterings
    both = len(np.unique(np.stack([first, second], axis=1), axis=0))
    if both == first.max() + 1:
        return [second]
    return [first] if both == second.max() + 1 else [first, second]


def _variance(column: np.ndarray, labels: np.ndarray) -> float:
    """Variance of the mean of a column (n,) of independent clusters: the sum of squares of their summed deviations."""
    sums = np.bincount(labels, weights=column - column.mean())
    return float((sums * sums).sum()) / len(column) ** 2


def _clustered_variance(column: np.ndarray, clusterings: list[np.ndarray]) -> float:
    """Variance of the mean of a column (n,), with one clustering or two."""
    variances = [_variance(column, labels) for labels in clusterings]
    if len(clusterings) == 1:
        return variances[0]
    first, second = clusterings
    _, both = np.unique(first * (second.max() + 1) + second, return_inverse=True)
    return max(sum(variances) - _variance(column, both), *variances)


def _two_way_scale(column: np.ndarray, first: np.ndarray, second: np.ndarray) -> float:
    """Factor on the added deviations of both resamples that gives them the two-way variance."""
    added = _variance(column, first) + _variance(column, second)
    return float(np.sqrt(_clustered_variance(column, [first, second]) / added)) if added else 1.0


def _resampled_means(columns: np.ndarray, cluster: np.ndarray, draws: int, rng: np.random.Generator) -> np.ndarray:
    """(draws, m): the means of columns (n, m) in resamples of numbered clusters (n,)."""
    counts = np.bincount(cluster).astype(np.float64)
    sums = [np.bincount(cluster, weights=column) for column in columns.T]
    return _resampled_ratios(sums, counts, draws, rng)


def _resampled_ratios(sums: list[np.ndarray], counts: np.ndarray, draws: int, rng: np.random.Generator) -> np.ndarray:
    """(draws, m): sum over count of clusters drawn with replacement, in steps of bounded memory.

    Args:
        sums: m arrays (k,), of the values in each cluster.
        counts: (k,) values in each cluster.
        draws: number of resamples.
        rng: gives all draws, the same for any step size.
    """
    clusters = len(counts)
    even = float(counts[0]) * clusters if (counts == counts[0]).all() else None  # then each resample is as large
    ratios = np.empty((draws, len(sums)))
    step = max(1, AT_ONCE // clusters)
    for first in range(0, draws, step):
        rows = ratios[first : first + step]
        drawn = rng.integers(clusters, size=(len(rows), clusters), dtype=np.int32)
        size = even if even is not None else counts.take(drawn).sum(axis=1)
        for column, of_cluster in enumerate(sums):
            rows[:, column] = of_cluster.take(drawn).sum(axis=1) / size
    return ratios
