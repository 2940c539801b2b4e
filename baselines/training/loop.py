"""One training loop for every network: validation on fixed examples, checkpoints.

A run writes into a folder: config.json, log.jsonl with a row for each validation, best.safetensors and best.json, and
checkpoint.pt, from which the same call resumes after a stop or a kill with the same results.
"""

from __future__ import annotations

import ctypes
import io
import json
import math
import os
import signal
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any, Literal

import numpy as np
import torch
from tqdm import tqdm

from baselines.training.batches import Batch, Task, train_batches, validation_batches
from baselines.training.config import FREE, TrainConfig
from baselines.training.descent import Descent
from kit1000.errors import InputError
from kit1000.files import clear_partial, locked, read_json, write_bytes, write_json
from kit1000.interrupts import in_main_thread
from kit1000.parallel import usable_cores
from kit1000.perception.networks.weight_files import save_weights

__all__ = ["Batch", "Task", "TrainConfig", "TrainingResult", "train"]

CONFIG, LOG, BEST, CHECKPOINT = "config.json", "log.jsonl", "best", "checkpoint.pt"

TRIM_THRESHOLD, MMAP_MAX = -1, -4  # names of glibc's mallopt
STOPPING = "training: stopping after this step, with a checkpoint; once more stops at once"

Measures = dict[str, dict[str, float]]
StopReason = Literal["steps", "time"]


@dataclass(frozen=True)
class TrainingResult:
    """How a call of `train` ended."""

    stopped_by: StopReason
    """steps: all steps are done; time: the time limit was reached, and the same call resumes."""
    step: int
    seconds: float
    """Seconds of all calls together."""
    best_step: int | None
    """None before the first validation."""
    measures: Measures
    """Mean and median of each measure at the best step."""


@dataclass
class _Progress:
    """The counters in a checkpoint."""

    step: int = 0
    seconds: float = 0.0
    steps_since_log: int = 0
    """Since the last row of the log."""
    log_bytes: int = 0
    best: float | None = None
    """Smallest median of the first measure."""
    best_step: int | None = None
    measures: Measures = field(default_factory=dict)
    """Measures at the best step."""


@dataclass
class _Run:
    """The state of a call of `train`."""

    task: Task
    config: TrainConfig
    folder: Path
    settings: dict[str, Any]
    """What the results depend on, as JSON has it: `train` and `about`."""
    descent: Descent
    progress: _Progress


def train(
    task: Task,
    config: TrainConfig,
    folder: Path,
    about: Mapping[str, Any] | None = None,
    device: torch.device | str | None = None,
) -> TrainingResult:
    """Train the network of a task, or resume; the best weights are in best.safetensors afterwards.

    Args:
        task: its network is left on the device, with the weights of the last step.
        config: as in the run so far, except for checkpoint_every, workers, threads and time_limit_s.
        folder: of this run alone; created if missing.
        about: what else the results depend on, as JSON has it: network, dataset.
        device: None: a GPU if there is one, else the CPU.

    Raises:
        InputError: the folder is of another run, a file in it is damaged, or a loss or measure is not finite.
    """
    settings = json.loads(json.dumps({"train": asdict(config), "about": dict(about or {})}))
    device = torch.device(device or ("cuda" if torch.cuda.is_available() else "cpu"))
    with _settings(config, device), locked(folder):
        run = _opened(task, config, folder, settings, device)
        stopped_by = _run_steps(run) if run.progress.step < config.steps else "steps"
        progress = run.progress
        return TrainingResult(stopped_by, progress.step, progress.seconds, progress.best_step, progress.measures)


