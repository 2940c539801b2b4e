"""One training loop: it learns, goes on after any kill as if there had been none, and depends on no worker."""

from __future__ import annotations

import json
import multiprocessing
import os
import pickle
import signal
import socket
import time
from dataclasses import dataclass, field, replace
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn

from baselines.training import loop
from baselines.training.batches import _Drawn, train_batches
from baselines.training.checkpoint import fill, load_weights, read_state, stored
from baselines.training.loop import Batch, TrainConfig, train
from kit1000.errors import InputError
from kit1000.files import locked
from kit1000.rng import stream

CPU = torch.device("cpu")
CONFIG = TrainConfig(
    steps=12, batch=4, rate=0.05, warmup=2, check_every=3, checkpoint_every=4, workers=0, threads=1, seed=5
)
FILES = ["best.json", "best.safetensors", "checkpoint.safetensors", "config.json", "curve.svg", "log.jsonl"]


class Killed(Exception):
    """As if the process had died."""


def network(drop: float) -> nn.Sequential:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        return nn.Sequential(nn.Linear(2, 8), nn.Tanh(), nn.Dropout(drop), nn.Linear(8, 1))


@dataclass
class Product:
    """A toy: the product of two numbers."""

    model: Any = field(default_factory=lambda: network(0.2))
    dies_at: int | None = None
    """The loss after which it is as if the process died."""
    losses: int = 0
    measured: list[float] = field(default_factory=list)
    """What to say at each check instead of the truth."""

    def example(self, rng: np.random.Generator) -> dict[str, np.ndarray]:
        x = rng.uniform(-1, 1, 2).astype(np.float32)
        return {"x": x, "y": x.prod(keepdims=True)}

    def check_examples(self) -> range:
        return range(7)

    def check_example(self, key: int) -> dict[str, np.ndarray]:
        return self.example(stream(0, "check", key))

    def loss(self, batch: Batch) -> torch.Tensor:
        if self.losses == self.dies_at:
            raise Killed
        self.losses += 1
        return (self.model(batch["x"]) - batch["y"]).square().mean()

    def measure(self, batch: Batch) -> Batch:
        assert not self.model.training
        assert not torch.is_grad_enabled()
        off = (self.model(batch["x"]) - batch["y"])[:, 0].abs()
        return {"off": off, "off_squared": off.square()}


