"""Optimiser steps: Adam or Muon, half precision, a moving average of the weights, several processes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import torch
from torch.nn.parallel import DistributedDataParallel

from baselines.training.batches import Batch, Task
from baselines.training.checkpoint import load_into_optimizer, optimizer_tensors
from baselines.training.config import TrainConfig
from baselines.training.muon import Muon
from baselines.training.ranks import Ranks
from kit1000.errors import InputError
from kit1000.perception.networks.weight_files import Tensors, load_into
from kit1000.rng import stream

EMA_WARMUP = 10  # steps: at first the decay is only (1 + step) / (10 + step), as in TensorFlow
BF16_SINCE = (8, 0)  # compute capability of GPUs that calculate in bfloat16; older ones emulate it


class Descent:
    """A network with all state that training changes."""

    def __init__(self, task: Task, config: TrainConfig, ranks: Ranks) -> None:
        """Take the network to the device of this process."""
        self.config, self.ranks = config, ranks
        self.model = task.model.to(ranks.device)
        self.loss = task.loss
        self.loss_sum = torch.zeros((), dtype=torch.float64, device=ranks.device)
        """Over the steps since it was reset; on the device, so that no step waits for a transfer."""
        self._half = _half(config, ranks.device)
        self._optimizer = {"adam": _adam, "muon": _muon}[config.optimizer](self.model, config)
        self._scaler = torch.amp.GradScaler(enabled=self._half == torch.float16)  # pyright: ignore[reportPrivateImportUsage]
        self._average = {} if config.ema_decay is None else _copied(self.model)
        self._parallel: torch.nn.Module | None = None

    def step(self, step: int, batch: Batch) -> None:
        """Take step number `step`, counted from 0, on this process's part of its batch."""
        self._seed("torch", step, self.ranks.rank)
        for group in self._optimizer.param_groups:
            group["lr"] = self.config.learning_rate_at(step)
        self.model.train()
        with self._precision():
            loss = self._loss(batch)
        self._optimizer.zero_grad()
        self._scaler.scale(loss).backward()
        if self.config.clip is not None:
            self._scaler.unscale_(self._optimizer)
            torch.nn.utils.clip_grad_norm_(self.model.parameters(), self.config.clip)
        self._scaler.step(self._optimizer)
        self._scaler.update()
        if self.config.ema_decay is not None:
            _update_average(self._average, self.model, 1 - min(self.config.ema_decay, (1 + step) / (EMA_WARMUP + step)))
        self.loss_sum += loss.detach()

    def mean_loss(self, steps: int) -> float:
        """Over the steps since the reset, and over all processes; raises InputError where it is not finite."""
        self.loss_sum.copy_(self.ranks.mean(self.loss_sum))
        loss = float(self.loss_sum) / max(steps, 1)
        if not math.isfinite(loss):
            raise InputError("the loss is no longer finite; a lower learning_rate, or clip, may help")
        return loss

    @contextmanager
    def evaluation(self) -> Iterator[None]:
        """The network as it is validated and kept: in evaluation mode, without gradients, with averaged weights."""
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

    def tensors(self) -> dict[str, Tensors]:
        """Its tensors by group, for a checkpoint."""
        optimizer = optimizer_tensors(self.model, self._optimizer)
        return {"model": self.model.state_dict(), "average": self._average, "optimizer": optimizer}

    def numbers(self) -> dict[str, Any]:
        """Its other state, for a checkpoint, as JSON has it."""
        return {"loss_sum": float(self.loss_sum), "scaler": self._scaler.state_dict()}

    def restore(self, tensors: Mapping[str, Tensors], numbers: Mapping[str, Any], where: object) -> None:
        """Restore the state of a checkpoint; raises InputError where it is of another network."""
        load_into(self.model, tensors["model"], str(where))
        load_into_optimizer(self.model, self._optimizer, tensors["optimizer"], str(where))
        self._average = {name: value.to(self.ranks.device) for name, value in tensors["average"].items()}
        self.loss_sum.fill_(numbers["loss_sum"])
        if numbers["scaler"]:
            self._scaler.load_state_dict(numbers["scaler"])

    def _loss(self, batch: Batch) -> torch.Tensor:
        """() the loss, whose gradient is the mean over all processes."""
        if self.ranks.world == 1:
            return self.loss(batch)
        if self._parallel is None:
            self._parallel = DistributedDataParallel(_Loss(self.model, self.loss))
        return self._parallel(batch)

    def _precision(self) -> torch.autocast:
        return torch.autocast(self.ranks.device.type, self._half or torch.bfloat16, enabled=self._half is not None)

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
    """Adam, or with weight decay AdamW; vectors, which are biases and scales, do not decay."""
    trainable = [parameter for parameter in model.parameters() if parameter.requires_grad]
    groups = [
        {"params": [parameter for parameter in trainable if parameter.ndim > 1], "weight_decay": config.weight_decay},
        {"params": [parameter for parameter in trainable if parameter.ndim <= 1], "weight_decay": 0.0},
    ]
    return torch.optim.AdamW([group for group in groups if group["params"]], config.learning_rate)


def _muon(model: torch.nn.Module, config: TrainConfig) -> torch.optim.Optimizer:
    """Muon for the weights of hidden layers; Adam for vectors and for the layers that a network names its ENDS."""
    ends = tuple(f"{name}." for name in getattr(model, "ENDS", ()))
    groups: dict[tuple[bool, bool], list[torch.nn.Parameter]] = {}
    for name, parameter in model.named_parameters():
        if parameter.requires_grad:
            groups.setdefault((parameter.ndim > 1 and not name.startswith(ends), parameter.ndim > 1), []).append(
                parameter
            )
    return Muon(
        [
            {"params": parameters, "orthogonal": hidden, "weight_decay": config.weight_decay if weights else 0.0}
            for (hidden, weights), parameters in groups.items()
        ],
        config.learning_rate,
    )


def _half(config: TrainConfig, device: torch.device) -> torch.dtype | None:
    """The half-precision type; None for float32."""
    if config.mixed_precision == "bfloat16":
        return torch.bfloat16
    if config.mixed_precision == "off" or device.type != "cuda":
        return None
    return torch.bfloat16 if torch.cuda.get_device_capability(device) >= BF16_SINCE else torch.float16


def _copied(model: torch.nn.Module) -> Tensors:
    return {name: value.detach().clone() for name, value in model.state_dict().items()}


def _update_average(average: Tensors, model: torch.nn.Module, share: float) -> None:
    """Move an average towards the weights by a share of the way; integer counters are copied."""
    for name, value in model.state_dict().items():
        if value.is_floating_point():
            average[name].lerp_(value, share)
        else:
            average[name].copy_(value)
