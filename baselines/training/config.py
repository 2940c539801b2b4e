"""How a network is trained: one flat config."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from kit1000.errors import InputError

FREE = ("checkpoint_every", "workers", "threads", "time_limit_s")
"""Fields that may differ when a run is resumed: they change no result."""


@dataclass(frozen=True)
class TrainConfig:
    """How a network is trained. The same config, seed and thread count give the same weights to the bit on a CPU."""

    steps: int = 20_000
    batch: int = 8
    """Examples of a step."""
    optimizer: Literal["adam", "muon"] = "adam"
    """muon: orthogonalised momentum for the hidden layers, AdamW for the others, see `baselines.training.muon`."""
    learning_rate: float = 1e-3
    """Learning rate of the optimiser at its peak."""
    warmup: int = 0
    """Steps over which the learning rate rises linearly from 0."""
    decay: Literal["none", "linear", "cosine"] = "cosine"
    """How the learning rate falls afterwards, to 0 at the last step."""
    weight_decay: float = 0.0
    """Decay of weights but not of biases and scales, decoupled from the gradient (AdamW); plain Adam when 0."""
    clip: float | None = None
    """Largest norm of the gradient."""
    ema_decay: float | None = None
    """Decay of an exponential moving average of the weights, such as 0.999; the average is then validated and kept."""
    mixed_precision: Literal["auto", "bfloat16", "off"] = "auto"
    """auto: bfloat16 on a GPU that has it; bfloat16: on a CPU too; off: float32."""
    seed: int = 0
    validate_every: int = 200
    """Steps."""
    checkpoint_every: int = 200
    """Steps: the most that a kill costs."""
    workers: int | None = None
    """Processes that make examples; None: one per core with a GPU, else one."""
    threads: int | None = None
    """Number of PyTorch threads; None: one per core."""
    time_limit_s: float | None = None
    """Time after which a call stops, with a checkpoint, to be resumed."""

    def __post_init__(self) -> None:
        for name in ("steps", "batch", "validate_every", "checkpoint_every", "threads"):
            _at_least(name, getattr(self, name), 1)
        for name in ("warmup", "weight_decay", "seed", "workers", "time_limit_s"):
            _at_least(name, getattr(self, name), 0)
        for name, most in (("learning_rate", math.inf), ("clip", math.inf), ("ema_decay", 1)):
            value = getattr(self, name)
            if value is not None and not 0 < value < most:
                raise InputError(f"{name}: expected a number above 0 and below {most}, got {value}")

    def learning_rate_at(self, step: int) -> float:
        """The learning rate of a step, counted from 0."""
        if step < self.warmup:
            return self.learning_rate * (step + 1) / (self.warmup + 1)
        share = (step - self.warmup) / max(self.steps - self.warmup, 1)
        factor = {"none": 1.0, "linear": 1 - share, "cosine": (1 + math.cos(math.pi * share)) / 2}
        return self.learning_rate * factor[self.decay]


def _at_least(name: str, value: float | None, least: int) -> None:
    if value is not None and not value >= least:
        raise InputError(f"{name}: expected {least} or more, got {value}")


UNET_TRAINING = TrainConfig(
    steps=3500,
    batch=16,
    optimizer="muon",
    learning_rate=5e-3,
    warmup=100,
    decay="linear",
    weight_decay=0.05,
    ema_decay=0.997,
    mixed_precision="bfloat16",
    validate_every=500,
    checkpoint_every=100,
    workers=0,
    threads=1,
)
"""Training of the networks made of `kit1000.perception.networks.unet`; each network replaces some of the values."""