@dataclass
class Said(Product):
    """A toy whose checks say what they are told to."""

    def measure(self, batch: Batch) -> Batch:
        self.checked = getattr(self, "checked", 0) + len(batch["x"])
        return {"off": torch.full((len(batch["x"]),), self.measured[(self.checked - 1) // 7])}


def rows(folder: Path) -> list[dict[str, Any]]:
    """The log but for the seconds."""
    lines = [json.loads(line) for line in (folder / "log.jsonl").read_text("utf-8").splitlines()]
    return [{name: value for name, value in line.items() if name != "seconds"} for line in lines]


def kept(folder: Path) -> tuple[dict[str, bytes], list[dict[str, Any]]]:
    """All tensors of the checkpoint and of the best weights, to the bit, and the log."""
    parts, _ = read_state(folder / "checkpoint.safetensors")
    parts["best"] = load_weights(folder / "best")[0]
    tensors = {f"{part}.{name}": t.numpy().tobytes() for part, named in parts.items() for name, t in named.items()}
    return tensors, rows(folder)


def whole(config: TrainConfig, folder: Path) -> tuple[dict[str, bytes], list[dict[str, Any]]]:
    """A run at one stretch."""
    train(Product(), config, folder, device=CPU)
    return kept(folder)


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("plain")
    whole(CONFIG, folder)
    return folder


def test_it_learns_what_it_can_see(tmp_path: Path) -> None:
    task = Product(network(0.0))
    config = replace(CONFIG, steps=200, batch=16, check_every=50, checkpoint_every=100)
    trained = train(task, config, tmp_path, device=CPU)
    assert trained.why == "steps"
    assert trained.measures["off"]["median"] < 0.05
    losses = [row["loss"] for row in rows(tmp_path)]
    assert losses[-1] < 0.1 * losses[0]


def test_a_run_leaves_its_files(plain: Path) -> None:
    assert sorted(path.name for path in plain.iterdir() if path.name != ".lock") == FILES
    assert [row["step"] for row in rows(plain)] == [3, 6, 9, 12]
    assert list(rows(plain)[0]["measures"]) == ["off", "off_squared"]  # the first one chooses, so order matters


def test_the_best_weights_are_those_of_the_least_median(plain: Path) -> None:
    best = min(rows(plain), key=lambda row: row["measures"]["off"]["median"])
    tensors, info = load_weights(plain / "best")
    assert (info["step"], info["measures"]) == (best["step"], best["measures"])
    task = Product()
    fill(task.model, tensors, "best")
    task.model.eval()
    with torch.no_grad():
        examples = [task.check_example(key) for key in task.check_examples()]
        batch = {name: torch.tensor(np.stack([example[name] for example in examples])) for name in ("x", "y")}
        off = task.measure(batch)["off"]
    assert float(off.median()) == pytest.approx(best["measures"]["off"]["median"], rel=1e-6)
    assert float(off.mean()) == pytest.approx(best["measures"]["off"]["mean"], rel=1e-6)


@given(deaths=st.lists(st.integers(0, 9), min_size=1, max_size=3), average=st.sampled_from([None, 0.9]))
@settings(max_examples=10)
def test_a_run_goes_on_after_any_kills_to_the_bit(
    tmp_path_factory: pytest.TempPathFactory, deaths: list[int], average: float | None
) -> None:
    config = replace(CONFIG, average=average, clip=0.5, weight_decay=0.1)
    folder = tmp_path_factory.mktemp("killed")
    for dies_at in deaths:
        try:
            train(Product(dies_at=dies_at), config, folder, device=CPU)
        except Killed:
            continue
    train(Product(), config, folder, device=CPU)
    assert kept(folder) == whole(config, tmp_path_factory.mktemp("whole"))


@pytest.mark.parametrize("dies_in", ["check", "log", "best", "checkpoint"])
def test_a_kill_while_files_are_written_changes_nothing(
    tmp_path: Path, plain: Path, monkeypatch: pytest.MonkeyPatch, dies_in: str
) -> None:
    name = {"check": "_measured", "log": "curve", "best": "save_weights", "checkpoint": "write_state"}[dies_in]
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
    assert kept(tmp_path) == kept(plain)


def test_workers_and_how_often_to_keep_change_nothing(tmp_path: Path, plain: Path) -> None:
    assert whole(replace(CONFIG, workers=2, checkpoint_every=5), tmp_path) == kept(plain)


def test_a_run_may_go_on_with_other_workers(tmp_path: Path, plain: Path) -> None:
    with pytest.raises(Killed):
        train(Product(dies_at=5), CONFIG, tmp_path, device=CPU)
    assert whole(replace(CONFIG, workers=1, time_limit_s=100.0), tmp_path) == kept(plain)


def test_an_example_is_drawn_by_seed_step_and_place_alone() -> None:
    task = Product()
    batches = list(train_batches(task, 5, 4, range(2, 4), range(1, 4, 2), 0, CPU))
    for step, batch in zip((2, 3), batches, strict=True):
        assert batch["x"].tolist() == [task.example(stream(5, "train", step, i))["x"].tolist() for i in (1, 3)]


def test_workers_that_are_spawned_get_no_network() -> None:
    data = pickle.loads(pickle.dumps(_Drawn(Product(), 5, 4)))
    assert data.task.model is None
    assert data[9]["x"].equal(_Drawn(Product(), 5, 4)[9]["x"])


def test_a_finished_run_is_left_as_it_is(plain: Path) -> None:
    before = {path.name: path.read_bytes() for path in plain.iterdir()}
    task = Product(dies_at=0)
    trained = train(task, CONFIG, plain, device=CPU)
    assert (trained.why, trained.step) == ("steps", 12)
    assert trained.best_step == load_weights(plain / "best")[1]["step"]
    assert {path.name: path.read_bytes() for path in plain.iterdir()} == before
    parts, _ = read_state(plain / "checkpoint.safetensors")
    assert all(parts["model"][name].equal(value) for name, value in stored(task.model).items())


def test_the_random_state_and_the_threads_of_the_caller_are_left_alone(tmp_path: Path) -> None:
    state, threads = torch.get_rng_state(), torch.get_num_threads()
    train(Product(), replace(CONFIG, threads=threads + 1), tmp_path, device=CPU)
    assert torch.get_rng_state().equal(state)
    assert torch.get_num_threads() == threads


@pytest.mark.parametrize(
    ("config", "about", "said"),
    [
        (replace(CONFIG, rate=0.01), {"net": {"wide": 8}}, "rate 0.05, now 0.01"),
        (CONFIG, {"net": {"wide": 9}}, "net.wide 8, now 9"),
        (CONFIG, {"net": {"wide": 8}, "data": "x"}, "data None, now 'x'"),
    ],
)
def test_a_folder_of_another_run_is_refused(
    tmp_path: Path, config: TrainConfig, about: dict[str, Any], said: str
) -> None:
    with pytest.raises(Killed):
        train(Product(dies_at=2), CONFIG, tmp_path, {"net": {"wide": 8}}, device=CPU)
    with pytest.raises(InputError) as error:
        train(Product(), config, tmp_path, about, device=CPU)
    assert str(error.value) == f"{tmp_path}: holds a run with {said}; choose another folder, or delete this one"


def test_a_folder_is_written_by_one_run_at_a_time(tmp_path: Path) -> None:
    with locked(tmp_path), pytest.raises(InputError, match="is being written by another process"):
        train(Product(), CONFIG, tmp_path, device=CPU)


def copied(plain: Path, folder: Path) -> Path:
    for path in plain.iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    return folder


def test_a_damaged_checkpoint_says_so(tmp_path: Path, plain: Path) -> None:
    path = copied(plain, tmp_path) / "checkpoint.safetensors"
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(InputError, match=r"checkpoint\.safetensors: damaged: delete it to begin anew"):
        train(Product(), CONFIG, tmp_path, device=CPU)
    path.unlink()
    train(Product(), CONFIG, tmp_path, device=CPU)
    assert kept(tmp_path) == kept(plain)


def test_a_checkpoint_of_another_network_is_refused(tmp_path: Path, plain: Path) -> None:
    copied(plain, tmp_path)
    with pytest.raises(InputError, match=r"0\.weight has the shape \(8, 2\), in this network \(9, 2\)"):
        train(Product(nn.Sequential(nn.Linear(2, 9), nn.Tanh(), nn.Dropout(), nn.Linear(9, 1))), CONFIG, tmp_path)


def test_a_log_that_lost_rows_is_not_continued(tmp_path: Path, plain: Path) -> None:
    log = copied(plain, tmp_path) / "log.jsonl"
    log.write_bytes(log.read_bytes()[:-5])
    with pytest.raises(InputError, match="shorter than when the checkpoint was written"):
        train(Product(), CONFIG, tmp_path, device=CPU)


def test_it_stops_when_nothing_gets_better(tmp_path: Path) -> None:
    config = replace(CONFIG, steps=100, patience=2)
    trained = train(Said(measured=[3.0, 1.0, 2.0, 1.0, 0.5]), config, tmp_path, device=CPU)
    assert (trained.why, trained.step, trained.best_step) == ("patience", 12, 6)
    assert trained.measures == {"off": {"mean": 1.0, "median": 1.0}}
    assert load_weights(tmp_path / "best")[1]["step"] == 6
    assert train(Said(dies_at=0), config, tmp_path, device=CPU) == trained


def test_it_stops_in_time_and_goes_on(tmp_path: Path, plain: Path) -> None:
    short = replace(CONFIG, time_limit_s=0.0)
    calls = [train(Product(), short, tmp_path, device=CPU) for _ in range(CONFIG.steps)]
    assert [trained.step for trained in calls] == list(range(1, 13))
    assert [trained.why for trained in calls] == ["time"] * 11 + ["steps"]
    assert kept(tmp_path) == kept(plain)


def test_it_gives_up_when_the_loss_or_a_measure_is_not_finite(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="step 3: off is not finite for 7 examples"):
        train(Said(measured=[float("nan")]), CONFIG, tmp_path / "measure", device=CPU)
    task = Product()
    task.model[0].weight.data.fill_(float("nan"))
    with pytest.raises(InputError, match="step 3: the loss is no longer finite"):
        train(task, CONFIG, tmp_path / "loss", device=CPU)
    assert not (tmp_path / "loss/checkpoint.safetensors").exists()


def test_the_kept_weights_are_the_average_where_one_is_asked_for(tmp_path: Path) -> None:
    train(Product(), replace(CONFIG, average=0.9, check_every=12), tmp_path, device=CPU)
    parts, _ = read_state(tmp_path / "checkpoint.safetensors")
    best, _ = load_weights(tmp_path / "best")
    assert all(best[name].equal(value) for name, value in parts["average"].items())
    assert not any(best[name].equal(value) for name, value in parts["model"].items())


def test_an_average_follows_its_recurrence(tmp_path: Path) -> None:
    config, average = replace(CONFIG, average=0.2, time_limit_s=0.0), stored(Product().model)
    for keep in (1 / 10, 2 / 11, 0.2, 0.2):  # a step each
        train(Product(), config, tmp_path, device=CPU)
        parts, _ = read_state(tmp_path / "checkpoint.safetensors")
        average = {name: keep * value + (1 - keep) * parts["model"][name] for name, value in average.items()}
        for name, value in parts["average"].items():
            torch.testing.assert_close(value, average[name])


def test_the_rate_rises_then_falls() -> None:
    config = TrainConfig(steps=110, warmup=10, rate=1.0)
    rates = [config.rate_at(step) for step in range(110)]
    assert rates[:11] == pytest.approx([(i + 1) / 11 for i in range(10)] + [1.0])
    assert rates[60] == pytest.approx(0.5)
    assert np.all(np.diff(rates[10:]) < 0)
    assert 0 < rates[-1] < 1e-3
    assert replace(config, decay="linear").rate_at(85) == pytest.approx(0.25)
    assert replace(config, decay="none").rate_at(109) == 1.0


@pytest.mark.parametrize(
    ("name", "value"),
    [("steps", 0), ("batch", -1), ("rate", 0.0), ("average", 1.0), ("clip", 0.0), ("workers", -1), ("patience", 0)],
)
def test_numbers_that_make_no_sense_are_refused(name: str, value: Any) -> None:
    with pytest.raises(InputError, match=f"{name}: expected"):
        TrainConfig(**{name: value})


def alone(folder: Path, config: TrainConfig, environment: dict[str, str]) -> None:
    """What a process of its own does."""
    os.environ.update(environment)
    train(Product(network(0.0)), config, folder, device=CPU)


def process(folder: Path, config: TrainConfig, **environment: str) -> BaseProcess:
    """A training run in a process of its own; all are forked from one that has imported what they need."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["baselines.training.loop", "pytest", "torch._dynamo"])  # Adam imports that
    started = context.Process(target=alone, args=(folder, config, environment), daemon=True)
    started.start()
    return started


def ended(*processes: BaseProcess) -> list[int | None]:
    """How some processes ended."""
    for one in processes:
        one.join(60)
    return [one.exitcode for one in processes]


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


@pytest.mark.slow
def test_two_processes_come_to_the_weights_of_one(tmp_path: Path) -> None:
    train(Product(network(0.0)), CONFIG, tmp_path / "one", device=CPU)
    for config in (replace(CONFIG, time_limit_s=0.0), CONFIG):  # the first stops after a step
        shared = {"WORLD_SIZE": "2", "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(free_port())}
        pair = [process(tmp_path / "two", config, RANK=str(i), LOCAL_RANK=str(i), **shared) for i in range(2)]
        assert ended(*pair) == [0, 0]
    one, two = (read_state(tmp_path / name / "checkpoint.safetensors")[0] for name in ("one", "two"))
    for part in ("model", "optimizer"):
        for name, value in one[part].items():
            torch.testing.assert_close(two[part][name], value)
    for a, b in zip(rows(tmp_path / "one"), rows(tmp_path / "two"), strict=True):
        assert b["loss"] == pytest.approx(a["loss"], rel=1e-5)
        assert b["measures"]["off"] == pytest.approx(a["measures"]["off"], rel=1e-4)


@pytest.mark.slow
def test_a_process_that_is_killed_outright_goes_on_to_the_bit(tmp_path: Path) -> None:
    config = replace(CONFIG, steps=1000, check_every=50, checkpoint_every=20)
    log = tmp_path / "torn/log.jsonl"
    torn = process(tmp_path / "torn", config)
    while not log.exists() or log.read_bytes().count(b"\n") < 6:
        time.sleep(0.01)
        assert torn.is_alive()
    torn.kill()
    assert ended(torn) == [-signal.SIGKILL]
    assert ended(process(tmp_path / "torn", config), process(tmp_path / "whole", config)) == [0, 0]
    assert kept(tmp_path / "torn") == kept(tmp_path / "whole")
