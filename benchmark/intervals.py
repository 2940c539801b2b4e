"""95 % intervals: of a mean by a bootstrap that resamples clusters, of a rate by Wilson's formula.

Queries about one assembly are not independent: they share its kits and its view. So whole assemblies are drawn, with
replacement, and a mean is the ratio of two sums, of values and of their counts. All draws come from one seed: equal
input gives equal intervals, for every method and metric.
"""

from __future__ import annotations

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


def bootstrap_means(columns: ArrayLike, clusters: ArrayLike, draws: int = DRAWS, seed: int = SEED) -> np.ndarray:
    """(draws, m): the means of m columns of values in each resample of the clusters, the same for all columns.

    Where all values are in one cluster, every mean is the same: the spread between clusters is unknown.

    Args:
        columns: (n, m) finite, n >= 1, in any unit.
        clusters: (n,) labels, integers (the fastest) or text; values of equal labels are drawn together.
        draws: number of resamples.
        seed: of all resamples.
    """
    columns = checked("values", columns, ("n", "m"))
    labels = np.asarray(clusters)
    if labels.shape != columns.shape[:1]:
        raise InputError(f"clusters: expected a label for each of {len(columns)} values, got shape {labels.shape}")
    if not len(columns):
        raise InputError("values: none, and a mean needs at least one")
    if draws < 1:
        raise InputError(f"draws: expected at least 1, got {draws}")
    _, cluster = np.unique(labels, return_inverse=True)
    counts = np.bincount(cluster).astype(np.float64)
    sums = [np.bincount(cluster, weights=column) for column in columns.T]
    return _resampled_ratios(sums, counts, draws, stream(seed, "bootstrap"))


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


def rate_interval(k: int, n: int) -> tuple[float, float]:
    """Wilson's 95 % interval (lo, hi) of a rate, after k successes in n trials; all of (0, 1) after none."""
    if not 0 <= k <= n:
        raise InputError(f"a rate: expected 0 <= successes <= trials, got {k} of {n}")
    if n == 0:
        return 0.0, 1.0
    p, zz = k / n, Z * Z
    centre = (p + zz / (2 * n)) / (1 + zz / n)
    half = Z / (1 + zz / n) * np.sqrt(p * (1 - p) / n + zz / (4 * n * n))
    lo = 0.0 if k == 0 else float(centre - half)  # exact at the ends, where rounding leaves 1e-17
    hi = 1.0 if k == n else float(centre + half)
    return lo, hi
