"""One training loop for every network: Adam, checks on fixed examples, checkpoints, one process or several.

A run writes into a folder: config.json, log.jsonl with a row for each check, best.safetensors and best.json, curve.svg,
and checkpoint.safetensors, from which the same call goes on after a stop or a kill as if there had been none.
"""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager, nullcontext
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from tqdm import tqdm

from baselines.training.batches import Batch, Task, check_batches, train_batches
from baselines.training.checkpoint import read_state, save_weights, write_state
from baselines.training.config import FREE, TrainConfig
from baselines.training.curve import curve
from baselines.training.descent import Descent
from baselines.training.memory import keep_memory
from baselines.training.ranks import Ranks, joined, processes_here
from kit1000.engines.cores import cores
from kit1000.errors import InputError
from kit1000.files import clear_partial, locked, read_json, write_bytes, write_json

__all__ = ["Batch", "Task", "TrainConfig", "Trained", "train"]

CONFIG, LOG, BEST, CURVE, CHECKPOINT = "config.json", "log.jsonl", "best", "curve.svg", "checkpoint.safetensors"

Measures = dict[str, dict[str, float]]
Why = Literal["steps", "patience", "time"]


@dataclass(frozen=True)
class Trained:
    """How a call of `train` ended."""

    why: Why
    """All steps done, no better for too long, or out of time: then the same call goes on."""
    step: int
    seconds: float
    """Of all calls together."""
    best_step: int | None
    """None before the first check."""
    measures: Measures
    """Mean and median of each measure at the best step."""


@dataclass
class _Progress:
    """Words of a checkpoint."""

    step: int = 0
    seconds: float = 0.0
    summed: int = 0
    """Steps since the last row of the log."""
    log_bytes: int = 0
    best: float | None = None
    """Least median of the first measure."""
    best_step: int | None = None
    measures: Measures = field(default_factory=dict)
    """At the best step."""
    stale: int = 0
    """Checks since then."""


@dataclass
class _Run:
    """What a call of `train` holds together."""

    task: Task
    config: TrainConfig
    folder: Path
    asked: dict[str, Any]
    """What a run depends on, as JSON has it."""
    ranks: Ranks
    descent: Descent
    progress: _Progress


def train(
    task: Task,
    config: TrainConfig,
    folder: Path,
    about: Mapping[str, Any] | None = None,
    device: torch.device | str | None = None,
) -> Trained:
    """Train the network of a task, or go on with it; the best weights are in best.safetensors afterwards.

    Args:
        task: its network is left on the device, with the weights of the last step.
        config: that of the run so far, but for checkpoint_every, workers, threads and time_limit_s.
        folder: of this run alone; made where it is missing.
        about: what else the result depends on and the folder shall hold to, as JSON has it: network, dataset.
        device: a GPU where there is one, else the CPU, when None.

    Raises:
        InputError: the folder is of another run, a file in it is damaged, or loss or a measure is not finite.
    """
    asked = json.loads(json.dumps({"train": asdict(config), "about": dict(about or {})}))
    with joined(device) as ranks, _settings(config, ranks), locked(folder) if ranks.first else nullcontext():
        if config.batch % ranks.world:
            raise InputError(f"batch: expected a multiple of the {ranks.world} processes, got {config.batch}")
        run = _begun(task, config, folder, asked, ranks)
        why = _stop(run) or _trained(run)
        progress = run.progress
        return Trained(why, progress.step, progress.seconds, progress.best_step, progress.measures)


def _trained(run: _Run) -> Why:
    """Take steps until there is a reason to stop."""
    config, progress, ranks = run.config, run.progress, run.ranks
    began = time.monotonic() - progress.seconds
    ends = math.inf if config.time_limit_s is None else time.monotonic() + config.time_limit_s
    steps, places = range(progress.step, config.steps), ranks.share(config.batch)
    batches = train_batches(run.task, config.seed, config.batch, steps, places, _workers(config, ranks), ranks.device)
    silent = None if ranks.first else True
    with (
        closing(batches) as batches,  # pyright: ignore[reportArgumentType]
        tqdm(desc="training", total=config.steps, initial=progress.step, unit="step", disable=silent) as bar,
    ):
        for batch in batches:
            run.descent.step(progress.step, batch)
            progress.step += 1
            progress.summed += 1
            bar.update()
            progress.seconds = time.monotonic() - began
            if progress.step % config.check_every == 0 or progress.step == config.steps:
                bar.set_postfix_str(_check(run))
            why = _stop(run) or ("time" if ranks.agreed(time.monotonic() >= ends) else None)
            if why or progress.step % config.checkpoint_every == 0:
                _keep(run)
            if why:
                return why
    raise AssertionError("the last step is a reason to stop")


def _stop(run: _Run) -> Why | None:
    """Why there is nothing more to do."""
    if run.progress.step >= run.config.steps:
        return "steps"
    return "patience" if run.config.patience is not None and run.progress.stale >= run.config.patience else None


def _check(run: _Run) -> str:
    """Measure, log, keep the weights if they are the best so far, draw; returns the chosen measure in words."""
    progress, first = run.progress, run.ranks.first
    loss = _mean_loss(run)
    with run.descent.checked():
        measures = _measured(run)
        name, chosen = next(iter(measures.items()))
        better = progress.best is None or chosen["median"] < progress.best
        if better:
            progress.best, progress.best_step, progress.measures = chosen["median"], progress.step, measures
            if first:
                info = {**run.asked, "step": progress.step, "seconds": progress.seconds, "measures": measures}
                save_weights(run.folder / BEST, run.descent.model, info, largest=None)
    progress.stale = 0 if better else progress.stale + 1
    if first:
        row = {"step": progress.step, "loss": loss, "rate": run.config.rate_at(progress.step - 1)}
        progress.log_bytes = _log(run.folder, {**row, "seconds": round(progress.seconds, 3), "measures": measures})
    run.descent.loss_sum.zero_()
    progress.summed = 0
    return f"{name} {chosen['median']:.4g}"


