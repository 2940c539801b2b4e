"""The processes of one training run: one, or several that torchrun started, each with its device."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import torch
import torch.distributed as dist

from kit1000.errors import InputError

BACKENDS = "cpu:gloo,cuda:nccl"  # gloo for numbers and decisions, nccl for gradients on GPUs


@dataclass(frozen=True)
class Processes:
    """The rank of this process, the number of processes, and the device of this one."""

    rank: int
    count: int
    device: torch.device

    @property
    def first(self) -> bool:
        """Whether this is the process that writes files."""
        return self.rank == 0

    def share(self, count: int) -> range:
        """The indices of this process among `count`."""
        return range(self.rank, count, self.count)

    def agreed(self, decision: bool) -> bool:
        """The decision of the first process."""
        return bool(self.gathered(decision)[0])

    def mean(self, value: torch.Tensor) -> torch.Tensor:
        """The mean of a tensor over the processes."""
        if self.count == 1:
            return value
        total = value.clone()
        dist.all_reduce(total)
        return total / self.count

    def gathered(self, value: Any) -> list[Any]:
        """The values of all processes in their order, in every process; a value is pickled."""
        if self.count == 1:
            return [value]
        values = [None] * self.count
        dist.all_gather_object(values, value)
        return values


@contextmanager
def joined(device: torch.device | str | None = None) -> Iterator[Processes]:
    """The processes of the environment (WORLD_SIZE, RANK, LOCAL_RANK, as torchrun sets them), or this one alone.

    Args:
        device: by default a GPU if there is one, else the CPU; each process of a computer takes a GPU of its own.
    """
    rank, count = int(os.environ.get("RANK", 0)), int(os.environ.get("WORLD_SIZE", 1))
    chosen = _device(device)
    if chosen.type == "cuda":
        torch.cuda.set_device(chosen)
    begun = count > 1 and not dist.is_initialized()
    if begun:
        dist.init_process_group(BACKENDS if chosen.type == "cuda" else "gloo", rank=rank, world_size=count)
    try:
        yield Processes(rank, count, chosen)
    finally:
        if begun:
            dist.destroy_process_group()


def processes_here() -> int:
    """The number of processes of the run on this computer."""
    return int(os.environ.get("LOCAL_WORLD_SIZE", os.environ.get("WORLD_SIZE", 1)))


def _device(device: torch.device | str | None) -> torch.device:
    chosen = torch.device(device or ("cuda" if torch.cuda.is_available() else "cpu"))
    if chosen.type != "cuda" or chosen.index is not None:
        return chosen
    index = int(os.environ.get("LOCAL_RANK", 0))
    if index >= torch.cuda.device_count():
        raise InputError(f"process {index} of this computer has no GPU: it has {torch.cuda.device_count()}")
    return torch.device("cuda", index)
