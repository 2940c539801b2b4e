"""The processes of one training run: one, or several started by torchrun, each with its device."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import torch
import torch.distributed as dist

from kit1000.errors import InputError

BACKENDS = "cpu:gloo,cuda:nccl"  # numbers and decisions by gloo, gradients on a GPU by nccl


@dataclass(frozen=True)
class Ranks:
    """The rank of this process, the number of processes, and its device."""

    rank: int
    world: int
    device: torch.device

    @property
    def first(self) -> bool:
        """Whether this is the process that writes files."""
        return self.rank == 0

    def share(self, count: int) -> range:
        """The indices of this process among `count`."""
        return range(self.rank, count, self.world)

    def agreed(self, decision: bool) -> bool:
        """The decision of the first process."""
        if self.world == 1:
            return decision
        value = torch.tensor(int(decision))
        dist.broadcast(value, 0)
        return bool(value)

    def mean(self, value: torch.Tensor) -> torch.Tensor:
        """The mean of a tensor over the processes."""
        if self.world == 1:
            return value
        total = value.clone()
        dist.all_reduce(total)
        return total / self.world

    def gathered(self, value: Any) -> list[Any]:
        """The values of all processes in their order, in every process; a value is pickled."""
        if self.world == 1:
            return [value]
        values = [None] * self.world
        dist.all_gather_object(values, value)
        return values


@contextmanager
def joined(device: torch.device | str | None = None) -> Iterator[Ranks]:
    """The processes of the environment (WORLD_SIZE, RANK, LOCAL_RANK, as torchrun sets them), or this one alone.

    Args:
        device: a GPU where there is one, else the CPU, when None; each process of a machine takes a GPU of its own.
    """
    rank, world = int(os.environ.get("RANK", 0)), int(os.environ.get("WORLD_SIZE", 1))
    chosen = _device(device)
    if chosen.type == "cuda":
        torch.cuda.set_device(chosen)
    begun = world > 1 and not dist.is_initialized()
    if begun:
        dist.init_process_group(BACKENDS if chosen.type == "cuda" else "gloo", rank=rank, world_size=world)
    try:
        yield Ranks(rank, world, chosen)
    finally:
        if begun:
            dist.destroy_process_group()


def processes_here() -> int:
    """The number of processes of the run on this machine."""
    return int(os.environ.get("LOCAL_WORLD_SIZE", os.environ.get("WORLD_SIZE", 1)))


def _device(device: torch.device | str | None) -> torch.device:
    chosen = torch.device(device or ("cuda" if torch.cuda.is_available() else "cpu"))
    if chosen.type != "cuda" or chosen.index is not None:
        return chosen
    index = int(os.environ.get("LOCAL_RANK", 0))
    if index >= torch.cuda.device_count():
        raise InputError(f"process {index} of this machine has no GPU: it has {torch.cuda.device_count()}")
    return torch.device("cuda", index)
