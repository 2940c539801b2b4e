"""Networks by name: each learns on a dataset from the command line, stops on time, and goes on."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from baselines.__main__ import main
from baselines.networks import NETWORKS, TRAINING


def words(name: str, data: Path, out: Path, steps: int) -> list[str]:
    sizes = ["--steps", str(steps), "--batch", "1", "--workers", "0", "--threads", "1"]
    return ["train", name, "--data", str(data), "--out", str(out), *sizes]


def test_every_network_has_a_training_in_both_sizes() -> None:
    assert {(network.finds, preset) for network in NETWORKS.values() for preset in ("small", "paper")} == set(TRAINING)


@pytest.mark.slow
@pytest.mark.parametrize("name", NETWORKS)
def test_a_network_learns_from_the_command_line_and_goes_on(
    name: str, mini: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*words(name, mini, tmp_path, 2), "--time-limit-s", "0"]) == 0
    assert "step 1 (time)" in capsys.readouterr().out
    assert main(words(name, mini, tmp_path, 2)) == 0
    assert "step 2 (steps)" in capsys.readouterr().out
    about = json.loads((tmp_path / "best.json").read_text())["about"]
    assert about["name"] == name
    assert main(words(name, mini, tmp_path, 3)) == 2
    assert "holds a run with steps 2, now 3" in capsys.readouterr().err


def test_a_name_that_is_none_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words("snapnet-position", tmp_path, tmp_path / "run", 1)) == 2
    said = capsys.readouterr().err
    assert "no network 'snapnet-position'" in said
    assert all(name in said for name in NETWORKS)
    assert not (tmp_path / "run").exists()
