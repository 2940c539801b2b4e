"""Smooth random fields compared with closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d
from scipy.stats import norm

from kit1000.rng import stream
from kit1000.sim.noise_fields import add_enlarged, box_means, smooth_field, uniform_of, windowed_noise


def test_box_means_are_those_of_a_filter_with_periodic_boundaries() -> None:
    image = np.random.default_rng(0).standard_normal((17, 23)).astype(np.float32)
    for across, down in ((1, 1), (5, 3), (7, 9)):
        once = uniform_filter1d(image.astype(float), down, 0, mode="wrap")
        expected = 2 * uniform_filter1d(once, across, 1, mode="wrap")
        np.testing.assert_allclose(box_means(image, across, down, np.float32(2)), expected, atol=1e-5)


@pytest.mark.parametrize("windows", [(1, 1), (13, 9), (5, 1)])
def test_windowed_noise_has_unit_variance_and_the_correlation_of_its_windows(windows: tuple[int, int]) -> None:
    field = np.stack([windowed_noise(stream(seed), (480, 640), windows) for seed in range(4)])
    assert field.dtype == np.float32
    assert np.std(field) == pytest.approx(1, abs=0.03)
    for axis, width in ((2, windows[0]), (1, windows[1])):
        kernel = np.convolve(np.ones(width), np.ones(width))
        tail = np.correlate(kernel, kernel, "full")[len(kernel) - 1 :] / np.sum(kernel**2)
        for lag in (1, 4, 8):
            expected = tail[lag] if lag < len(tail) else 0
            assert np.mean(field * np.roll(field, lag, axis)) == pytest.approx(expected, abs=0.04)


def test_a_smooth_field_has_unit_variance() -> None:
    fields = np.stack([smooth_field(stream(seed), (200, 300), 7) for seed in range(6)])
    assert np.std(fields) == pytest.approx(1, abs=0.05)
    assert np.mean(fields * np.roll(fields, 1, 2)) > 0.95


def test_the_share_below_a_normal_value_is_its_distribution() -> None:
    values = np.linspace(-6, 6, 4001, dtype=np.float32)[None]
    shares = uniform_of(values)[0]
    np.testing.assert_allclose(shares, norm.cdf(values[0]), atol=3e-3)
    assert (np.diff(shares) >= 0).all()
    assert shares.min() >= 0
    assert shares.max() <= 1


@pytest.mark.parametrize(("shape", "factor"), [((12, 20), 4), ((13, 21), 4), ((9, 9), 8), ((6, 7), 2)])
def test_an_enlarged_field_is_bilinear_between_its_values(shape: tuple[int, int], factor: int) -> None:
    coarse = tuple(-(-n // factor) for n in shape)
    field = np.random.default_rng(1).standard_normal(coarse).astype(np.float32)
    out = np.ones(shape, np.float32)
    add_enlarged(out, field, factor, np.float32(3))
    np.testing.assert_allclose(out[::factor, ::factor], 1 + 3 * field, atol=1e-5)
    wrapped = np.pad(field, ((0, 1), (0, 1)), mode="wrap")
    for v in range(shape[0]):
        for u in range(shape[1]):
            (y, b), (x, a) = divmod(v, factor), divmod(u, factor)
            a, b = a / factor, b / factor
            four = wrapped[y : y + 2, x : x + 2].astype(float)
            expected = 1 + 3 * (np.array([1 - b, b]) @ four @ np.array([1 - a, a]))
            assert out[v, u] == pytest.approx(expected, abs=1e-5)
