"""Shipped weights: their origin and their log."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from baselines.catalog import WEIGHTS, all_methods, all_networks, weights_folder
from baselines.training.shipping import ship
from benchmark.protocol import read_protocol
from kit1000.errors import InputError
from kit1000.generation.plan import DATA_VERSION
from kit1000.perception.networks.weight_files import LARGEST, load_weights, save_weights
from kit1000.weights import WEIGHTS as LIBRARY_WEIGHTS

FOLDERS = (WEIGHTS, LIBRARY_WEIGHTS)
SHIPPED = sorted({path.stem for folder in FOLDERS for path in folder.glob("*.json")})


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


def test_every_method_has_its_weights_and_none_are_unused() -> None:
    assert {path.name for method in all_methods().values() for path in method.weights.values()} <= set(SHIPPED)
    paths = [path for method in all_methods().values() for path in method.weights.values()]
    assert all(path.parent == weights_folder(path.name) for path in paths)
    files = {path.stem for folder in FOLDERS for path in folder.glob("*.safetensors")}
    assert files == set(SHIPPED) <= set(all_networks())
    assert LARGEST == 16 * 2**20