def _run_steps(run: _Run) -> StopReason:
    """Take steps until all are taken, the time is over, or a signal asks to stop."""
    config, progress, device = run.config, run.progress, run.descent.device
    began = time.monotonic() - progress.seconds
    ends = math.inf if config.time_limit_s is None else time.monotonic() + config.time_limit_s
    steps = range(progress.step, config.steps)
    batches = train_batches(run.task, config.seed, config.batch, steps, _workers(config, device), device)
    kept = progress.step  # at the last checkpoint
    bar = tqdm(steps, "training", config.steps, unit="step", initial=kept, disable=None)
    try:
        with _deferred_interrupts(STOPPING) as interrupt, closing(batches), closing(bar):  # pyright: ignore[reportArgumentType]
            for batch in batches:
                run.descent.step(progress.step, batch)
                progress.step += 1
                progress.steps_since_log += 1
                progress.seconds = time.monotonic() - began
                bar.update()
                done = progress.step == config.steps
                if done or progress.step % config.validate_every == 0:
                    _report(run, bar, _validate(run))
                stopped = done or interrupt.requested or time.monotonic() >= ends
                if stopped or progress.step % config.checkpoint_every == 0:
                    _write_checkpoint(run)
                    kept = progress.step
                if interrupt.requested and stopped and not done:
                    raise KeyboardInterrupt
                if stopped:
                    return "steps" if done else "time"
    except KeyboardInterrupt:
        print(f"training: stopped; the same command continues from step {kept}", file=sys.stderr)
        raise
    raise AssertionError("the last step ends the loop")


@dataclass
class _Deferral:
    """Whether the work of a block is asked to end."""

    requested: bool = False


@contextmanager
def _deferred_interrupts(notice: str) -> Iterator[_Deferral]:
    """Let the first Ctrl-C or SIGTERM in the block only ask it to end, and print a notice; the second one raises.

    The handlers before are restored. Only the main thread can set them: in others nothing is asked.
    """
    deferral = _Deferral()
    if not in_main_thread():
        yield deferral
        return

    def handle(number: int, frame: FrameType | None) -> None:
        if deferral.requested:
            raise KeyboardInterrupt
        deferral.requested = True
        print(notice, file=sys.stderr, flush=True)

    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    for number in before:
        signal.signal(number, handle)
    try:
        yield deferral
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)


def _report(run: _Run, bar: tqdm, measured: str) -> None:
    """Show what a validation measured: in the bar of a terminal, as a line in a log file."""
    bar.set_postfix_str(measured)
    if bar.disable:
        progress = run.progress
        line = f"training: step {progress.step} of {run.config.steps}, {progress.seconds:.0f} s, {measured}"
        print(line, file=sys.stderr, flush=True)


def _validate(run: _Run) -> str:
    """Measure, save the weights if they are the best so far, and log; returns the first measure as text."""
    progress = run.progress
    loss = _mean_loss(run)
    with run.descent.evaluation():
        measures = validate(run)
        name, chosen = next(iter(measures.items()))
        if progress.best is None or chosen["median"] < progress.best:
            progress.best, progress.best_step, progress.measures = chosen["median"], progress.step, measures
            info = {**run.settings, "step": progress.step, "seconds": progress.seconds, "measures": measures}
            save_weights(run.folder / BEST, run.descent.model, info, largest=None)
    row = {"step": progress.step, "loss": loss, "learning_rate": run.config.learning_rate_at(progress.step - 1)}
    progress.log_bytes = _log(run.folder, {**row, "seconds": round(progress.seconds, 3), "measures": measures})
    run.descent.loss_sum.zero_()
    progress.steps_since_log = 0
    return f"{name} {chosen['median']:.4g}"


def validate(run: _Run) -> Measures:
    """Mean and median of each measure over all validation examples."""
    keys, device = run.task.validation_keys(), run.descent.device
    if not len(keys):
        raise InputError("split val: too few queries: validation needs one of each track that the network learns")
    measured: dict[str, list[float]] = {}
    for batch in validation_batches(run.task, keys, run.config.batch, _workers(run.config, device), device):
        for name, values in run.task.measure(batch).items():
            measured.setdefault(name, []).extend(values.double().tolist())
    for name, values in measured.items():
        if wrong := int((~np.isfinite(values)).sum()):
            raise InputError(f"step {run.progress.step}: {name} is not finite for {wrong} examples")
    return {name: {"mean": float(np.mean(v)), "median": float(np.median(v))} for name, v in measured.items()}


def _mean_loss(run: _Run) -> float:
    """The mean loss since the last row of the log; raises InputError if it is not finite."""
    loss = float(run.descent.loss_sum) / max(run.progress.steps_since_log, 1)
    if not math.isfinite(loss):
        what = "the loss is no longer finite; a lower learning_rate, or clip, may help"
        raise InputError(f"step {run.progress.step}: {what}")
    return loss


def _log(folder: Path, row: Mapping[str, Any]) -> int:
    """Append a row to the log; returns the length of the log [bytes]."""
    with open(folder / LOG, "ab") as log:
        log.write((json.dumps(row) + "\n").encode())
        log.flush()
        os.fsync(log.fileno())  # a checkpoint relies on it
        return log.tell()


