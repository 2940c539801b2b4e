"""Shipped weights: their origin, their log and its curve."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from baselines.catalog import WEIGHTS, all_methods, all_networks, weights_folder
from baselines.training.curve import curve
from baselines.training.shipping import ship, whole_log
from benchmark.protocol import read_protocol
from kit1000.errors import InputError
from kit1000.generation.plan import DATA_VERSION
from kit1000.perception.networks.weight_files import LARGEST, load_weights, save_weights
from kit1000.pictures.charts import BOTTOM, HEIGHT, LEFT, RIGHT, TOP, WIDTH
from kit1000.weights import WEIGHTS as LIBRARY_WEIGHTS
from tests.samples.checkout import ROOT

FOLDERS = (WEIGHTS, LIBRARY_WEIGHTS)
SHIPPED = sorted({path.stem for folder in FOLDERS for path in folder.glob("*.json")})

DRAWN = [name for name in SHIPPED if (ROOT / f"docs/pictures/{name}.svg").is_file()]


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A folder as `train` writes it."""
    folder = tmp_path / "run"
    folder.mkdir()
    save_weights(folder / "best", torch.nn.Linear(3, 2), {"about": {"name": "some-network"}, "step": 20})
    rows = [{"step": step, "loss": 1 / step, "measures": {}} for step in (10, 20)]
    (folder / "log.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    return folder


def test_weights_are_shipped_with_commit_and_log(run: Path, tmp_path: Path) -> None:
    stem = ship(run, lambda _: tmp_path / "weights", "0123abc")
    assert stem == tmp_path / "weights/some-network"
    tensors, info = load_weights(stem)
    best, _ = load_weights(run / "best")
    assert all(torch.equal(tensors[name], best[name]) for name in best)
    assert info["commit"] == "0123abc"
    assert [row["step"] for row in info["log"]] == [10, 20]


def test_the_log_of_weights_that_started_from_others_goes_on() -> None:
    first = {"about": {}, "log": [{"step": 5, "seconds": 1.0, "loss": 3.0}, {"step": 9, "seconds": 2.0, "loss": 2.0}]}
    second = {"about": {"start": first}, "log": [{"step": 4, "seconds": 0.5, "loss": 1.0}]}
    third = {"about": {"start": second}, "log": [{"step": 1, "seconds": 0.5, "loss": 0.5}]}
    rows = whole_log(third)
    assert [(row["step"], row["seconds"], row["loss"]) for row in rows] == [
        (5, 1.0, 3.0),
        (9, 2.0, 2.0),
        (13, 2.5, 1.0),
        (14, 3.0, 0.5),
    ]
    assert whole_log(first) == first["log"]


def test_halved_weights_are_rounded_to_float16(run: Path, tmp_path: Path) -> None:
    tensors, info = load_weights(ship(run, lambda _: tmp_path / "weights", "0123abc", precision="float16"))
    best, _ = load_weights(run / "best")
    assert all(torch.equal(tensors[name], best[name].half().float()) for name in best)
    assert info["step"] == 20


def test_missing_and_too_large_weights_are_refused(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"best\.json"):
        ship(tmp_path, lambda _: tmp_path / "weights", "")
    monkeypatch.setattr("baselines.training.shipping.LARGEST", 10)
    with pytest.raises(InputError, match="MiB of weights, more than"):
        ship(run, lambda _: tmp_path / "weights", "")
    assert not (tmp_path / "weights").exists()


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_weights_name_their_origin(name: str) -> None:
    _, info = load_weights(weights_folder(name) / name)
    assert name in all_networks()
    assert (weights_folder(name) / f"{name}.safetensors").stat().st_size <= LARGEST
    assert info["about"]["name"] == name
    if info["about"]["dataset_id"] != read_protocol().dataset["id"]:  # then all of its methods say so
        users = [m for m in all_methods().values() if weights_folder(name) / name in m.weights.values()]
        assert all("data version" in method.training_data for method in users)
    assert len(info["commit"]) == 40
    assert info["seconds"] > 0
    assert info["log"][-1]["step"] <= info["train"]["steps"]


@pytest.mark.parametrize("name", ["completion-d415", "restoration", "restoration-unmasked", "segmentation"])
def test_networks_for_noisy_images_learned_from_the_sensors_of_the_data(name: str) -> None:
    _, info = load_weights(LIBRARY_WEIGHTS / name)
    made = info["about"].get("data_version") or str(info["about"]["network"]["sensor_model"])  # older weights name this
    assert made.partition(".")[0] == DATA_VERSION.partition(".")[0]


@pytest.mark.parametrize("name", DRAWN)
def test_learning_curves_in_the_docs_are_those_of_the_logs(name: str) -> None:
    _, info = load_weights(weights_folder(name) / name)
    assert (ROOT / f"docs/pictures/{name}.svg").read_text(encoding="utf-8") == curve(whole_log(info))


def test_every_method_has_its_weights_and_none_are_unused() -> None:
    assert {path.name for method in all_methods().values() for path in method.weights.values()} <= set(SHIPPED)
    paths = [path for method in all_methods().values() for path in method.weights.values()]
    assert all(path.parent == weights_folder(path.name) for path in paths)
    files = {path.stem for folder in FOLDERS for path in folder.glob("*.safetensors")}
    assert files == set(SHIPPED) <= set(all_networks())
    assert LARGEST == 16 * 2**20


VALUES = st.floats(1e-9, 1e9) | st.floats(-1e6, -1e-9) | st.just(0.0)


def log(losses: list[float]) -> list[dict[str, Any]]:
    """Rows with these losses and a measure derived from them."""
    return [
        {"step": 50 * (i + 1), "loss": loss, "measures": {"a<b": {"mean": 2 * loss, "median": loss}}}
        for i, loss in enumerate(losses)
    ]


def points_of(text: str) -> list[tuple[float, float]]:
    """Points of all lines, by chart."""
    lines = re.findall(r'class="line stroke-\d"[^>]* d="M([^"h]+)"', text)
    return [(float(x), float(y)) for line in lines for x, y in (point.split() for point in line.split("L"))]


@given(losses=st.lists(VALUES, min_size=1, max_size=8))
def test_every_log_is_drawn_inside_its_frame(losses: list[float]) -> None:
    text = curve(log(losses))
    ElementTree.fromstring(text)
    points = points_of(text)
    assert len(points) == 3 * len(losses)
    assert all(LEFT - 0.01 <= x <= WIDTH - RIGHT + 0.01 for x, _ in points)
    assert all(TOP - 0.01 <= y <= HEIGHT - BOTTOM + 0.01 for _, y in points)
    assert 2 <= text.count('class="rule"') / 2 <= 8


def test_a_log_without_rows_is_an_empty_chart() -> None:
    ElementTree.fromstring(curve([]))
    assert points_of(curve([])) == []


def test_values_over_orders_of_magnitude_have_a_logarithmic_axis() -> None:
    for losses in ([1.0, 0.1, 0.01], [1.0, 0.6, 0.2]):
        (_, first), (_, second), (_, third) = points_of(curve(log(losses)))[:3]
        assert third - second == pytest.approx(second - first, abs=0.02)
