"""Intervals: published numbers, a plain reference implementation, and their coverage of a known mean."""

from __future__ import annotations

import time
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binomtest

from benchmark import intervals
from benchmark.intervals import ENDS, bootstrap_means, rate_interval, wilson_interval
from kit1000.errors import InputError
from kit1000.rng import stream
from tests.samples.mean_intervals import mean_interval


def clustered(rng: np.random.Generator, clusters: int = 60, between: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Values (n,) about 5 in clusters of 1 to 5, with a spread between clusters and one of 0.5 within; their labels."""
    label = np.repeat(np.arange(clusters), rng.integers(1, 6, clusters))
    return 5 + between * rng.standard_normal(clusters)[label] + 0.5 * rng.standard_normal(len(label)), label


@pytest.mark.parametrize(
    ("k", "n", "lo", "hi"),
    [(50, 50, 92.9, 100), (45, 50, 78.6, 95.7), (900, 1000, 88.0, 91.7), (0, 20, 0, 16.1)],
)
def test_wilson_gives_published_numbers(k: int, n: int, lo: float, hi: float) -> None:
    assert tuple(round(100 * end, 1) for end in wilson_interval(k / n, n)) == (lo, hi)


@given(st.integers(1, 5000), st.floats(0, 1))
def test_wilson_agrees_with_scipy(n: int, share: float) -> None:
    k = round(share * n)
    theirs = binomtest(k, n).proportion_ci(method="wilson")
    np.testing.assert_allclose(wilson_interval(k / n, n), (theirs.low, theirs.high), atol=1e-12)


def test_without_a_trial_every_rate_is_possible() -> None:
    assert wilson_interval(0, 0) == (0.0, 1.0)
    assert rate_interval([], [[]]) == (0.0, 1.0)


@pytest.mark.parametrize(("share", "n"), [(-0.1, 5), (1.1, 5), (np.nan, 5), (0, -1)])
def test_impossible_shares_are_refused(share: float, n: float) -> None:
    with pytest.raises(InputError, match="expected a share of 0 to 1 in 0 trials or more"):
        wilson_interval(share, n)


@given(st.integers(2, 60).flatmap(lambda n: st.lists(st.booleans(), min_size=n, max_size=n)))
def test_without_clusters_a_rate_has_as_many_trials_as_values(passed: list[bool]) -> None:
    n = len(passed)
    found = rate_interval(passed, [np.arange(n)])
    np.testing.assert_allclose(found, wilson_interval(sum(passed) / n, n), atol=1e-12)


@given(st.lists(st.booleans(), min_size=3, max_size=30).filter(lambda each: len(set(each)) == 2), st.integers(2, 9))
def test_copies_in_a_cluster_are_no_further_trials(passed: list[bool], copies: int) -> None:
    n = len(passed)
    found = rate_interval(np.repeat(passed, copies), [np.repeat(np.arange(n), copies)])
    np.testing.assert_allclose(found, wilson_interval(sum(passed) / n, n), atol=1e-12)


def test_a_rate_of_all_has_as_many_trials_as_clusters_and_one_cluster_tells_little() -> None:
    assert rate_interval(np.ones(200, bool), [np.arange(200), np.arange(200) % 148]) == wilson_interval(1, 148)
    passed = np.arange(20) % 2 == 0
    assert rate_interval(passed, [np.zeros(20)]) == wilson_interval(0.5, 1)


@given(st.integers(0, 2**32 - 1))
def test_clusters_never_narrow_the_interval_of_a_rate(seed: int) -> None:
    rng = np.random.default_rng(seed)
    passed, clusters = rng.random(60) < 0.7, [rng.integers(20, size=60), rng.integers(15, size=60)]
    lo, hi = wilson_interval(passed.mean(), 60)
    low, high = rate_interval(passed, clusters)
    assert low <= lo + 1e-12
    assert high >= hi - 1e-12


def reference_means(values: np.ndarray, labels: np.ndarray, draws: int, seed: int) -> list[float]:
    """Means of resamples in plain Python, cluster by cluster; only the draws are those of numpy."""
    groups = [values[labels == label].tolist() for label in sorted(set(labels.tolist()))]
    rng, means = stream(seed, "bootstrap"), []
    for _ in range(draws):
        drawn = [groups[i] for i in rng.integers(len(groups), size=len(groups), dtype=np.int32)]
        pooled = [value for group in drawn for value in group]
        means.append(sum(pooled) / len(pooled))
    return means


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.integers(1, 30), st.integers(1, 40))
def test_resampling_equals_a_plain_implementation(seed: int, clusters: int, draws: int) -> None:
    values, labels = clustered(np.random.default_rng(seed), clusters)
    shuffled = np.random.default_rng(seed).permutation(len(values))
    ours = bootstrap_means(values[shuffled, None], [labels[shuffled]], draws, seed)
    np.testing.assert_allclose(ours[:, 0], reference_means(values, labels, draws, seed), rtol=1e-12)


def test_the_ends_are_percentiles_of_the_resamples() -> None:
    values, labels = clustered(np.random.default_rng(1))
    means = np.sort(bootstrap_means(values[:, None], [labels], draws=1001)[:, 0])
    assert mean_interval(values, labels, draws=1001) == pytest.approx((means[25], means[975]))


def coverage(clusters: int, trials: int, between: float, by_cluster: bool) -> float:
    """Share of intervals that contain the true mean, 5."""
    hits = 0
    for trial in range(trials):
        values, labels = clustered(stream(5, trial), clusters, between)
        lo, hi = mean_interval(values, labels if by_cluster else np.arange(len(values)), draws=500, seed=trial)
        hits += lo <= 5 <= hi
    return hits / trials


@pytest.mark.parametrize("between", [0.0, 1.0])
def test_the_interval_covers_the_true_mean_in_95_of_100_samples(between: float) -> None:
    assert coverage(100, 800, between, by_cluster=True) == pytest.approx(0.95, abs=0.02)


def test_taking_clustered_values_as_independent_covers_the_true_mean_too_rarely() -> None:
    assert coverage(100, 300, 1.0, by_cluster=False) < 0.85


def crossed(rng: np.random.Generator, part: float, assembly: float) -> tuple[np.ndarray, list[np.ndarray]]:
    """Values (n,) about 5 of 3 out of 80 parts in each of 80 assemblies, with these spreads; both their labels."""
    assemblies, parts = np.repeat(np.arange(80), 3), rng.permuted(np.tile(np.arange(80), 3))
    effects = part * rng.standard_normal(80)[parts] + assembly * rng.standard_normal(80)[assemblies]
    return 5 + effects + 0.5 * rng.standard_normal(240), [assemblies, parts]


@pytest.mark.parametrize(("part", "assembly"), [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)])
def test_two_clusterings_cover_the_true_mean_in_95_of_100_samples(part: float, assembly: float) -> None:
    hits = alone = 0
    for trial in range(300):
        values, clusterings = crossed(stream(7, trial), part, assembly)
        lo, hi = np.quantile(bootstrap_means(values[:, None], clusterings, 300, trial)[:, 0], ENDS)
        hits += lo <= 5 <= hi
        lo, hi = mean_interval(values, clusterings[0], draws=300, seed=trial)
        alone += lo <= 5 <= hi
    assert hits / 300 == pytest.approx(0.95, abs=0.03)
    assert part == 0 or alone / 300 < 0.9


def test_the_order_of_the_clusterings_hardly_matters() -> None:
    values, (first, second) = crossed(np.random.default_rng(11), 1.0, 1.0)
    one, other = (
        np.quantile(bootstrap_means(values[:, None], each), ENDS) for each in ([first, second], [second, first])
    )
    np.testing.assert_allclose(one, other, atol=0.1 * (one[1] - one[0]))


def test_a_clustering_within_the_other_changes_nothing() -> None:
    values, labels = clustered(np.random.default_rng(12))
    within = np.arange(len(labels))
    alone = bootstrap_means(values[:, None], [labels])
    for clusterings in ([labels, within], [within, labels], [labels, labels], [labels, 2 * labels]):
        np.testing.assert_array_equal(bootstrap_means(values[:, None], clusterings), alone)


def test_one_seed_gives_one_interval_and_another_seed_nearly_the_same() -> None:
    values, labels = clustered(np.random.default_rng(6))
    first = mean_interval(values, labels, seed=1)
    assert mean_interval(values, labels, seed=1) == first
    second = mean_interval(values, labels, seed=2)
    assert second != first
    np.testing.assert_allclose(second, first, atol=0.15 * (first[1] - first[0]))


@pytest.mark.parametrize("at_once", [1, 100, 1 << 20])
def test_the_size_of_a_step_changes_nothing(at_once: int, monkeypatch: pytest.MonkeyPatch) -> None:
    values, labels = clustered(np.random.default_rng(7))
    whole = mean_interval(values, labels)
    monkeypatch.setattr(intervals, "AT_ONCE", at_once)
    assert mean_interval(values, labels) == pytest.approx(whole, rel=1e-12)


def test_labels_may_be_text() -> None:
    values, labels = clustered(np.random.default_rng(8))
    text = np.array([f"test-s{label:04d}" for label in labels])
    assert mean_interval(values, text) == mean_interval(values, labels)


def test_equal_values_have_an_interval_of_no_width() -> None:
    assert mean_interval(np.full(9, 2.0), [0, 0, 0, 1, 1, 2, 3, 3, 3]) == (2.0, 2.0)


def test_columns_share_their_resamples() -> None:
    values, labels = clustered(np.random.default_rng(10))
    means = bootstrap_means(np.stack([values, 2 * values], axis=1), [labels])
    np.testing.assert_allclose(means[:, 1], 2 * means[:, 0])


@pytest.mark.parametrize(
    ("values", "clusters", "draws", "fault"),
    [
        ([], [], 10, "values: none"),
        ([1.0, np.nan], [0, 1], 10, "not finite"),
        ([1.0, 2.0], [0], 10, "one or two labels for each of 2 values"),
        ([1.0, 2.0], [0, 1], 0, "draws: expected at least 1"),
    ],
)
def test_bad_input_is_refused_in_a_line(values: list[float], clusters: list[int], draws: int, fault: str) -> None:
    with pytest.raises(InputError, match=fault):
        mean_interval(values, clusters, draws=draws)


def test_many_values_take_little_time_and_bounded_memory() -> None:
    rng = np.random.default_rng(12)
    values, labels = rng.exponential(size=100_000), rng.integers(200, size=100_000)
    mean_interval(values[:10], labels[:10])
    started = time.process_time()
    mean_interval(values, labels)
    assert time.process_time() - started < 0.5
    tracemalloc.start()
    mean_interval(values, np.arange(100_000), draws=20)
    few = tracemalloc.get_traced_memory()[1]
    tracemalloc.reset_peak()
    mean_interval(values, np.arange(100_000), draws=200)
    many = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert many < 1.1 * few < 2e7
