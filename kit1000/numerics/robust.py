"""Weights by which residuals that are too large do not count (Beaton and Tukey 1974)."""

from __future__ import annotations

import numpy as np

TUKEY = 4.685  # standard deviations at which a weight becomes 0: 95 % efficient for normal residuals


def tukey_weights(residuals: np.ndarray, limit: float | np.ndarray) -> np.ndarray:
    """(n,) Tukey's biweights of residuals (n,): 1 for none, 0 from a limit on, which is one number or (n,)."""
    return np.square(np.clip(1 - np.square(residuals / limit), 0, None))
