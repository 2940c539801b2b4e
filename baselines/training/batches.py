"""Training and validation examples as batches: the same from any number of workers, from any step on."""

from __future__ import annotations

import copy
import signal
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Protocol

import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset

from kit1000.dataset.torch import to_tensors
from kit1000.rng import stream

PREFETCH = 4  # batches that a worker makes ahead

Example = dict[str, np.ndarray]
Batch = dict[str, torch.Tensor]


class Task(Protocol):
    """A network with its examples, loss and validation measures."""

    @property
    def model(self) -> torch.nn.Module:
        """Trained in place; loader workers may see None here."""
        ...

    def example(self, rng: np.random.Generator) -> Example:
        """Arrays of one training example, of the same shapes every time; all draws come from `rng`."""
        ...

    def validation_keys(self) -> Sequence[Any]:
        """The keys of the validation examples, always the same."""
        ...

    def validation_example(self, key: Any) -> Example:
        """Arrays of one of them."""
        ...

    def loss(self, batch: Batch) -> torch.Tensor:
        """() the loss: its mean over a batch."""
        ...

    def measure(self, batch: Batch) -> Batch:
        """(B,) values by name, such as position_mm, lower is better; the first one selects the best weights."""
        ...


def train_batches(
    task: Task, seed: int, batch: int, steps: range, workers: int, device: torch.device
) -> Iterator[Batch]:
    """The batches of some steps, of `batch` examples each, on a device.

    Example i of step s draws from `stream(seed, "train", s, i)`: nothing depends on workers, or where a run resumed.

    workers: processes that make examples; 0: this one.
    """
    batches = (list(range(step * batch, (step + 1) * batch)) for step in steps)
    return _on_device(TrainingSet(task, seed, batch), batches, workers, device)


def validation_batches(
    task: Task, keys: Sequence[Any], batch: int, workers: int, device: torch.device
) -> Iterator[Batch]:
    """The validation examples, at most `batch` at a time."""
    batches = [list(range(i, min(i + batch, len(keys)))) for i in range(0, len(keys), batch)]
    return _on_device(_ValidationSet(task, keys), batches, min(workers, len(batches)), device)


class TrainingSet(Dataset):
    """Training examples, by step x batch + index."""

    def __init__(self, task: Task, seed: int, batch: int) -> None:
        self.task, self.seed, self.batch = task, seed, batch

    def __getitem__(self, index: int) -> Batch:
        step, i = divmod(index, self.batch)
        return to_tensors(self.task.example(stream(self.seed, "train", step, i)))

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"task": _without_model(self.task)}


class _ValidationSet(Dataset):
    """The examples of some keys, by index."""

    def __init__(self, task: Task, keys: Sequence[Any]) -> None:
        self.task, self.keys = task, keys

    def __getitem__(self, index: int) -> Batch:
        return to_tensors(self.task.validation_example(self.keys[index]))

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"task": _without_model(self.task)}


def _without_model(task: Task) -> Task:
    """The task for workers that are spawned: they do not run the network."""
    bare = copy.copy(task)
    object.__setattr__(bare, "model", None)  # also of a frozen dataclass
    return bare


def _ignore_interrupts(_: int) -> None:
    """Leave Ctrl-C, which a terminal sends to all processes, to the one that trains: it ends its workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _on_device(data: Dataset, batches: Iterable[list[int]], workers: int, device: torch.device) -> Iterator[Batch]:
    gpu = device.type == "cuda"
    prefetch = PREFETCH if workers else None
    loader = DataLoader(
        data,
        batch_sampler=batches,  # pyright: ignore[reportArgumentType]
        num_workers=workers,
        prefetch_factor=prefetch,
        pin_memory=gpu,
        worker_init_fn=_ignore_interrupts,
    )
    for batch in loader:
        yield {name: value.to(device, non_blocking=gpu) for name, value in batch.items()}