def _write_checkpoint(run: _Run) -> None:
    """Write a checkpoint, whole or not at all."""
    _mean_loss(run)  # weights after a loss that is not finite are useless
    data = io.BytesIO()
    torch.save({"settings": run.settings, "progress": asdict(run.progress), **run.descent.state()}, data)
    write_bytes(run.folder / CHECKPOINT, data.getvalue())


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Read a checkpoint, with all tensors on the CPU; this executes nothing.

    Raises InputError if the file is damaged.
    """
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
        return {key: state[key] for key in ("settings", "progress", *Descent.STATE)}
    except Exception:  # PyTorch raises errors of many kinds for damaged files
        raise InputError(f"{path}: damaged, or no checkpoint of a training run: delete it to begin anew") from None


def _opened(task: Task, config: TrainConfig, folder: Path, settings: dict[str, Any], device: torch.device) -> _Run:
    """A run at its start, or at its last checkpoint."""
    if (folder / CONFIG).exists():
        _check_same(folder, read_json(folder / CONFIG), settings)
    else:
        for name in (LOG, f"{BEST}.json", f"{BEST}.safetensors", CHECKPOINT):
            if (folder / name).exists():
                raise InputError(f"{folder}: holds {name}, but no {CONFIG} of a run; it stays: choose another folder")
    run = _Run(task, config, folder, settings, Descent(task, config, device), _Progress())
    if (folder / CHECKPOINT).exists():
        state = read_checkpoint(folder / CHECKPOINT)
        _check_same(folder, state["settings"], settings)
        run.descent.restore(state, folder / CHECKPOINT)
        run.progress = _Progress(**state["progress"])
    clear_partial(folder)
    _truncate(folder / LOG, run.progress.log_bytes)
    write_json(folder / CONFIG, settings)
    return run


def _check_same(folder: Path, old: Mapping[str, Any], new: Mapping[str, Any]) -> None:
    """Raise InputError if a folder holds a run with other settings."""
    free = {f"train.{name}" for name in FREE}
    was, now = ({k: v for k, v in _flat(settings).items() if k not in free} for settings in (old, new))
    for name in [*now, *was]:
        if was.get(name) != now.get(name):
            difference = f"{name.partition('.')[2]} {was.get(name)!r}, now {now.get(name)!r}"
            raise InputError(f"{folder}: holds a run with {difference}; choose another folder, or delete this one")


def _flat(value: Any, name: str = "") -> dict[str, Any]:
    """The leaves of nested dicts by their dotted names."""
    if not isinstance(value, dict):
        return {name: value}
    leaves = [_flat(inner, f"{name}.{key}" if name else key) for key, inner in value.items()]
    return {key: leaf for inner in leaves for key, leaf in inner.items()}


def _truncate(log: Path, size: int) -> None:
    """Remove the rows of a log that came after the checkpoint."""
    length = log.stat().st_size if log.exists() else 0
    if length < size:
        raise InputError(f"{log}: shorter than when the checkpoint was written; restore it, or delete the folder")
    if length > size:
        with open(log, "r+b") as file:
            file.truncate(size)


@contextmanager
def _settings(config: TrainConfig, device: torch.device) -> Iterator[None]:
    """Set the threads and the random state of PyTorch; the caller's are restored afterwards."""
    if device.type == "cpu":
        _keep_freed_memory()
    threads = torch.get_num_threads()
    torch.set_num_threads(config.threads or usable_cores())
    try:
        with torch.random.fork_rng([device] if device.type == "cuda" else []):
            yield
    finally:
        torch.set_num_threads(threads)


def _keep_freed_memory() -> None:
    """Make glibc keep freed memory for the rest of the process.

    Tensors of more than 32 MB are otherwise mapped anew each time, and touching their fresh pages costs more than the
    arithmetic of a small network: a step takes up to half as long again.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform.startswith("linux") else None
    if mallopt is not None:  # other C libraries have none
        mallopt(MMAP_MAX, 0)
        mallopt(TRIM_THRESHOLD, 2**31 - 1)


def _workers(config: TrainConfig, device: torch.device) -> int:
    """The number of processes that make examples."""
    if config.workers is not None:
        return config.workers
    return usable_cores() if device.type == "cuda" else 1
