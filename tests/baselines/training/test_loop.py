"""The training loop: it learns, resumes after any stop or kill with the same results, and depends on no worker."""

from __future__ import annotations

import json
import os
import pickle
import signal
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn

from baselines.training import loop
from baselines.training.batches import TrainingSet
from baselines.training.loop import Batch, TrainConfig, read_checkpoint, train
from kit1000.errors import InputError
from kit1000.files import locked
from kit1000.perception.networks.weight_files import copied_state, load_into, load_weights
from kit1000.rng import stream

CPU = torch.device("cpu")
CONFIG = TrainConfig(
    steps=12, batch=4, learning_rate=0.05, warmup=2, validate_every=3, checkpoint_every=4, workers=0, threads=1, seed=5
)
FILES = ["best.json", "best.safetensors", "checkpoint.pt", "config.json", "log.jsonl"]


class Killed(Exception):
    """Stands for the death of the process."""


def network(drop: float) -> nn.Sequential:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        return nn.Sequential(nn.Linear(2, 8), nn.Tanh(), nn.Dropout(drop), nn.Linear(8, 1))


@dataclass
class Product:
    """A toy: the product of two numbers."""

    model: Any = field(default_factory=lambda: network(0.2))
    dies_at: int | None = None
    """Number of losses after which it raises Killed."""
    signal_at: tuple[int, ...] = ()
    """Losses at which a signal comes, one for each mention."""
    number: int = signal.SIGINT
    losses: int = 0
    measured: list[float] = field(default_factory=list)
    """The measure of each validation, for ScriptedMeasure."""

    def example(self, rng: np.random.Generator) -> dict[str, np.ndarray]:
        x = rng.uniform(-1, 1, 2).astype(np.float32)
        return {"x": x, "y": x.prod(keepdims=True)}

    def validation_keys(self) -> range:
        return range(7)

    def validation_example(self, key: int) -> dict[str, np.ndarray]:
        return self.example(stream(0, "check", key))

    def loss(self, batch: Batch) -> torch.Tensor:
        if self.losses == self.dies_at:
            raise Killed
        self.losses += 1
        for _ in range(self.signal_at.count(self.losses)):
            os.kill(os.getpid(), self.number)
        return (self.model(batch["x"]) - batch["y"]).square().mean()

    def measure(self, batch: Batch) -> Batch:
        assert not self.model.training
        assert not torch.is_grad_enabled()
        error = (self.model(batch["x"]) - batch["y"])[:, 0].abs()
        return {"error": error, "error_squared": error.square()}


