"""Optimiser steps: AdamW or Muon, bfloat16, a moving average of the weights, several processes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import torch
from torch.nn.parallel import DistributedDataParallel

from baselines.training.batches import Batch, Task
from baselines.training.config import TrainConfig
from baselines.training.muon import Muon
from baselines.training.processes import Processes
from kit1000.errors import InputError
from kit1000.perception.networks.weight_files import Tensors, load_into
from kit1000.rng import stream

EMA_WARMUP = 10  # steps: at first the decay is only (1 + step) / (10 + step), as in TensorFlow
BF16_SINCE = (8, 0)  # compute capability of GPUs that calculate in bfloat16


class Descent:
    """A network with all state that training changes."""

    def __init__(self, task: Task, config: TrainConfig, processes: Processes) -> None:
        """Move the network to the device of this process."""
        self.config, self.processes = config, processes
        self.model = task.model.to(processes.device)
        self.loss = task.loss
        self.loss_sum = torch.zeros((), dtype=torch.float64, device=processes.device)
        """Sum of the losses since it was reset; it stays on the device, so that no step waits for a transfer."""
        self._optimizer = {"adam": _adam, "muon": _muon}[config.optimizer](self.model, config)
        self._average = {} if config.ema_decay is None else _copied(self.model)
        self._parallel: torch.nn.Module | None = None

    def step(self, step: int, batch: Batch) -> None:
        """Take step number `step`, counted from 0, on this process's part of its batch."""
        self._seed("torch", step, self.processes.rank)
        for group in self._optimizer.param_groups:
            group["lr"] = self.config.learning_rate_at(step)
        self.model.train()
        with self._precision():
            loss = self._loss(batch)
        self._optimizer.zero_grad()
        loss.backward()
        if self.config.clip is not None:
            torch.nn.utils.clip_grad_norm_(self.model.parameters(), self.config.clip)
        self._optimizer.step()
        if self.config.ema_decay is not None:
            _update_average(self._average, self.model, 1 - min(self.config.ema_decay, (1 + step) / (EMA_WARMUP + step)))
        self.loss_sum += loss.detach()

    def mean_loss(self, steps: int) -> float:
        """The mean loss of all processes over the steps since the reset; raises InputError if it is not finite."""
        self.loss_sum.copy_(self.processes.mean(self.loss_sum))
        loss = float(self.loss_sum) / max(steps, 1)
        if not math.isfinite(loss):
            raise InputError("the loss is no longer finite; a lower learning_rate, or clip, may help")
        return loss

    @contextmanager
    def evaluation(self) -> Iterator[None]:
        """The network as it is validated and saved: in evaluation mode, without gradients, with averaged weights."""
        own = _copied(self.model) if self._average else {}
        if own:
            self.model.load_state_dict(self._average)
        self.model.eval()
        self._seed("check")
        try:
            with torch.no_grad(), self._precision():
                yield
        finally:
            if own:
                self.model.load_state_dict(own)

    def state(self) -> dict[str, Any]:
        """All of the state, for a checkpoint."""
        return {
            "model": self.model.state_dict(),
            "average": self._average,
            "optimizer": self._optimizer.state_dict(),
            "loss_sum": self.loss_sum,
        }

    def restore(self, state: Mapping[str, Any], where: object) -> None:
        """Restore the state of a checkpoint; raises InputError if it belongs to another network."""
        load_into(self.model, state["model"], str(where))
        self._optimizer.load_state_dict(state["optimizer"])
        self._average = {name: value.to(self.processes.device) for name, value in state["average"].items()}
        self.loss_sum.copy_(state["loss_sum"])

    def _loss(self, batch: Batch) -> torch.Tensor:
        """() the loss, whose gradient is the mean over all processes."""
        if self.processes.count == 1:
            return self.loss(batch)
        if self._parallel is None:
            self._parallel = DistributedDataParallel(_Loss(self.model, self.loss))
        return self._parallel(batch)

    def _precision(self) -> torch.autocast:
        device, mode = self.processes.device, self.config.mixed_precision
        has_bfloat16 = device.type == "cuda" and torch.cuda.get_device_capability(device) >= BF16_SINCE
        return torch.autocast(
            device.type, torch.bfloat16, enabled=mode == "bfloat16" or (mode == "auto" and has_bfloat16)
        )

    def _seed(self, *key: int | str) -> None:
        """Seed dropout and the like, which have no generators of their own: by step, so that a run can be resumed."""
        torch.manual_seed(int(stream(self.config.seed, *key).integers(2**63)))


class _Loss(torch.nn.Module):
    """A loss as a module, so that DistributedDataParallel covers every use of the network in it."""

    def __init__(self, model: torch.nn.Module, loss: Callable[[Batch], torch.Tensor]) -> None:
        super().__init__()
        self.model = model
        self.loss = loss

    def forward(self, batch: Batch) -> torch.Tensor:
        return self.loss(batch)


def _adam(model: torch.nn.Module, config: TrainConfig) -> torch.optim.Optimizer:
    """AdamW; vectors, which are biases and scales, do not decay."""
    trainable = [parameter for parameter in model.parameters() if parameter.requires_grad]
    groups = [
        {"params": [parameter for parameter in trainable if parameter.ndim > 1], "weight_decay": config.weight_decay},
        {"params": [parameter for parameter in trainable if parameter.ndim <= 1], "weight_decay": 0.0},
    ]
    return torch.optim.AdamW([group for group in groups if group["params"]], config.learning_rate)


def _muon(model: torch.nn.Module, config: TrainConfig) -> torch.optim.Optimizer:
    """Muon for the weights of hidden layers; AdamW for vectors and for the layers that a network names its ENDS."""
    ends = tuple(f"{name}." for name in getattr(model, "ENDS", ()))
    groups: dict[tuple[bool, bool], list[torch.nn.Parameter]] = {}
    for name, parameter in model.named_parameters():
        if parameter.requires_grad:
            kind = (parameter.ndim > 1 and not name.startswith(ends), parameter.ndim > 1)
            groups.setdefault(kind, []).append(parameter)
    return Muon(
        [
            {"params": parameters, "orthogonal": hidden, "weight_decay": config.weight_decay if weights else 0.0}
            for (hidden, weights), parameters in groups.items()
        ],
        config.learning_rate,
    )


def _copied(model: torch.nn.Module) -> Tensors:
    return {name: value.detach().clone() for name, value in model.state_dict().items()}


def _update_average(average: Tensors, model: torch.nn.Module, share: float) -> None:
    """Move an average towards the weights by a share of the way; integer counters are copied."""
    for name, value in model.state_dict().items():
        if value.is_floating_point():
            average[name].lerp_(value, share)
        else:
            average[name].copy_(value)
