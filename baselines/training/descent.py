"""Optimiser steps: AdamW or Muon, bfloat16, a moving average of the weights."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import torch

from baselines.training.batches import Batch, Task
from baselines.training.config import TrainConfig
from baselines.training.muon import Muon
from kit1000.perception.networks.weight_files import Tensors, load_into
from kit1000.rng import stream

EMA_WARMUP = 10  # steps: at first the decay is only (1 + step) / (10 + step), as in TensorFlow
BF16_SINCE = (8, 0)  # compute capability of GPUs that calculate in bfloat16


class Descent:
    """A network with all state that training changes."""

    STATE = ("model", "average", "optimizer", "loss_sum")
    """Keys of its state in a checkpoint."""

    def __init__(self, task: Task, config: TrainConfig, device: torch.device) -> None:
        """Move the network to the device."""
        self.config, self.device = config, device
        self.model = task.model.to(device)
        self.loss = task.loss
        self.loss_sum = torch.zeros((), dtype=torch.float64, device=device)
        """Sum of the losses since it was reset; it stays on the device, so that no step waits for a transfer."""
        self._optimizer = {"adam": _adam, "muon": _muon}[config.optimizer](self.model, config)
        self._average = {} if config.ema_decay is None else _copied(self.model)

    def step(self, step: int, batch: Batch) -> None:
        """Take step number `step`, counted from 0, on its batch."""
        self._seed("torch", step, 0)
        for group in self._optimizer.param_groups:
            group["lr"] = self.config.learning_rate_at(step)
        self.model.train()
        with self._precision():
            loss = self.loss(batch)
        self._optimizer.zero_grad()
        loss.backward()
        if self.config.clip is not None:
            torch.nn.utils.clip_grad_norm_(self.model.parameters(), self.config.clip)
        self._optimizer.step()
        if self.config.ema_decay is not None:
            _update_average(self._average, self.model, 1 - min(self.config.ema_decay, (1 + step) / (EMA_WARMUP + step)))
        self.loss_sum += loss.detach()

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
        self._average = {name: value.to(self.device) for name, value in state["average"].items()}
        self.loss_sum.copy_(state["loss_sum"])

    def _precision(self) -> torch.autocast:
        mode, kind = self.config.mixed_precision, self.device.type
        has_bfloat16 = kind == "cuda" and torch.cuda.get_device_capability(self.device) >= BF16_SINCE
        return torch.autocast(kind, torch.bfloat16, enabled=mode == "bfloat16" or (mode == "auto" and has_bfloat16))

    def _seed(self, *key: int | str) -> None:
        """Seed dropout and the like, which have no generators of their own: by step, so that a run can be resumed."""
        torch.manual_seed(int(stream(self.config.seed, *key).integers(2**63)))


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
