"""Intervals and comparisons: published numbers, a plain reference, coverage of a known mean, and known differences."""

from __future__ import annotations

import json
import time
import tracemalloc
from dataclasses import asdict, replace
from math import comb
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike
from scipy.stats import binomtest

from benchmark import compare as module
from benchmark import intervals, quantities
from benchmark.compare import bootstrap_p, compare, comparison_text, mcnemar_p
from benchmark.evaluate import PerQuery
from benchmark.intervals import ENDS, bootstrap_means, rate_interval, wilson_interval
from benchmark.report import json_text
from benchmark.score import Scores
from kit1000.errors import InputError
from kit1000.rng import stream


def mean_interval(values: ArrayLike, clusters: ArrayLike, **bootstrap: int) -> tuple[float, float]:
    """95 % interval (lo, hi) of the mean of values (n,); clusters: (n,) labels; bootstrap: draws and seed."""
    lo, hi = np.quantile(bootstrap_means(np.asarray(values, float)[:, None], [clusters], **bootstrap), ENDS)
    return float(lo), float(hi)


def clustered(rng: np.random.Generator, clusters: int = 60, between: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Values (n,) about 5 in clusters of 1 to 5, with a spread between clusters and one of 0.5 within; their labels."""
    label = np.repeat(np.arange(clusters), rng.integers(1, 6, clusters))
    return 5 + between * rng.standard_normal(clusters)[label] + 0.5 * rng.standard_normal(len(label)), label


@given(st.integers(1, 5000), st.floats(0, 1))
def test_wilson_agrees_with_scipy(n: int, share: float) -> None:
    k = round(share * n)
    theirs = binomtest(k, n).proportion_ci(method="wilson")
    np.testing.assert_allclose(wilson_interval(k / n, n), (theirs.low, theirs.high), atol=1e-12)


def test_without_a_trial_every_rate_is_possible_and_impossible_shares_are_refused() -> None:
    assert wilson_interval(0, 0) == rate_interval([], [[]]) == (0.0, 1.0)
    for share, n in ((-0.1, 5), (1.1, 5), (np.nan, 5), (0, -1)):
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


def test_two_clusterings_keep_the_skew_of_the_values() -> None:
    first, second = np.divmod(np.arange(144), 12)
    values = 10.0 * ((first == 0) | (second == 0))  # one cluster of twelve has all of it: the mean may rise far
    means = bootstrap_means(values[:, None], [first, second])[:, 0]
    low, high = np.quantile(means, ENDS)
    assert high - values.mean() > 1.2 * (values.mean() - low)


def test_a_clustering_within_the_other_changes_nothing() -> None:
    values, labels = clustered(np.random.default_rng(12))
    within = np.arange(len(labels))
    alone = bootstrap_means(values[:, None], [labels])
    for clusterings in ([labels, within], [within, labels], [labels, labels], [labels, 2 * labels]):
        np.testing.assert_array_equal(bootstrap_means(values[:, None], clusterings), alone)


@pytest.mark.parametrize("at_once", [1, 100, 1 << 20])
def test_the_size_of_a_step_changes_nothing(at_once: int, monkeypatch: pytest.MonkeyPatch) -> None:
    values, labels = clustered(np.random.default_rng(7))
    whole = mean_interval(values, labels)
    monkeypatch.setattr(intervals, "AT_ONCE", at_once)
    assert mean_interval(values, labels) == pytest.approx(whole, rel=1e-12)


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


TEXT = ("query_id", "track", "scene_id", "assembly_id", "part_id", "rest_mode", "symmetry")
BITS = ("covered", "seated", "seated_strict", "exact_test", "exact_disagreement", "crowded", "held_out")


def rows(n: int = 100, track: str = "snap", **columns: Any) -> PerQuery:
    """Rows of n queries, all predicted, two per assembly; columns that are not given are 0, False or a dash."""
    number = np.arange(n)
    names = {*PerQuery.__dataclass_fields__, *(quantity.key for quantity in quantities.per_query())}
    made: dict[str, Any] = {name: np.zeros(n) for name in names}
    made |= {name: np.full(n, "-") for name in TEXT} | {name: np.zeros(n, bool) for name in BITS}
    made |= {
        "query_id": np.array([f"test-s{i:04d}-p0-{track}" for i in number]),
        "track": np.full(n, track),
        "assembly_id": np.array([f"a{i // 2}" for i in number]),
        "part_id": np.array([f"p{i}" for i in number]),
        "covered": np.ones(n, bool),
        "kits": np.full(n, 2),
    }
    return PerQuery.of_columns({**made, **columns})


def concatenate(*several: PerQuery) -> PerQuery:
    columns = [each.columns() for each in several]
    return PerQuery.of_columns({name: np.concatenate([each[name] for each in columns]) for name in columns[0]})


def scored(measured: PerQuery, method: str = "ours", **setting: str) -> Scores:
    summary = {"method": method, "dataset_id": "abc", "protocol": "kit1000-2026", "split": "test"}
    summary |= {"manifest": {"masks": "given"}}
    return Scores(measured, summary | setting)


def errors(seed: int, n: int = 100, mean: float = 3.0) -> np.ndarray:
    """(n,) errors with that mean, correlated within an assembly."""
    rng = np.random.default_rng(seed)
    return mean + np.repeat(rng.standard_normal(n // 2), 2) + 0.3 * rng.standard_normal(n)


def test_a_method_that_is_better_everywhere_is_reported_so() -> None:
    a = rows(
        position_mm=errors(1, mean=2),
        rotation_deg=errors(2, mean=2),
        mssd_mm=errors(3, mean=2),
        seated=np.full(100, True),
    )
    b = rows(position_mm=errors(4, mean=9), rotation_deg=errors(5, mean=9), mssd_mm=errors(6, mean=9))
    found = compare(scored(a), scored(b)).tracks["snap"]
    for row in found.differences.values():
        assert row is not None
        assert row.better == "A"
        assert row.p < 0.001
        assert row.ci95[0] <= row.difference <= row.ci95[1]
    assert all(row and row.better == "B" for row in compare(scored(b), scored(a)).tracks["snap"].differences.values())


def test_the_interval_is_that_of_the_paired_differences() -> None:
    a, b = rows(position_mm=errors(1)), rows(position_mm=errors(2))
    difference = a.quantities["position_mm"] - b.quantities["position_mm"]
    row = compare(scored(a), scored(b), draws=500, seed=3).tracks["snap"].differences["position_mm"]
    assert row is not None
    assert row.ci95 == mean_interval(difference, a.assembly_id, draws=500, seed=3)
    assert row.difference == pytest.approx(row.a - row.b) == pytest.approx(np.mean(difference))


def test_a_method_does_not_differ_from_itself() -> None:
    same = scored(rows(position_mm=errors(1), mssd_mm=errors(2), seated=errors(3) > 3))
    for row in compare(same, same).tracks["snap"].differences.values():
        assert row is not None
        assert (row.difference, row.ci95, row.p, row.better) == (0, (0, 0), 1, None)


def test_swapping_the_two_flips_every_sign() -> None:
    a, b = (scored(rows(position_mm=errors(s, mean=s), seated=errors(s) > 3)) for s in (1, 2))
    there, back = compare(a, b).tracks["snap"].differences, compare(b, a).tracks["snap"].differences
    for metric, row in there.items():
        other = back[metric]
        assert row is not None
        assert other is not None
        assert (other.difference, other.p) == (-row.difference, row.p)
        np.testing.assert_allclose(other.ci95, [-end for end in row.ci95[::-1]], rtol=1e-12, atol=1e-12)


def test_only_queries_that_both_predict_count() -> None:
    position = np.where(np.arange(100) < 10, 1e6, errors(1))
    a = rows(position_mm=position, covered=np.arange(100) >= 10)
    b = rows(position_mm=errors(2), covered=np.arange(100) < 95)
    found = compare(scored(a), scored(b)).tracks["snap"]
    assert (found.queries, found.predicted_a, found.predicted_b, found.n) == (100, 90, 95, 85)
    row = found.differences["position_mm"]
    assert row is not None
    assert row.a == pytest.approx(position[10:95].mean())
    assert "85 queries that both predict, of 100; A predicts 90, B 95" in comparison_text(compare(scored(a), scored(b)))


def test_no_query_in_common_gives_empty_differences() -> None:
    half = np.arange(100) < 50
    found = compare(scored(rows(covered=half)), scored(rows(covered=~half)))
    assert found.tracks["snap"].n == 0
    assert set(found.tracks["snap"].differences.values()) == {None}
    assert "snap: 0 queries that both predict" in comparison_text(found)
    assert json.loads(json_text(asdict(found)))["tracks"]["snap"]["differences"]["seated"] is None


def test_a_method_of_rotations_is_compared_in_rotation_alone() -> None:
    nothing = np.full(100, np.nan)
    a = rows(position_mm=nothing, mssd_mm=nothing, rotation_deg=errors(1))
    found = compare(scored(a), scored(rows(rotation_deg=errors(2, mean=8)))).tracks["snap"].differences
    assert [metric for metric, row in found.items() if row is not None] == ["rotation_deg"]


@pytest.mark.parametrize(("only_a", "only_b"), [(0, 0), (3, 3), (5, 0), (1, 9), (30, 12), (0, 1)])
def test_mcnemar_equals_the_sum_of_binomial_terms(only_a: int, only_b: int) -> None:
    n = only_a + only_b
    tail = sum(comb(n, k) for k in range(min(only_a, only_b) + 1)) / 2**n
    assert mcnemar_p(only_a, only_b) == pytest.approx(min(1.0, 2 * tail))


def test_the_p_value_of_seated_is_mcnemars() -> None:
    a, b = rows(seated=np.arange(100) < 60), rows(seated=np.arange(100) >= 45)
    row = compare(scored(a), scored(b)).tracks["snap"].differences["seated"]
    assert row is not None
    assert (row.only_a, row.only_b) == (45, 40)
    assert row.p == mcnemar_p(45, 40)
    assert row.better is None


def test_few_assemblies_are_not_significant_though_mcnemar_counts_many_queries() -> None:
    assembly = np.repeat(np.arange(4), 25).astype(str)
    a, b = (rows(seated=assembly == name, assembly_id=assembly) for name in ("0", "none"))
    row = compare(scored(a), scored(b)).tracks["snap"].differences["seated"]
    assert row is not None
    assert row.p < 1e-6
    assert row.ci95[0] == 0
    assert row.better is None


@pytest.mark.parametrize(
    ("drawn", "p"),
    [
        (np.ones(999), 2 / 1000),
        (-np.ones(999), 2 / 1000),
        (np.zeros(999), 1.0),
        (np.arange(-24, 975), 2 * 26 / 1000),  # 24 below zero, and zero itself
    ],
)
def test_the_p_value_counts_the_rarer_side(drawn: np.ndarray, p: float) -> None:
    assert bootstrap_p(drawn) == pytest.approx(p)


def test_equal_methods_differ_significantly_in_5_of_100_samples() -> None:
    alarms = 0
    for world in range(400):
        a, b = (scored(rows(position_mm=errors(1000 * world + i))) for i in (1, 2))
        row = compare(a, b, draws=400, seed=world).tracks["snap"].differences["position_mm"]
        assert row is not None
        assert (row.p < 0.05) == (row.better is not None) or abs(row.p - 0.05) < 0.006
        alarms += row.better is not None
    assert alarms / 400 == pytest.approx(0.05, abs=0.025)


def test_tracks_are_those_in_common_and_curves_are_none() -> None:
    a = scored(concatenate(rows(10), rows(10, "place"), rows(10, "curves")))
    b = scored(concatenate(rows(10), rows(10, "snap-tilt"), rows(10, "place"), rows(10, "curves")))
    assert list(compare(a, b).tracks) == ["snap", "place"]
    assert list(compare(a, b, ["place"]).tracks) == ["place"]
    a, b = scored(rows(10)), scored(concatenate(rows(10), rows(10, "place")))
    with pytest.raises(InputError, match="track 'place': A and B both have snap"):
        compare(a, b, ["place"])
    with pytest.raises(InputError, match="no track in common"):
        compare(a, scored(rows(10, "place")))


def test_scores_of_different_settings_or_queries_are_refused() -> None:
    for key in ("dataset_id", "protocol", "split"):
        with pytest.raises(InputError, match=f"{key} is .* of A, other of B"):
            compare(scored(rows(10)), scored(rows(10), **{key: "other"}))
    with pytest.raises(InputError, match="different queries"):
        compare(scored(rows(10)), scored(rows(12)))


def test_the_report_has_the_better_method_the_difference_and_its_p_value() -> None:
    a = rows(position_mm=errors(1, mean=2), seated=np.arange(100) < 90)
    b = rows(position_mm=errors(2, mean=9), seated=np.arange(100) < 20)
    text = comparison_text(compare(scored(a, "registration"), scored(b, "icp")))
    assert text.startswith("A: registration, masks given\nB: icp, masks given\n")
    position, rotation, _, seated = text.splitlines()[6:10]
    assert position.startswith("position mm   ")
    assert position.endswith("<0.001  A is better by 7.09")
    assert rotation.endswith("1.000  no significant difference")
    assert "70.0 [" in seated
    assert seated.endswith("A is better by 70.0 (70 by A alone, 0 by B alone)")
    assert max(map(len, text.splitlines())) < 130


def test_the_command_scores_both_and_writes_what_it_prints(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    measured = {"a": rows(position_mm=errors(1, mean=2)), "b": rows(position_mm=errors(2, mean=9))}
    monkeypatch.setattr(module, "Dataset", Path)
    monkeypatch.setattr(module, "read_valid_submission", lambda folder: SimpleNamespace(name=folder.name))
    monkeypatch.setattr(
        module, "score", lambda submission, *_, **__: scored(measured[submission.name], submission.name)
    )
    module.run(Path("a"), Path("b"), tmp_path, ("snap",), tmp_path / "a-b.json")
    found = compare(scored(measured["a"], "a"), scored(measured["b"], "b"))
    assert capsys.readouterr().out == comparison_text(found) + "\n"
    written = json.loads((tmp_path / "a-b.json").read_text("utf-8"))
    assert written["tracks"]["snap"]["differences"]["position_mm"]["better"] == "A"
    assert (tmp_path / "a-b.json").read_text("utf-8") == json_text(asdict(replace(found)))
