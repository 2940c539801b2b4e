"""The interval of a single mean."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from benchmark.intervals import ENDS, bootstrap_means


def mean_interval(values: ArrayLike, clusters: ArrayLike, **bootstrap: int) -> tuple[float, float]:
    """95 % interval (lo, hi) of the mean of values (n,); clusters: (n,) labels; bootstrap: draws and seed."""
    lo, hi = np.quantile(bootstrap_means(np.asarray(values, float)[:, None], [clusters], **bootstrap), ENDS)
    return float(lo), float(hi)
