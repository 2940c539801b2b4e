"""What a network learns and is checked by, as batches: the same from any number of workers, from any step on."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Protocol

import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset

from kit1000.dataset.torch import tensors
from kit1000.rng import stream

AHEAD = 4  # batches that a worker makes before they are asked for

Example = dict[str, np.ndarray]
Batch = dict[str, torch.Tensor]


class Task(Protocol):
    """A network, what it learns, and how well it has learnt."""

    @property
    def model(self) -> torch.nn.Module:
        """Trained in place; loader workers may see None here."""
        ...

    def example(self, rng: np.random.Generator) -> Example:
        """Arrays of one training example, of the same shapes every time; all that is drawn comes from `rng`."""
        ...

    def check_examples(self) -> Sequence[Any]:
        """The keys of examples that are never trained on, always the same."""
        ...

    def check_example(self, key: Any) -> Example:
        """Arrays of one of them."""
        ...

    def loss(self, batch: Batch) -> torch.Tensor:
        """() what is to be made small: the mean over a batch."""
        ...

    def measure(self, batch: Batch) -> Batch:
        """(B,) values of each example by name, such as position_mm, small where good; the first chooses the best."""
        ...


def train_batches(
    task: Task, seed: int, batch: int, steps: range, places: range, workers: int, device: torch.device
) -> Iterator[Batch]:
    """The batches of some steps, on a device.

    Example i of step s draws from `stream(seed, "train", s, i)`: nothing depends on workers, processes, or where a run
    went on.

    Args:
        batch: examples of a step, over all processes.
        places: of those, the ones of this process.
        workers: processes that make examples; 0: this one.
    """
    indices = ([step * batch + i for i in places] for step in steps)
    return _loaded(_Drawn(task, seed, batch), indices, workers, device)


def check_batches(
    task: Task, keys: Sequence[Any], places: range, batch: int, workers: int, device: torch.device
) -> Iterator[Batch]:
    """The examples to be checked by, those at some places among the keys, at most `batch` at a time."""
    indices = [list(places[i : i + batch]) for i in range(0, len(places), batch)]
    return _loaded(_Fixed(task, keys), indices, min(workers, len(indices)), device)


class _Drawn(Dataset):
    """Training examples, by step x batch + place."""

    def __init__(self, task: Task, seed: int, batch: int) -> None:
        self.task, self.seed, self.batch = task, seed, batch

    def __getitem__(self, index: int) -> Batch:
        step, place = divmod(index, self.batch)
        return tensors(self.task.example(stream(self.seed, "train", step, place)))

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"task": _without_model(self.task)}


class _Fixed(Dataset):
    """The examples of some keys, by place."""

    def __init__(self, task: Task, keys: Sequence[Any]) -> None:
        self.task, self.keys = task, keys

    def __getitem__(self, index: int) -> Batch:
        return tensors(self.task.check_example(self.keys[index]))

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"task": _without_model(self.task)}


def _without_model(task: Task) -> Task:
    """What is sent to workers that are spawned: they compute nothing on a GPU."""
    bare = copy.copy(task)
    object.__setattr__(bare, "model", None)  # also of a frozen dataclass
    return bare


def _loaded(data: Dataset, indices: Iterable[list[int]], workers: int, device: torch.device) -> Iterator[Batch]:
    gpu = device.type == "cuda"
    ahead = AHEAD if workers else None
    loader = DataLoader(data, batch_sampler=indices, num_workers=workers, prefetch_factor=ahead, pin_memory=gpu)  # pyright: ignore[reportArgumentType]
    for batch in loader:
        yield {name: value.to(device, non_blocking=gpu) for name, value in batch.items()}
