"""Laws of the study's statistics: hand-worked examples, brute force, and effects that were planted."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from kit1000.errors import InputError
from kit1000.study import statistics
from kit1000.study.statistics import bca_interval, compare, holm, wilcoxon_test

DIFFERENCES = st.lists(st.integers(-20, 20), min_size=3, max_size=7)


def test_t_and_d_z_of_a_hand_worked_example() -> None:
    """Differences 1, 2, 3: mean 2, standard deviation 1, t = 2 sqrt(3) with two degrees of freedom."""
    found = compare([1.0, 2.0, 3.0])
    t = 2 * np.sqrt(3)
    assert found.d_z == pytest.approx(2.0)
    assert found.t_p == pytest.approx(1 - t / np.sqrt(2 + t * t))  # the closed form for two degrees of freedom
    assert found.wilcoxon_p == pytest.approx(2 / 8)
    assert found.rank_biserial == 1


@settings(max_examples=10)
@given(DIFFERENCES)
def test_wilcoxon_is_the_share_of_sign_patterns(values: list[int]) -> None:
    """Brute force over all signs, with ties and zeros."""
    differences = np.array(values, float)
    if not differences.any():
        assert wilcoxon_test(differences) == 1
        return
    ranks = stats.rankdata(np.abs(differences))
    zeros = ranks[differences == 0].sum() / 2
    sums = np.array(
        [
            sum(r for r, d, s in zip(ranks, differences, signs, strict=True) if d != 0 and s > 0) + zeros
            for signs in product((-1, 1), repeat=len(ranks))
        ]
    )
    seen = ranks[differences > 0].sum() + zeros
    middle = ranks.sum() / 2
    expected = np.mean(np.abs(sums - middle) >= abs(seen - middle) - 1e-9)
    assert wilcoxon_test(differences) == pytest.approx(expected)


def test_the_interval_moves_and_grows_with_the_differences() -> None:
    values = np.random.default_rng(0).normal(2, 3, 12)
    low, high = bca_interval(values)
    assert low < values.mean() < high
    np.testing.assert_allclose(bca_interval(10 * values + 5), (10 * low + 5, 10 * high + 5))
    t_low, t_high = stats.t.interval(0.95, 11, values.mean(), stats.sem(values))
    assert abs(low - t_low) < 0.25 * (t_high - t_low)
    assert abs(high - t_high) < 0.25 * (t_high - t_low)
    assert bca_interval(values) == (low, high)  # the same bytes twice


def test_people_who_all_differ_by_the_same_break_nothing() -> None:
    none, all_two = compare([0.0, 0.0, 0.0]), compare([2.0, 2.0, 2.0, 2.0])
    assert (none.p, none.low, none.high, none.d_z) == (1, 0, 0, None)
    assert (all_two.test, all_two.p, all_two.low, all_two.high) == ("Wilcoxon", 2 / 16, 2, 2)


def test_holm_of_a_hand_worked_example() -> None:
    assert holm([0.01, 0.04, 0.03, 0.5]) == pytest.approx([0.04, 0.09, 0.09, 0.5])
    assert holm([]) == []


@given(st.lists(st.floats(0, 1), max_size=8))
def test_holm_keeps_the_order_and_lies_between_p_and_bonferroni(values: list[float]) -> None:
    adjusted = holm(values)
    for p, q in zip(values, adjusted, strict=True):
        assert p <= q <= min(1.0, len(values) * p) + 1e-12
    assert [q for _, q in sorted(zip(values, adjusted, strict=True))] == sorted(adjusted)


def test_a_planted_effect_is_found_and_a_null_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """d_z = 1 and n = 10 have a power of 80.3 %; 60 studies have standard errors of 5.1 and 2.8 points."""
    for name in ("RESAMPLES", "EXACT"):  # of the intervals, and of the signs where Wilcoxon counts
        monkeypatch.setattr(statistics, name, 100)

    def share_found(effect: float, seed: int) -> float:
        rng = np.random.default_rng(seed)
        return float(np.mean([compare(rng.normal(effect, 1, 10)).p < 0.05 for _ in range(60)]))

    assert 0.80 - 0.15 < share_found(1.0, 1) < 0.80 + 0.15
    assert share_found(0.0, 2) < 0.05 + 0.084


@pytest.mark.parametrize("values", [[1.0, 2.0], [1.0, np.nan, 2.0], [[1.0, 2.0, 3.0]], ["a", "b", "c"]])
def test_what_is_no_comparison_is_refused(values: list[float]) -> None:
    with pytest.raises(InputError, match="differences"):
        compare(values)
