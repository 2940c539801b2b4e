"""Compiled loops that make smooth random fields: sums and products alone, so the same bits on every processor.

Letters: H rows, W columns. Fields are float32 with periodic boundaries; coarse ones hold every n-th pixel.
"""

from __future__ import annotations

import numpy as np

from kit1000.numerics.compiled import compiled

# The cumulative standard normal distribution at 0, 1/4, ..., 4, rounded: the error function of the C library differs
# between processors in its last bit. Between these values a straight line is within 0.003.
_CDF_STEP = 0.25
_CDF = np.array(
    [0.5, 0.598706, 0.691462, 0.773373, 0.841345, 0.89435, 0.933193, 0.959941, 0.97725, 0.987776, 0.99379, 0.99702,
     0.99865, 0.999423, 0.999767, 0.999912, 0.999968]
)  # fmt: skip
_CDF.setflags(write=False)


def windowed_noise(rng: np.random.Generator, shape: tuple[int, int], windows: tuple[int, int]) -> np.ndarray:
    """(H, W) float32 standard normal field with the correlation of two equal windows in succession.

    rng: gives one number a pixel. windows: [px] across and down, odd; (1, 1) leaves white noise.
    """
    white = rng.standard_normal(shape, dtype=np.float32)
    if windows == (1, 1):
        return white
    across, down = windows
    power = window_power(across) * window_power(down)  # remaining variance
    once = box_means(white, across, down, np.float32(1))
    return box_means(once, across, down, np.float32(1 / np.sqrt(power)))


def window_power(width: int) -> float:
    """The variance that white noise keeps under two means of `width` values in succession, along one axis."""
    kernel = np.ones(width) / width
    return float(np.sum(np.convolve(kernel, kernel) ** 2))


def smooth_field(rng: np.random.Generator, shape: tuple[int, int], window: int) -> np.ndarray:
    """(H, W) float32 standard normal field, close to one of a Gaussian correlation: three square windows in succession.

    rng: gives one number a pixel. window: [px] odd.
    """
    kernel = np.ones(window) / window
    power = np.sum(np.convolve(np.convolve(kernel, kernel), kernel) ** 2)  # along one axis
    field = rng.standard_normal(shape, dtype=np.float32)
    for scale in (1.0, 1.0, 1 / power):
        field = box_means(field, window, window, np.float32(scale))
    return field


@compiled
def box_means(image, across, down, scale):
    """Means over boxes of `across` x `down` px (odd), times `scale`, of an image (H, W) with periodic boundaries."""
    rows, columns = image.shape
    left, above = across // 2, down // 2
    share = scale / np.float32(across * down)
    out = np.empty_like(image)
    total = np.zeros(columns)
    for k in range(-above, above + 1):
        total += image[k % rows]
    sums = np.empty(columns + 2 * left)  # of the columns of one row, extended at both ends
    for v in range(rows):
        incoming, outgoing = image[(v + above + 1) % rows], image[(v - above) % rows]
        for u in range(columns):
            sums[left + u] = total[u]
            total[u] += incoming[u] - outgoing[u]
        for k in range(left):
            sums[k], sums[left + columns + k] = sums[left + (k - left) % columns], sums[left + k % columns]
        running = 0.0
        for k in range(across - 1):
            running += sums[k]
        for u in range(columns):
            running += sums[u + across - 1]
            out[v, u] = running * share
            running -= sums[u]
    return out


@compiled
def add_enlarged(out, field, factor, scale):
    """Add a coarse field (h, w) times `scale` to one (H, W): a value every `factor` px, bilinear in between."""
    rows, columns = out.shape
    h, w = field.shape
    line = np.empty(w + 1, np.float32)
    step = np.float32(1) / np.float32(factor)
    for v in range(rows):
        y = v // factor
        down = np.float32(v - y * factor) * step
        first, second = field[y % h], field[(y + 1) % h]
        for x in range(w):
            line[x] = scale * (first[x] + down * (second[x] - first[x]))
        line[w] = line[0]
        for k in range(factor):
            right = np.float32(k) * step
            for x in range((columns - k + factor - 1) // factor):
                out[v, x * factor + k] += line[x] + right * (line[x + 1] - line[x])


@compiled
def uniform_of(normal):
    """The share of a standard normal distribution below each value of an array (h, w); float32 in 0 to 1."""
    rows, columns = normal.shape
    out = np.empty((rows, columns), np.float32)
    last = len(_CDF) - 1
    for v in range(rows):
        for u in range(columns):
            at = abs(normal[v, u]) / _CDF_STEP
            k = min(int(at), last)
            value = _CDF[last]
            if k < last:
                value = _CDF[k] + (at - k) * (_CDF[k + 1] - _CDF[k])
            out[v, u] = value if normal[v, u] > 0 else 1 - value
    return out
