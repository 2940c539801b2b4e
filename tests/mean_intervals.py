"""The interval of a single mean, as tests ask for it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from benchmark.intervals import ENDS, bootstrap_means


def mean_interval(values: ArrayLike, clusters: ArrayLike, **drawn: int) -> tuple[float, float]:
    """95 % interval (lo, hi) of the mean of values (n,); clusters: (n,) labels; drawn: draws and seed."""
    lo, hi = np.quantile(bootstrap_means(np.asarray(values, float)[:, None], clusters, **drawn), ENDS)
    return float(lo), float(hi)