def _measured(run: _Run) -> Measures:
    """Mean and median of each measure over all examples to be checked by."""
    keys, ranks = run.task.check_examples(), run.ranks
    if not len(keys):
        raise InputError("expected at least one example to check by")
    own, workers = ranks.share(len(keys)), _workers(run.config, ranks)
    found: dict[str, list[float]] = {}
    for batch in check_batches(run.task, keys, own, run.config.batch, workers, ranks.device):
        for name, values in run.task.measure(batch).items():
            found.setdefault(name, []).extend(values.double().tolist())
    parts = ranks.gathered(found)
    return {name: _summary(run, name, np.concatenate([part.get(name, []) for part in parts])) for name in parts[0]}


def _summary(run: _Run, name: str, values: np.ndarray) -> dict[str, float]:
    """(n,) values of a measure in two numbers."""
    if not np.isfinite(values).all():
        raise InputError(f"step {run.progress.step}: {name} is not finite for {(~np.isfinite(values)).sum()} examples")
    return {"mean": float(values.mean()), "median": float(np.median(values))}


def _mean_loss(run: _Run) -> float:
    """Since the last row of the log."""
    try:
        return run.descent.mean_loss(run.progress.summed)
    except InputError as error:
        raise InputError(f"step {run.progress.step}: {error}") from None


def _log(folder: Path, row: Mapping[str, Any]) -> int:
    """Append a row to the log and draw it; returns how long the log is now [bytes]."""
    path = folder / LOG
    with open(path, "ab") as log:
        log.write((json.dumps(row) + "\n").encode())
        log.flush()
        os.fsync(log.fileno())  # a checkpoint will count on it
        end = log.tell()
    rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    write_bytes(folder / CURVE, curve(rows).encode())
    return end


def _keep(run: _Run) -> None:
    """Write a checkpoint."""
    _mean_loss(run)  # of no use are weights after a loss that is not finite
    if run.ranks.first:
        words = {"asked": run.asked, "progress": asdict(run.progress), "descent": run.descent.words()}
        write_state(run.folder / CHECKPOINT, run.descent.parts(), words)


def _begun(task: Task, config: TrainConfig, folder: Path, asked: dict[str, Any], ranks: Ranks) -> _Run:
    """A run at its start, or where its last checkpoint was."""
    if (folder / CONFIG).exists():
        _check_same(folder, read_json(folder / CONFIG), asked)
    run = _Run(task, config, folder, asked, ranks, Descent(task, config, ranks), _Progress())
    if (folder / CHECKPOINT).exists():
        parts, words = read_state(folder / CHECKPOINT)
        _check_same(folder, words["asked"], asked)
        run.descent.fill(parts, words["descent"], folder / CHECKPOINT)
        run.progress = _Progress(**words["progress"])
    if ranks.first:
        clear_partial(folder)
        _cut(folder / LOG, run.progress.log_bytes)
        write_json(folder / CONFIG, asked)
    return run


def _check_same(folder: Path, old: Mapping[str, Any], new: Mapping[str, Any]) -> None:
    """Raise InputError when a folder is of a run that asked for something else."""
    free = {f"train.{name}" for name in FREE}
    was, now = ({k: v for k, v in _flat(asked).items() if k not in free} for asked in (old, new))
    for name in [*now, *was]:
        if was.get(name) != now.get(name):
            said = f"{name.partition('.')[2]} {was.get(name)!r}, now {now.get(name)!r}"
            raise InputError(f"{folder}: holds a run with {said}; choose another folder, or delete this one")


def _flat(value: Any, name: str = "") -> dict[str, Any]:
    """The leaves of nested dicts by their dotted names."""
    if not isinstance(value, dict):
        return {name: value}
    leaves = [_flat(inner, f"{name}.{key}" if name else key) for key, inner in value.items()]
    return {key: leaf for inner in leaves for key, leaf in inner.items()}


def _cut(log: Path, size: int) -> None:
    """Take the rows off a log that came after the checkpoint."""
    there = log.stat().st_size if log.exists() else 0
    if there < size:
        raise InputError(f"{log}: shorter than when the checkpoint was written; bring it back, or delete the folder")
    if there > size:
        with open(log, "r+b") as file:
            file.truncate(size)


@contextmanager
def _settings(config: TrainConfig, ranks: Ranks) -> Iterator[None]:
    """The threads and the random state of PyTorch: the caller's again afterwards."""
    if ranks.device.type == "cpu":
        keep_memory()
    threads = torch.get_num_threads()
    torch.set_num_threads(config.threads or max(cores() // processes_here(), 1))
    try:
        with torch.random.fork_rng([ranks.device] if ranks.device.type == "cuda" else []):
            yield
    finally:
        torch.set_num_threads(threads)


def _workers(config: TrainConfig, ranks: Ranks) -> int:
    """Processes that make examples."""
    if config.workers is not None:
        return config.workers
    return max(cores() // processes_here(), 1) if ranks.device.type == "cuda" else 1
