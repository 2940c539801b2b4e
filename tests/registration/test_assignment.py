"""Which plate a part belongs to: the posterior against a plain sum over assignments, and when other parts are asked."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from kit1000.dataset.reader import Dataset
from kit1000.perception.image_kinds import IDEAL
from kit1000.pose import Pose
from kit1000.registration.geometry.cavity import Cavity
from kit1000.registration.method import FitSearch
from kit1000.registration.predictor import Registration
from kit1000.registration.rank import DOUBTFUL, PLATES_APART, Fit, assigned, least_costs, plate_posterior, ranked
from kit1000.sim.layout import UPRIGHT_SHARE
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL

ODDS = st.tuples(st.integers(1, 4), st.integers(1, 4)).flatmap(
    lambda shape: arrays(float, shape, elements=st.floats(-8, 8))
)
CURVE = IDEAL.right_plate
HALF, SPREAD = CURVE.half, CURVE.spread
REGION = np.ones((3, 3), bool)


def cavity(x: float) -> Cavity:
    """One whose middle is at an x [m]."""
    return cast(Cavity, SimpleNamespace(world_from_plate=Pose.from_translation((x, 0.0, 0.0)), region=REGION))


def fit(x: float, cost: float) -> Fit:
    """One in the plate at an x [m]."""
    candidate: Any = SimpleNamespace(cavity=cavity(x))
    return Fit(Pose.from_translation((x, 0.0, 0.0)), cost, cost, candidate)


def plates(fits: list[Fit]) -> list[float]:
    """The x [m] of the plate of each fit."""
    return [float(each.goal_from_now.xyz[0]) for each in fits]


@given(ODDS)
def test_the_posterior_is_the_share_of_the_assignments_that_give_a_part_the_plate(odds: np.ndarray) -> None:
    parts, found = odds.shape
    likelihood = np.exp(odds)
    likelihood[1:] = UPRIGHT_SHARE * likelihood[1:] + (1 - UPRIGHT_SHARE)
    sums = np.zeros(found + 1)
    for choice in product(range(found + 1), repeat=parts):
        taken = [plate for plate in choice if plate < found]
        if len(set(taken)) == len(taken):
            sums[choice[0]] += np.prod([likelihood[part, plate] for part, plate in enumerate(choice) if plate < found])
    np.testing.assert_allclose(plate_posterior(odds), sums[:found] / sums.sum(), rtol=1e-9)


@given(ODDS, st.randoms())
def test_the_order_of_other_parts_and_of_plates_does_not_matter(odds: np.ndarray, random: Any) -> None:
    others, columns = list(range(1, len(odds))), list(range(odds.shape[1]))
    random.shuffle(others)
    random.shuffle(columns)
    shuffled = plate_posterior(odds[[0, *others]][:, columns])
    np.testing.assert_allclose(shuffled, plate_posterior(odds)[columns], rtol=1e-9)


def test_a_plate_that_another_part_fits_far_better_is_left_to_it() -> None:
    fits = ranked([fit(0.0, HALF - SPREAD), fit(0.1, HALF - 0.5 * SPREAD)])
    assert plates(assigned(fits, [], CURVE)) == [0.0, 0.1]
    other = [fit(0.0, HALF - 6 * SPREAD), fit(0.1, HALF + 6 * SPREAD)]
    assert plates(assigned(fits, [other], CURVE)) == [0.1, 0.0]
    assert plates(assigned(fits, [[fit(0.5, 0.0)]], CURVE)) == [0.0, 0.1]  # in a plate of its own


def test_a_part_that_fits_nowhere_says_nothing() -> None:
    fits = ranked([fit(0.0, HALF - SPREAD), fit(0.1, HALF - 0.5 * SPREAD)])
    assert plates(assigned(fits, [[]], CURVE)) == [0.0, 0.1]
    bad = [fit(0.0, HALF + 20 * SPREAD), fit(0.1, HALF + 20 * SPREAD)]
    assert plates(assigned(fits, [bad], CURVE)) == [0.0, 0.1]


@pytest.mark.parametrize("fits", [[], [fit(0.0, 1e-3)], [fit(0.0, 1e-3), fit(0.1, 1.1e-3 + DOUBTFUL)]])
def test_other_parts_are_not_asked_where_the_plate_is_clear(fits: list[Fit]) -> None:
    def others() -> Iterator[list[Fit]]:
        raise AssertionError("asked")
        yield []

    assert assigned(fits, others(), CURVE) == fits


def test_all_fits_of_the_chosen_plate_come_first_each_in_its_order() -> None:
    fits = ranked([fit(0.0, 1.0e-3), fit(0.1, 1.1e-3), fit(0.0, 1.2e-3), fit(0.1, 1.3e-3)])
    other = [fit(0.0, HALF - 6 * SPREAD), fit(0.1, HALF + 6 * SPREAD)]
    found = assigned(fits, [other], CURVE)
    assert [round(1e4 * each.cost) for each in found] == [11, 13, 10, 12]


def test_a_place_searches_the_other_parts_of_its_image_and_a_snap_does_not(
    mini: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    searched: list[int] = []

    def fits(self: FitSearch) -> list[Fit]:
        part = self.part.query.part
        searched.append(part)
        return [fit(0.0, HALF - 0.1 * part * SPREAD), fit(0.1, HALF)]

    monkeypatch.setattr(FitSearch, "first_fits", fits)
    monkeypatch.setattr(FitSearch, "all_fits", fits)
    data = Dataset(mini)
    scenes = [scene for split in ("train", "val", "test") for scene in data.split(split)]
    for track in ("place", "snap"):
        query = next(query for scene in scenes for query in scene.queries if query.track == track)
        searched.clear()
        Registration(data).fits(query)
        shown = set(np.unique(query.image.labels).tolist()) - {0, ASSEMBLY_LABEL} if track == "place" else set()
        assert {FIRST_PART_LABEL + part for part in searched} == shown | {FIRST_PART_LABEL + query.part}
        assert searched[0] == query.part


def test_a_cavity_is_found_again_within_a_part_of_the_width_of_a_plate() -> None:
    middles = [np.zeros(3), np.array([0.1, 0.0, 0.0])]
    found = [fit(0.1 + 0.5 * PLATES_APART, 2e-3), fit(0.1, 3e-3), fit(0.3, 1e-3)]
    np.testing.assert_array_equal(least_costs(found, middles), [np.inf, 2e-3])
