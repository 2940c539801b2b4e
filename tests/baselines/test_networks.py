"""The networks of the catalog: each is trained from the command line, stops at a time limit, and resumes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from baselines.__main__ import main
from baselines.catalog import WEIGHTS, all_networks
from kit1000.generation.build import generate
from kit1000.generation.presets import Preset
from kit1000.perception.networks.weight_files import load_weights
from kit1000.predictor import resolved

NETWORKS = all_networks()


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset whose splits for training and validation have queries of all tracks."""
    out = tmp_path_factory.mktemp("trained") / "data"
    generate(Preset("trained", 2, 2, 1, kits=(2, 2), seed=7), out, workers=1)
    return out


def command(name: str, data: Path, out: Path, steps: int) -> list[str]:
    sizes = ["--steps", str(steps), "--batch", "1", "--workers", "0", "--threads", "1"]
    return ["train", name, "--data", str(data), "--out", str(out), *sizes]


@pytest.mark.parametrize("name", NETWORKS)
def test_every_network_has_a_task_and_a_training_for_two_cores(name: str) -> None:
    presets = {"small", "paper", "pretraining", "pretraining-2", "measured", "hard"}
    assert {"small"} <= set(NETWORKS[name].training) <= presets
    assert callable(resolved(NETWORKS[name].make_task))


@pytest.mark.slow
@pytest.mark.parametrize("name", NETWORKS)
def test_a_network_is_trained_from_the_command_line_and_resumes(
    name: str, data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*command(name, data, tmp_path, 2), "--time-limit-s", "0"]) == 0
    assert "step 1 (time)" in capsys.readouterr().out
    assert main(command(name, data, tmp_path, 2)) == 0
    assert "step 2 (steps)" in capsys.readouterr().out
    about = json.loads((tmp_path / "best.json").read_text())["about"]
    assert about["name"] == name
    assert main(command(name, data, tmp_path, 3)) == 2
    assert "holds a run with steps 2, now 3" in capsys.readouterr().err


def test_an_unknown_name_lists_the_networks(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(command("snapnet-places", tmp_path, tmp_path / "run", 1)) == 2
    message = capsys.readouterr().err
    assert "no network 'snapnet-places'" in message
    assert all(name in message for name in NETWORKS)
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_a_network_starts_from_given_weights_and_says_so(
    mini: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    start = WEIGHTS / "snapnet-gtvol-position.safetensors"
    given, info = load_weights(start.with_suffix(""))
    still = [*command("snapnet-gtvol-position", mini, tmp_path, 1), "--start", str(start), "--learning-rate", "1e-12"]
    assert main(still) == 0
    trained, described = load_weights(tmp_path / "best")
    assert described["about"]["start"] == info
    moved = [name for name, value in given.items() if value.is_floating_point() and "running" not in name]
    assert all(torch.allclose(trained[name], given[name], atol=1e-3, rtol=1e-3) for name in moved)
    assert main([*command("snapnet-gtvol-rotation", mini, tmp_path / "other", 1), "--start", str(start)]) == 2
    assert "snapnet-gtvol-position.safetensors: has no " in capsys.readouterr().err