@dataclass
class ScriptedMeasure(Product):
    """A toy with given measures."""

    def measure(self, batch: Batch) -> Batch:
        self.validated = getattr(self, "validated", 0) + len(batch["x"])
        return {"error": torch.full((len(batch["x"]),), self.measured[(self.validated - 1) // 7])}


def rows(folder: Path) -> list[dict[str, Any]]:
    """The log without the seconds."""
    lines = [json.loads(line) for line in (folder / "log.jsonl").read_text("utf-8").splitlines()]
    return [{name: value for name, value in line.items() if name != "seconds"} for line in lines]


def results(folder: Path) -> tuple[dict[str, bytes], list[dict[str, Any]]]:
    """All tensors of the checkpoint and of the best weights, to the bit, and the log."""
    state = read_checkpoint(folder / "checkpoint.pt")
    optimizer = {f"{i}.{k}": value for i, kinds in state["optimizer"]["state"].items() for k, value in kinds.items()}
    groups = {**{part: state[part] for part in ("model", "average")}, "optimizer": optimizer}
    groups["best"] = load_weights(folder / "best")[0]
    tensors = {f"{part}.{name}": t.numpy().tobytes() for part, named in groups.items() for name, t in named.items()}
    return tensors, rows(folder)


def uninterrupted(config: TrainConfig, folder: Path) -> tuple[dict[str, bytes], list[dict[str, Any]]]:
    """The results of a run without interruption."""
    train(Product(), config, folder, device=CPU)
    return results(folder)


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("plain")
    uninterrupted(CONFIG, folder)
    return folder


def test_it_learns(tmp_path: Path) -> None:
    task = Product(network(0.0))
    config = replace(CONFIG, steps=200, batch=16, validate_every=50, checkpoint_every=100)
    result = train(task, config, tmp_path, device=CPU)
    assert result.stopped_by == "steps"
    assert result.measures["error"]["median"] < 0.05
    losses = [row["loss"] for row in rows(tmp_path)]
    assert losses[-1] < 0.1 * losses[0]


def test_a_run_writes_its_files(plain: Path) -> None:
    assert sorted(path.name for path in plain.iterdir() if path.name != ".lock") == FILES
    assert [row["step"] for row in rows(plain)] == [3, 6, 9, 12]
    assert list(rows(plain)[0]["measures"]) == ["error", "error_squared"]  # the first one selects the best weights


def test_the_best_weights_are_those_with_the_smallest_median(plain: Path) -> None:
    best = min(rows(plain), key=lambda row: row["measures"]["error"]["median"])
    tensors, info = load_weights(plain / "best")
    assert (info["step"], info["measures"]) == (best["step"], best["measures"])
    task = Product()
    load_into(task.model, tensors, "best")
    task.model.eval()
    with torch.no_grad():
        examples = [task.validation_example(key) for key in task.validation_keys()]
        batch = {name: torch.tensor(np.stack([example[name] for example in examples])) for name in ("x", "y")}
        error = task.measure(batch)["error"]
    assert float(error.median()) == pytest.approx(best["measures"]["error"]["median"], rel=1e-6)
    assert float(error.mean()) == pytest.approx(best["measures"]["error"]["mean"], rel=1e-6)


@given(deaths=st.lists(st.integers(0, 9), min_size=1, max_size=3), ema_decay=st.sampled_from([None, 0.9]))
@settings(max_examples=10)
def test_a_run_resumes_after_any_kills_to_the_bit(
    tmp_path_factory: pytest.TempPathFactory, deaths: list[int], ema_decay: float | None
) -> None:
    config = replace(CONFIG, ema_decay=ema_decay, clip=0.5, weight_decay=0.1)
    folder = tmp_path_factory.mktemp("killed")
    for dies_at in deaths:
        try:
            train(Product(dies_at=dies_at), config, folder, device=CPU)
        except Killed:
            continue
    train(Product(), config, folder, device=CPU)
    assert results(folder) == uninterrupted(config, tmp_path_factory.mktemp("uninterrupted"))


@pytest.mark.parametrize("dies_in", ["validation", "log", "best", "checkpoint"])
def test_a_kill_while_files_are_written_changes_nothing(
    tmp_path: Path, plain: Path, monkeypatch: pytest.MonkeyPatch, dies_in: str
) -> None:
    name = {"validation": "validate", "log": "_log", "best": "save_weights", "checkpoint": "write_bytes"}[dies_in]
    calls, real = [0], getattr(loop, name)

    def deadly(*args: Any, **kwargs: Any) -> Any:
        calls[0] += 1
        if calls[0] == 2:
            raise Killed
        return real(*args, **kwargs)

    monkeypatch.setattr(loop, name, deadly)
    with pytest.raises(Killed):
        train(Product(), CONFIG, tmp_path, device=CPU)
    train(Product(), CONFIG, tmp_path, device=CPU)
    assert results(tmp_path) == results(plain)


def test_workers_and_the_checkpoint_interval_change_nothing(tmp_path: Path, plain: Path) -> None:
    assert uninterrupted(replace(CONFIG, workers=2, checkpoint_every=5), tmp_path) == results(plain)


def test_workers_that_are_spawned_get_no_network() -> None:
    data = pickle.loads(pickle.dumps(TrainingSet(Product(), 5, 4)))
    assert data.task.model is None
    assert data[9]["x"].equal(TrainingSet(Product(), 5, 4)[9]["x"])


def test_a_finished_run_is_not_changed(plain: Path) -> None:
    before = {path.name: path.read_bytes() for path in plain.iterdir()}
    task = Product(dies_at=0)
    result = train(task, CONFIG, plain, device=CPU)
    assert (result.stopped_by, result.step) == ("steps", 12)
    assert result.best_step == load_weights(plain / "best")[1]["step"]
    assert {path.name: path.read_bytes() for path in plain.iterdir()} == before
    groups = read_checkpoint(plain / "checkpoint.pt")
    assert all(groups["model"][name].equal(value) for name, value in copied_state(task.model).items())


def test_the_random_state_and_the_threads_of_the_caller_are_restored(tmp_path: Path) -> None:
    state, threads = torch.get_rng_state(), torch.get_num_threads()
    train(Product(), replace(CONFIG, threads=threads + 1), tmp_path, device=CPU)
    assert torch.get_rng_state().equal(state)
    assert torch.get_num_threads() == threads


@pytest.mark.parametrize(
    ("config", "about", "difference"),
    [
        (replace(CONFIG, learning_rate=0.01), {"net": {"wide": 8}}, "learning_rate 0.05, now 0.01"),
        (CONFIG, {"net": {"wide": 9}}, "net.wide 8, now 9"),
        (CONFIG, {"net": {"wide": 8}, "data": "x"}, "data None, now 'x'"),
    ],
)
def test_a_folder_of_another_run_is_refused(
    tmp_path: Path, config: TrainConfig, about: dict[str, Any], difference: str
) -> None:
    with pytest.raises(Killed):
        train(Product(dies_at=2), CONFIG, tmp_path, {"net": {"wide": 8}}, device=CPU)
    with pytest.raises(InputError) as error:
        train(Product(), config, tmp_path, about, device=CPU)
    assert str(error.value).startswith(f"{tmp_path}: ")
    assert difference in str(error.value)


def test_a_folder_is_written_by_one_run_at_a_time(tmp_path: Path) -> None:
    with locked(tmp_path), pytest.raises(InputError, match="is being written by another process"):
        train(Product(), CONFIG, tmp_path, device=CPU)


def copied(plain: Path, folder: Path) -> Path:
    for path in plain.iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    return folder


@pytest.mark.parametrize("share", [0.0, 0.001, 0.5, 0.99])
def test_a_damaged_checkpoint_is_refused(tmp_path: Path, plain: Path, share: float) -> None:
    path = copied(plain, tmp_path) / "checkpoint.pt"
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(InputError, match=r"checkpoint\.pt: damaged.*delete it to begin anew"):
        train(Product(), CONFIG, tmp_path, device=CPU)
    path.unlink()
    train(Product(), CONFIG, tmp_path, device=CPU)
    assert results(tmp_path) == results(plain)


def test_a_checkpoint_that_would_run_code_is_refused(tmp_path: Path, plain: Path) -> None:
    path = copied(plain, tmp_path) / "checkpoint.pt"
    torch.save({"settings": Product()}, path)
    with pytest.raises(InputError, match="damaged, or no checkpoint"):
        train(Product(), CONFIG, tmp_path, device=CPU)


def test_a_checkpoint_of_another_network_is_refused(tmp_path: Path, plain: Path) -> None:
    copied(plain, tmp_path)
    with pytest.raises(InputError, match=r"0\.weight has the shape \(8, 2\), in this network \(9, 2\)"):
        train(Product(nn.Sequential(nn.Linear(2, 9), nn.Tanh(), nn.Dropout(), nn.Linear(9, 1))), CONFIG, tmp_path)


def test_a_log_that_lost_rows_is_not_continued(tmp_path: Path, plain: Path) -> None:
    log = copied(plain, tmp_path) / "log.jsonl"
    log.write_bytes(log.read_bytes()[:-5])
    with pytest.raises(InputError, match="shorter than when the checkpoint was written"):
        train(Product(), CONFIG, tmp_path, device=CPU)


def test_it_stops_at_the_time_limit_and_resumes(tmp_path: Path, plain: Path) -> None:
    short = replace(CONFIG, time_limit_s=0.0)
    calls = [train(Product(), short, tmp_path, device=CPU) for _ in range(CONFIG.steps)]
    assert [call.step for call in calls] == list(range(1, 13))
    assert [call.stopped_by for call in calls] == ["time"] * 11 + ["steps"]
    assert results(tmp_path) == results(plain)


def test_a_loss_or_measure_that_is_not_finite_ends_the_run(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="step 3: error is not finite for 7 examples"):
        train(ScriptedMeasure(measured=[float("nan")]), CONFIG, tmp_path / "measure", device=CPU)
    task = Product()
    task.model[0].weight.data.fill_(float("nan"))
    with pytest.raises(InputError, match="step 3: the loss is no longer finite"):
        train(task, CONFIG, tmp_path / "loss", device=CPU)
    assert not (tmp_path / "loss/checkpoint.pt").exists()


def test_with_an_ema_the_best_weights_are_the_average(tmp_path: Path) -> None:
    train(Product(), replace(CONFIG, ema_decay=0.9, validate_every=12), tmp_path, device=CPU)
    groups = read_checkpoint(tmp_path / "checkpoint.pt")
    best, _ = load_weights(tmp_path / "best")
    assert all(best[name].equal(value) for name, value in groups["average"].items())
    assert not any(best[name].equal(value) for name, value in groups["model"].items())


def test_the_ema_follows_its_recurrence(tmp_path: Path) -> None:
    config, average = replace(CONFIG, ema_decay=0.2, time_limit_s=0.0), copied_state(Product().model)
    for keep in (1 / 10, 2 / 11, 0.2, 0.2):  # a step each
        train(Product(), config, tmp_path, device=CPU)
        groups = read_checkpoint(tmp_path / "checkpoint.pt")
        average = {name: keep * value + (1 - keep) * groups["model"][name] for name, value in average.items()}
        for name, value in groups["average"].items():
            torch.testing.assert_close(value, average[name])


WATCHED = replace(CONFIG, validate_every=6, checkpoint_every=250)


def step_kept(folder: Path) -> int:
    return read_checkpoint(folder / "checkpoint.pt")["progress"]["step"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("workers", [0, 1])
def test_a_signal_writes_a_checkpoint_at_the_step_that_it_meets(
    number: int, workers: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config, before = replace(WATCHED, workers=workers), signal.getsignal(signal.SIGINT)  # a shell may ignore it
    train(Product(), config, tmp_path / "whole", device=CPU)
    with pytest.raises(KeyboardInterrupt):
        train(Product(signal_at=(4,), number=number), config, tmp_path / "parts", device=CPU)
    assert step_kept(tmp_path / "parts") == 4
    told = capsys.readouterr().err
    assert "stopping after this step, with a checkpoint" in told
    assert "the same command continues from step 4" in told
    assert signal.getsignal(signal.SIGINT) is before
    result = train(Product(), config, tmp_path / "parts", device=CPU)
    assert (result.stopped_by, result.step) == ("steps", 12)
    assert results(tmp_path / "parts") == results(tmp_path / "whole")


def test_a_second_signal_stops_at_once_and_says_from_where_it_goes_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(KeyboardInterrupt):
        train(Product(signal_at=(5, 5)), replace(WATCHED, checkpoint_every=3), tmp_path, device=CPU)
    assert step_kept(tmp_path) == 3
    assert "the same command continues from step 3" in capsys.readouterr().err


def test_a_log_file_gets_a_line_for_each_validation(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    train(Product(), WATCHED, tmp_path, device=CPU)
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("training: step")]
    assert [line.split(",")[0] for line in lines] == ["training: step 6 of 12", "training: step 12 of 12"]
    assert all(", error " in line for line in lines)


@pytest.mark.parametrize("name", ["log.jsonl", "best.json", "checkpoint.pt"])
def test_files_of_another_origin_are_never_replaced(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text("mine")
    with pytest.raises(
        InputError, match=rf"holds {name}, but no config.json of a run; it stays: choose another folder"
    ):
        train(Product(), CONFIG, tmp_path, device=CPU)
    assert (tmp_path / name).read_text() == "mine"


def test_the_learning_rate_rises_then_falls() -> None:
    config = TrainConfig(steps=110, warmup=10, learning_rate=1.0)
    rates = [config.learning_rate_at(step) for step in range(110)]
    assert rates[:11] == pytest.approx([(i + 1) / 11 for i in range(10)] + [1.0])
    assert rates[60] == pytest.approx(0.5)
    assert np.all(np.diff(rates[10:]) < 0)
    assert 0 < rates[-1] < 1e-3
    assert replace(config, decay="linear").learning_rate_at(85) == pytest.approx(0.25)
    assert replace(config, decay="none").learning_rate_at(109) == 1.0


INVALID = {"steps": 0, "batch": -1, "learning_rate": 0.0, "ema_decay": 1.0, "clip": 0.0, "workers": -1}


@pytest.mark.parametrize(("name", "value"), INVALID.items())
def test_invalid_numbers_are_refused(name: str, value: Any) -> None:
    with pytest.raises(InputError, match=f"{name}: expected"):
        TrainConfig(**{name: value})
