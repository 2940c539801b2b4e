"""Runs that are stopped and watched: a checkpoint at the signal, lines in log files, no foreign file replaced."""

from __future__ import annotations

import os
import signal
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

from baselines.training.batches import Batch
from baselines.training.checkpoint import read_state
from baselines.training.loop import TrainConfig, train
from kit1000.errors import InputError
from kit1000.rng import stream

CPU = torch.device("cpu")
CONFIG = TrainConfig(
    steps=12, batch=4, learning_rate=0.05, warmup=2, validate_every=6, checkpoint_every=250, workers=0, threads=1
)


@dataclass
class Product:
    """A toy: the product of two numbers; a signal comes at one of its losses."""

    signal_at: tuple[int, ...] = ()
    number: int = signal.SIGINT
    losses: int = 0

    def __post_init__(self) -> None:
        with torch.random.fork_rng():
            torch.manual_seed(0)
            self.model: Any = nn.Sequential(nn.Linear(2, 8), nn.Tanh(), nn.Linear(8, 1))

    def example(self, rng: np.random.Generator) -> dict[str, np.ndarray]:
        x = rng.uniform(-1, 1, 2).astype(np.float32)
        return {"x": x, "y": x.prod(keepdims=True)}

    def validation_keys(self) -> range:
        return range(5)

    def validation_example(self, key: int) -> dict[str, np.ndarray]:
        return self.example(stream(0, "check", key))

    def loss(self, batch: Batch) -> torch.Tensor:
        self.losses += 1
        for _ in range(self.signal_at.count(self.losses)):
            os.kill(os.getpid(), self.number)
        return (self.model(batch["x"]) - batch["y"]).square().mean()

    def measure(self, batch: Batch) -> Batch:
        return {"error": (self.model(batch["x"]) - batch["y"])[:, 0].abs()}


def step_kept(folder: Path) -> int:
    return read_state(folder / "checkpoint.pt")["progress"]["step"]


def weights(folder: Path) -> bytes:
    return (folder / "best.safetensors").read_bytes()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("workers", [0, 1])
def test_a_signal_writes_a_checkpoint_at_the_step_that_it_meets(
    number: int, workers: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = replace(CONFIG, workers=workers)
    train(Product(), config, tmp_path / "whole", device=CPU)
    with pytest.raises(KeyboardInterrupt):
        train(Product((4,), number), config, tmp_path / "parts", device=CPU)
    assert step_kept(tmp_path / "parts") == 4
    told = capsys.readouterr().err
    assert "stopping after this step, with a checkpoint" in told
    assert "the same command continues from step 4" in told
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    result = train(Product(), config, tmp_path / "parts", device=CPU)
    assert (result.stopped_by, result.step) == ("steps", 12)
    assert weights(tmp_path / "parts") == weights(tmp_path / "whole")


def test_a_second_signal_stops_at_once_and_says_from_where_it_goes_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(KeyboardInterrupt):
        train(Product((5, 5)), replace(CONFIG, checkpoint_every=3), tmp_path, device=CPU)
    assert step_kept(tmp_path) == 3
    assert "the same command continues from step 3" in capsys.readouterr().err


def test_a_log_file_gets_a_line_for_each_validation(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    train(Product(), CONFIG, tmp_path, device=CPU)
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("training: step")]
    assert [line.split(",")[0] for line in lines] == ["training: step 6 of 12", "training: step 12 of 12"]
    assert all(", error " in line for line in lines)


def test_the_steps_of_a_run_cannot_be_changed(tmp_path: Path) -> None:
    train(Product(), CONFIG, tmp_path, device=CPU)
    with pytest.raises(InputError, match="steps 12, now 20"):
        train(Product(), replace(CONFIG, steps=20), tmp_path, device=CPU)


@pytest.mark.parametrize("name", ["log.jsonl", "best.json", "curve.svg", "checkpoint.pt"])
def test_files_of_another_origin_are_never_replaced(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text("mine")
    with pytest.raises(
        InputError, match=rf"holds {name}, but no config.json of a run; it stays: choose another folder"
    ):
        train(Product(), CONFIG, tmp_path, device=CPU)
    assert (tmp_path / name).read_text() == "mine"
