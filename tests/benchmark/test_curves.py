"""Robustness curves: tables against their definition, subsets of queries, and the figure with its numbers."""

from __future__ import annotations

import csv
import json
import runpy
from pathlib import Path
from statistics import fmean, median
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmark.curve_charts import COLUMNS, figure, write_curves
from benchmark.curves import CURVES, curve_table
from benchmark.protocol import read_protocol
from benchmark.score import curve_queries
from kit1000.errors import InputError, ShapeError
from kit1000.queries.guesses import FIXED_LEVELS, LEVELS
from kit1000.queries.tracks import CURVES as TRACK
from kit1000.queries.tracks import curve_levels
from kit1000.rng import stream
from tests.samples.board import LEARNED, SNAPS, curve_ids, write_scored
from tests.samples.checkout import ROOT
from tests.samples.submissions import made_up

IDS = curve_ids(3)
MM = [0, 4, 8, 12, 16, 20, 24, 28]
DEG = [27.5 * level / 7 for level in range(8)]


def drawn_errors(n: int) -> tuple[np.ndarray, np.ndarray]:
    rng = stream(5, "curves")
    return rng.gamma(2, 3, n), rng.gamma(2, 4, n)


def percentile(values: list[float], share: float) -> float:
    """Between the sorted values, by straight lines: written out once more, apart from numpy."""
    ordered, place = sorted(values), share * (len(values) - 1)
    low = int(place)
    high = min(low + 1, len(values) - 1)
    return ordered[low] + (place - low) * (ordered[high] - ordered[low])


def test_levels_are_those_of_the_dataset() -> None:
    table = curve_table(IDS, *drawn_errors(len(IDS)))
    for curve, user, fixed in (("position", MM, DEG), ("rotation", DEG, MM)):
        (user_key, fixed_key) = ("user_mm", "fixed_deg") if curve == "position" else ("user_deg", "fixed_mm")
        found = [(row[fixed_key], row["level"], row[user_key]) for row in table[curve]]
        expected = [(fixed[k], level, user[level]) for k in FIXED_LEVELS for level in range(LEVELS)]
        np.testing.assert_allclose(found, expected, atol=1e-9)


@given(st.integers(0, 2**32 - 1))
def test_every_row_follows_its_definition_in_any_order(seed: int) -> None:
    position, rotation = drawn_errors(len(IDS))
    order = stream(seed, "order").permutation(len(IDS))
    chosen = order[: stream(seed, "kept").integers(1, len(IDS))]
    table = curve_table([IDS[i] for i in chosen], position[chosen], rotation[chosen])
    assert sum(row["n"] for rows in table.values() for row in rows) == len(chosen)
    for curve, varied, errors in (("position", "pos", position), ("rotation", "rot", rotation)):
        levels_left = {curve_levels(IDS[i]) for i in chosen if curve_levels(IDS[i])[0] == varied}
        assert len(table[curve]) == len(levels_left)  # a level without queries has no row
        for row in table[curve]:
            levels, key = (DEG, "fixed_deg") if curve == "position" else (MM, "fixed_mm")
            fixed = int(np.argmin(np.abs(np.array(levels) - row[key])))
            own = [float(errors[i]) for i in chosen if curve_levels(IDS[i]) == (varied, row["level"], fixed)]
            assert row["n"] == len(own)
            statistics = [row[key] for key in ("mean", "median", "p20", "p80")]
            np.testing.assert_allclose(
                statistics, [fmean(own), median(own), percentile(own, 0.2), percentile(own, 0.8)]
            )


def test_a_method_of_rotations_has_no_position_curve_and_its_rotations_stay_the_same() -> None:
    position, rotation = drawn_errors(len(IDS))
    alone = curve_table(IDS, np.full(len(IDS), np.nan), rotation)
    assert alone["rotation"] == curve_table(IDS, position, rotation)["rotation"]
    assert {row["mean"] for row in alone["position"]} == {row["p80"] for row in alone["position"]} == {None}
    assert {row["n"] for row in alone["position"]} == {3}
    assert json.loads(json.dumps(alone, allow_nan=False)) == alone


def test_wrong_ids_and_lengths_are_refused() -> None:
    with pytest.raises(InputError, match="expected one of the curves"):
        curve_table(["test-s0001-p0-snap"], [1.0], [1.0])
    with pytest.raises(ShapeError, match=r"position_mm: expected shape \(2,\)"):
        curve_table(IDS[:2], [1.0], [1.0, 2.0])
    with pytest.raises(InputError, match="at least one method"):
        figure({})


