"""Paired statistics of a study: pure functions of one number a person.

Every comparison is a contrast: a difference a person, tested against zero. What scipy has is scipy's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from kit1000.errors import InputError, checked
from kit1000.rng import stream

ALPHA = 0.05
RESAMPLES = 10_000
EXACT = 2**14  # sign patterns up to which Wilcoxon's test enumerates all, and as many drawn ones beyond
FEWEST = 3  # people of whom a comparison is made


@dataclass(frozen=True)
class Comparison:
    """A contrast of n people, tested against zero."""

    n: int
    mean: float
    low: float
    high: float  # 95 % BCa interval of the mean
    d_z: float | None  # mean over standard deviation of the differences; None where all differ by the same
    rank_biserial: float  # matched pairs: favourable minus unfavourable rank sum, over their total; -1 to 1
    t_p: float
    wilcoxon_p: float
    normality_p: float  # P value of the test of Shapiro and Wilk
    test: str  # t, or Wilcoxon where the differences do not look normal

    @property
    def p(self) -> float:
        """P value of the test that counts."""
        return self.t_p if self.test == "t" else self.wilcoxon_p


def compare(differences: ArrayLike, seed: int = 0) -> Comparison:
    """Test differences (n,), one a person, against zero; n >= 3. seed: of the resampling."""
    values = _values(differences)
    t_p, wilcoxon_p, normality_p = t_test(values), wilcoxon_test(values, seed), normality(values)
    low, high = bca_interval(values, seed)
    spread = float(values.std(ddof=1))
    return Comparison(
        len(values),
        float(values.mean()),
        low,
        high,
        float(values.mean()) / spread if _varies(values) else None,
        rank_biserial(values),
        t_p,
        wilcoxon_p,
        normality_p,
        "t" if _varies(values) and normality_p >= ALPHA else "Wilcoxon",
    )


def t_test(values: np.ndarray) -> float:
    """Two-sided p of a t test of (n,) against zero; 1 where all are zero, 0 where all are one other number."""
    if not _varies(values):
        return 0.0 if values[0] else 1.0
    return float(stats.ttest_1samp(values, 0.0).pvalue)  # type: ignore[attr-defined]


def wilcoxon_test(values: np.ndarray, seed: int = 0) -> float:
    """Two-sided p of Wilcoxon's signed ranks, zeros split; by permutation, as ties are the rule on rating scales."""
    if not np.any(values):
        return 1.0
    rng = stream(seed, "study-signs")
    method = stats.PermutationMethod(n_resamples=EXACT, rng=rng)
    return float(stats.wilcoxon(values, zero_method="zsplit", method=method)[1])  # type: ignore[arg-type]


def normality(values: np.ndarray) -> float:
    """p of Shapiro and Wilk's test of (n,); 1 where all are equal."""
    return float(stats.shapiro(values).pvalue) if _varies(values) else 1.0


def bca_interval(values: np.ndarray, seed: int = 0) -> tuple[float, float]:
    """95 % interval of the mean of (n,): by the BCa bootstrap; the number itself where all are equal."""
    if not _varies(values):
        return float(values[0]), float(values[0])
    rng = stream(seed, "study-bootstrap")
    found = stats.bootstrap((values,), np.mean, n_resamples=RESAMPLES, method="BCa", rng=rng, batch=1000)
    low, high = found.confidence_interval
    return float(low), float(high)


def rank_biserial(values: np.ndarray) -> float:
    """Matched-pairs rank-biserial correlation (Kerby 2014) of (n,); zeros count half to each side."""
    ranks = stats.rankdata(np.abs(values))
    return float((ranks * np.sign(values)).sum() / ranks.sum())


def holm(p_values: Sequence[float]) -> list[float]:
    """The p values adjusted for their number (Holm 1979), in their order."""
    adjusted, highest = [0.0] * len(p_values), 0.0
    for rank, i in enumerate(sorted(range(len(p_values)), key=lambda i: p_values[i])):
        highest = max(highest, min(1.0, (len(p_values) - rank) * p_values[i]))
        adjusted[i] = highest
    return adjusted


def _values(differences: ArrayLike) -> np.ndarray:
    values = checked("differences", differences, ("n",))
    if len(values) < FEWEST:
        raise InputError(f"differences: expected those of {FEWEST} or more people, got {len(values)}")
    return values


def _varies(values: np.ndarray) -> bool:
    return float(np.ptp(values)) > 1e-12 * max(1.0, float(np.abs(values).max()))
