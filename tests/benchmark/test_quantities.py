"""Quantities of a score: each is defined once, and a new one reaches every output."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark import evaluate as module
from benchmark import quantities
from benchmark.compare import compare, comparison_text
from benchmark.evaluate import align, evaluate, write_per_query
from benchmark.pages import build
from benchmark.protocol import read_protocol
from benchmark.quantities import HEADLINE, MEDIAN, MILLIMETRE, QUANTITIES, Quantity
from benchmark.report import json_text, score_text
from benchmark.score import Scores
from benchmark.summary import summarise
from kit1000.metrics import Seatings
from kit1000.pose import Pose
from kit1000.submission.manifest import Manifest, write_manifest
from tests.samples.board import GUESS, PREDICTIONS, SNAPS, provenance
from tests.samples.submissions import goal_of, made_up, predictions

TOY = Quantity("toy_mm", "Toy error", MILLIMETRE, "A quantity made for this test", "toy", HEADLINE | MEDIAN)


@pytest.fixture
def toy(monkeypatch: pytest.MonkeyPatch) -> None:
    """A quantity more, measured by a function of the poses: twice the height of the motion."""
    measure = module.pose_quantities

    def with_toy(queries: Any, motions: Pose, rotation_only: bool) -> dict[str, np.ndarray]:
        return measure(queries, motions, rotation_only) | {TOY.key: 2e3 * motions.xyz[:, 2]}

    def seatings(predicted: Pose, truths: list[Any], *_: Any) -> Seatings:
        bits, depth = np.zeros(len(truths), bool), np.zeros(len(truths))
        return Seatings(bits, bits.copy(), depth, depth.copy(), depth.copy(), bits.copy(), bits.copy())

    monkeypatch.setattr(quantities, "QUANTITIES", (*QUANTITIES, TOY))
    monkeypatch.setattr(module, "pose_quantities", with_toy)
    monkeypatch.setattr(module, "seatings", seatings)


def scored(manifest: Manifest, shift: float) -> Scores:
    """Scores of the goals of made-up queries, shifted upwards [m]."""
    queries = made_up(12)
    motions = [Pose.from_translation((0, 0, shift)) @ goal_of(truth) for truth in queries.truths]
    rows = evaluate(queries, align(predictions(queries.query_ids, motions), queries))
    protocol = read_protocol()
    return Scores(rows, provenance(manifest, protocol) | summarise(rows, protocol, False))


@pytest.mark.usefixtures("toy")
def test_a_new_quantity_reaches_every_output(tmp_path: Path) -> None:
    a, b = scored(SNAPS, 0.001), scored(GUESS, 0.027)
    row = a.summary["tracks"]["snap"][TOY.key]
    assert set(row) == {"mean", "median", "ci95"}
    assert TOY.key in a.summary["breakdown"]["snap"]["tilt"]["0-5"]
    assert TOY.key in a.summary["tracks"]["snap"]["worst"][0]

    write_per_query(tmp_path / "rows.csv", a.rows)
    with (tmp_path / "rows.csv").open(encoding="utf-8") as file:
        written = [float(line[TOY.key]) for line in csv.DictReader(file)]
    assert np.mean(written) == pytest.approx(row["mean"])

    assert score_text(a.summary, with_breakdown=True).count("toy error mm") == 2
    comparison = compare(a, b)
    assert comparison.tracks["snap"].differences[TOY.key] is not None
    assert "toy error mm" in comparison_text(comparison)

    for name, manifest, scores in (("a", SNAPS, a), ("b", GUESS, b)):
        write_manifest(tmp_path / "s" / name / "manifest.toml", manifest)
        (tmp_path / "s" / name / "predictions.csv").write_bytes(PREDICTIONS)
        (tmp_path / "s" / name / "scores.json").write_text(json_text(scores.summary), encoding="utf-8")
    build(tmp_path / "s", tmp_path / "site")
    board, page = ((tmp_path / "site" / name).read_text("utf-8") for name in ("index.html", "methods/a.html"))
    mean = json_number(row["mean"])
    for text in (board, page):
        assert "Toy error" in text
        assert f'data-value="{mean}"' in text
    assert f"{TOY.name}, median, mm" in board
    assert page.count('<th scope="col" class="num">Toy error<small>mm</small></th>') == 3  # groups and two lists


def json_number(value: float) -> float:
    """A number as scores.json has it."""
    return float(json_text(value))


def test_keys_and_names_are_unique() -> None:
    for field in ("key", "name"):
        values = [getattr(quantity, field) for quantity in QUANTITIES]
        assert len(set(values)) == len(values)


def test_a_quantity_without_a_measurement_is_a_fault_of_the_code(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(quantities, "QUANTITIES", (*QUANTITIES, TOY))
    queries = made_up(3, "curves")
    with pytest.raises(Exception, match="quantities missing or too many: toy_mm"):
        evaluate(queries, align(predictions(queries.query_ids, map(goal_of, queries.truths)), queries))


def test_a_rate_is_shown_in_percent_and_a_mean_in_its_unit() -> None:
    rate = {"seated": {"rate": 0.5, "ci95": [0.4, 0.6]}}
    assert quantities.SEATED.estimate(rate) == (50.0, (40.0, 60.0))
    assert quantities.SEATED.estimate({"seated": None}) == (None, None)
    mean = {"position_mm": {"mean": 1.5, "median": 1.0, "ci95": [1.0, 2.0]}}
    assert quantities.POSITION.estimate(mean) == (1.5, (1.0, 2.0))
    assert quantities.POSITION.median(mean) == 1.0
    assert [quantity.heading for quantity in quantities.shown_in("text")] == [
        "position mm", "rotation deg", "MSSD mm", "seated %", "strict %", "time s",
    ]  # fmt: skip
    assert replace(TOY, outputs=frozenset()).heading == "toy error mm"
