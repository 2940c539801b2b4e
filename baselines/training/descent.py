"""One step after another down the gradient: Adam, half precision, an average of the weights, several processes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import torch
from torch.nn.parallel import DistributedDataParallel

from baselines.training.batches import Batch, Task
from baselines.training.checkpoint import Tensors, fill, fill_optimizer, optimizer_tensors
from baselines.training.config import TrainConfig
from baselines.training.ranks import Ranks
from kit1000.errors import InputError
from kit1000.rng import stream

AVERAGE_START = 10  # steps: at first an average keeps only (1 + step) / (10 + step) of itself, as in TensorFlow
BF16_SINCE = (8, 0)  # compute capability of GPUs that calculate in bfloat16; older ones emulate it


class Descent:
    """A network with all that changes as it is trained."""

    def __init__(self, task: Task, config: TrainConfig, ranks: Ranks) -> None:
        """Take the network to the device of this process."""
        self.config, self.ranks = config, ranks
        self.model = task.model.to(ranks.device)
        self.loss = task.loss
        self.loss_sum = torch.zeros((), dtype=torch.float64, device=ranks.device)
        """Of the steps since it was set to zero; on the device, so that no step waits for a number."""
        self._half = _half(config, ranks.device)
        self._optimizer = _adam(self.model, config)
        self._scaler = torch.amp.GradScaler(enabled=self._half == torch.float16)  # pyright: ignore[reportPrivateImportUsage]
        self._average = {} if config.average is None else _copied(self.model)
        self._parallel: torch.nn.Module | None = None

    def step(self, step: int, batch: Batch) -> None:
        """Take step number `step`, counted from 0, by this process's part of its batch."""
        self._seed("torch", step, self.ranks.rank)
        for group in self._optimizer.param_groups:
            group["lr"] = self.config.rate_at(step)
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
        if self.config.average is not None:
            _lean(self._average, self.model, 1 - min(self.config.average, (1 + step) / (AVERAGE_START + step)))
        self.loss_sum += loss.detach()

    def mean_loss(self, steps: int) -> float:
        """Over the steps since the sum was zero, and over all processes; raises InputError when it is not finite."""
        self.loss_sum.copy_(self.ranks.mean(self.loss_sum))
        loss = float(self.loss_sum) / max(steps, 1)
        if not math.isfinite(loss):
            raise InputError("the loss is no longer finite; a lower rate, or clip, may help")
        return loss

    @contextmanager
    def checked(self) -> Iterator[None]:
        """The network as it is measured and kept: in evaluation mode, without gradients, with averaged weights."""
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

    def parts(self) -> dict[str, Tensors]:
        """Its tensors, for a checkpoint."""
        optimizer = optimizer_tensors(self.model, self._optimizer)
        return {"model": self.model.state_dict(), "average": self._average, "optimizer": optimizer}

    def words(self) -> dict[str, Any]:
        """Its numbers, for a checkpoint, as JSON has them."""
        return {"loss_sum": float(self.loss_sum), "scaler": self._scaler.state_dict()}

    def fill(self, parts: Mapping[str, Tensors], words: Mapping[str, Any], where: object) -> None:
        """Take up what a checkpoint holds; raises InputError when it is of another network."""
        fill(self.model, parts["model"], str(where))
        fill_optimizer(self.model, self._optimizer, parts["optimizer"], str(where))
        self._average = {name: value.to(self.ranks.device) for name, value in parts["average"].items()}
        self.loss_sum.fill_(words["loss_sum"])
        if words["scaler"]:
            self._scaler.load_state_dict(words["scaler"])

    def _loss(self, batch: Batch) -> torch.Tensor:
        """() whose gradient is that of all processes together."""
        if self.ranks.world == 1:
            return self.loss(batch)
        if self._parallel is None:
            self._parallel = DistributedDataParallel(_Loss(self.model, self.loss))
        return self._parallel(batch)

    def _precision(self) -> torch.autocast:
        return torch.autocast(self.ranks.device.type, self._half or torch.bfloat16, enabled=self._half is not None)

    def _seed(self, *key: int | str) -> None:
        """Of dropout and the like, which have no generators of their own: by step, so that a run can go on."""
        torch.manual_seed(int(stream(self.config.seed, *key).integers(2**63)))


class _Loss(torch.nn.Module):
    """A loss as a module, so that all use of the network in it is seen from outside."""

    def __init__(self, model: torch.nn.Module, loss: Callable[[Batch], torch.Tensor]) -> None:
        super().__init__()
        self.model = model
        self.loss = loss

    def forward(self, batch: Batch) -> torch.Tensor:
        return self.loss(batch)


def _adam(model: torch.nn.Module, config: TrainConfig) -> torch.optim.Optimizer:
    """Adam, or with weight decay AdamW; vectors, which are biases and scales, do not decay."""
    learnt = [parameter for parameter in model.parameters() if parameter.requires_grad]
    groups = [
        {"params": [parameter for parameter in learnt if parameter.ndim > 1], "weight_decay": config.weight_decay},
        {"params": [parameter for parameter in learnt if parameter.ndim <= 1], "weight_decay": 0.0},
    ]
    return torch.optim.AdamW([group for group in groups if group["params"]], config.rate)


def _half(config: TrainConfig, device: torch.device) -> torch.dtype | None:
    """What a GPU calculates in where float32 is not needed."""
    if config.mixed == "off" or device.type != "cuda":
        return None
    return torch.bfloat16 if torch.cuda.get_device_capability(device) >= BF16_SINCE else torch.float16


def _copied(model: torch.nn.Module) -> Tensors:
    return {name: value.detach().clone() for name, value in model.state_dict().items()}


def _lean(average: Tensors, model: torch.nn.Module, share: float) -> None:
    """Move an average towards the weights by a share of the way; counters are taken as they are."""
    for name, value in model.state_dict().items():
        if value.is_floating_point():
            average[name].lerp_(value, share)
        else:
            average[name].copy_(value)
