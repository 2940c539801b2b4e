"""From votes to parts: pixels whose votes gather about one place are of one part."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter, maximum_filter

SPREAD = 3.0  # [px] standard deviation of the votes of a part, about
APART = 8  # [px] between the middles of two parts, at least
LEAST_VOTES = 40  # pixels that gather there


def gathered(places: np.ndarray, part: np.ndarray) -> np.ndarray:
    """(H, W) int: from 1 on the pixels of each part, 0 elsewhere.

    Args:
        places: (2, H, W) [px] row and column of the middle of the part that a pixel shows.
        part: (H, W) bool: pixels that show one.
    """
    labels = np.zeros(part.shape, int)
    votes = places[:, part]
    peaks = _peaks(votes, part.shape)
    if len(peaks):
        away = np.square(votes[:, :, None] - peaks.T[:, None]).sum(0)
        labels[part] = 1 + away.argmin(1)
    return labels


def _peaks(votes: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """(n, 2) [px] where votes (2, k) gather in an image of a shape."""
    row, column = np.rint(np.clip(votes, 0, np.array(shape)[:, None] - 1)).astype(int)
    counts = np.bincount(row * shape[1] + column, minlength=int(np.prod(shape))).reshape(shape)
    density = gaussian_filter(counts.astype(float), SPREAD)
    near = 2 * np.pi * SPREAD**2 * density  # votes there, if they spread like that
    highest = (density == maximum_filter(density, 2 * APART + 1)) & (near >= LEAST_VOTES)
    return np.argwhere(highest).astype(float)