def texts(svg: str) -> str:
    return " | ".join(
        element.text or "" for element in ElementTree.fromstring(svg).iter() if element.tag.endswith("text")
    )


def test_the_figure_of_one_method_has_both_curves_a_line_for_each_fixed_error(tmp_path: Path) -> None:
    write_scored(tmp_path / "snaps", SNAPS, 1.2, 1.5, None)
    picture, numbers = write_curves([tmp_path / "snaps"], tmp_path / "out")
    shown = texts(picture.read_text("utf-8"))
    for text in ("position error of the guess [mm]", "rotation error left [degrees]", "15.7°", "28 mm", "n = 4"):
        assert text in shown
    rows = list(csv.DictReader(numbers.open(encoding="utf-8")))
    assert tuple(rows[0]) == COLUMNS
    assert len(rows) == 2 * LEVELS * len(FIXED_LEVELS)
    table = json.loads((tmp_path / "snaps/scores.json").read_text("utf-8"))["curves"]
    assert [float(row["mean"]) for row in rows] == [row["mean"] for curve in CURVES for row in table[curve.name]]
    assert {row["method"] for row in rows} == {SNAPS.method}


def test_several_methods_share_a_figure_and_the_same_scores_give_the_same_bytes(tmp_path: Path) -> None:
    write_scored(tmp_path / "a", SNAPS, 1.2, 1.5, None)
    write_scored(tmp_path / "b", LEARNED, 3.9, 4.9, None)
    files = [tmp_path / "a", tmp_path / "b/scores.json"]
    first, second = (write_curves(files, tmp_path / name) for name in ("one", "two"))
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in second]
    shown = texts(first[0].read_text("utf-8"))
    assert shown.count("Learned") == 2 * len(FIXED_LEVELS)
    assert shown.count("Snaps <b>well</b>") == 2 * len(FIXED_LEVELS)


def test_a_subset_shows_its_number_of_queries() -> None:
    chosen = [query_id for i, query_id in enumerate(IDS) if i % 5]
    table = curve_table(chosen, *drawn_errors(len(chosen)))
    assert "n = 2 to 3" in texts(figure({"thin": table}))


def test_scores_that_cannot_be_drawn_are_refused_in_one_line(tmp_path: Path) -> None:
    write_scored(tmp_path / "a", SNAPS, 1.2, 1.5, None)
    with pytest.raises(InputError, match="methods of different names"):
        write_curves([tmp_path / "a", tmp_path / "a/scores.json"], tmp_path)
    scores = json.loads((tmp_path / "a/scores.json").read_text("utf-8")) | {"curves": None}
    (tmp_path / "a/scores.json").write_text(json.dumps(scores), encoding="utf-8")
    with pytest.raises(InputError, match="scored without curves"):
        write_curves([tmp_path / "a"], tmp_path)
    (tmp_path / "other.json").write_text("[]", encoding="utf-8")
    with pytest.raises(InputError, match="no scores of a method"):
        write_curves([tmp_path / "other.json"], tmp_path)
    with pytest.raises(InputError, match="no file"):
        write_curves([tmp_path / "nowhere"], tmp_path)


def test_curves_are_of_the_first_scenes_or_of_all_never_of_those_that_are_answered() -> None:
    queries = made_up(12, TRACK)  # a scene each
    ids = queries.query_ids
    for predicted, scenes in (
        ([], 4),
        (ids[:4], 4),
        (ids[2:3], 4),  # the others of the first count as no motion
        (ids[:5], 12),
        (ids[11:], 12),
        (ids, 12),
        (["another-id"], 4),
    ):
        chosen = curve_queries(queries, 4, predicted)
        assert chosen.query_ids == ids[:scenes]


def test_the_protocol_states_the_first_scenes_and_the_scores_the_number_of_scenes() -> None:
    assert read_protocol().curves["first_scenes"] == 10
    for path in sorted((ROOT / "submissions").glob("*/scores.json")):
        stored = json.loads(path.read_text("utf-8"))
        rows = [row for rows in (stored["curves"] or {}).values() for row in rows]
        assert {row["n"] for row in rows} == ({stored["curve_scenes"]} if rows else set())
        assert stored["curve_scenes"] in (10, 40, None)


def test_the_picture_of_the_readme_is_that_of_the_scores() -> None:
    script = runpy.run_path(str(ROOT / "docs" / "pictures" / "curves.py"))
    drawn = script["picture"](script["scored_curves"](ROOT / "submissions"))
    assert (ROOT / "docs" / "pictures" / "curves.svg").read_text(encoding="utf-8") == drawn
