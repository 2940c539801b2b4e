"""Muon: momentum whose matrices are orthogonalised, for convolutions; AdamW for all other parameters.

Jordan et al. 2024, "Muon: an optimizer for hidden layers in neural networks"; the step is scaled to the root mean
square of Adam's as in Liu et al. 2025, "Muon is scalable for LLM training".
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import torch
from torch import Tensor

MOMENTUM = 0.95
ROUNDS = 4  # of the Newton-Schulz iteration
QUINTIC = (3.4445, -4.7750, 2.0315)  # its polynomial, steep at 0
RMS = 0.2  # of a step of Adam
BETAS, EPSILON = (0.9, 0.99), 1e-8  # of AdamW
ADAM_RATE = 1 / 3  # of AdamW's learning rate to Muon's: vectors and the first and last layer are more delicate


class Muon(torch.optim.Optimizer):
    """Groups with `orthogonal` are stepped by Muon, the others by AdamW; all have their own `weight_decay`."""

    def __init__(self, groups: Iterable[dict[str, Any]], learning_rate: float) -> None:
        """groups: of parameters, with `orthogonal` and `weight_decay`; the rate of AdamW is ADAM_RATE of this one."""
        super().__init__(groups, {"lr": learning_rate, "weight_decay": 0.0, "orthogonal": False})

    @torch.no_grad()
    def step(self, closure: None = None) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Step all parameters that have a gradient."""
        for group in self.param_groups:
            rate = group["lr"] * (1 if group["orthogonal"] else ADAM_RATE)
            for parameter in group["params"]:
                if parameter.grad is None:
                    continue
                step = _muon_step if group["orthogonal"] else _adam_step
                change = step(parameter.grad, self.state[parameter])
                parameter.mul_(1 - rate * group["weight_decay"]).add_(change, alpha=-rate)


def _muon_step(gradient: Tensor, state: dict[str, Tensor]) -> Tensor:
    """The orthogonalised step, with Nesterov's momentum."""
    if not state:
        state["momentum"] = torch.zeros_like(gradient)
    momentum = state["momentum"]
    momentum.lerp_(gradient, 1 - MOMENTUM)
    ahead = gradient.lerp(momentum, MOMENTUM)
    matrix = ahead.flatten(1)
    scale = RMS * math.sqrt(max(matrix.shape))
    return orthogonalised(matrix).view(gradient.shape).mul(scale)


def _adam_step(gradient: Tensor, state: dict[str, Tensor]) -> Tensor:
    if not state:
        state["step"] = torch.zeros(())
        state["exp_avg"], state["exp_avg_sq"] = torch.zeros_like(gradient), torch.zeros_like(gradient)
    state["step"] += 1
    first, second = BETAS
    state["exp_avg"].lerp_(gradient, 1 - first)
    state["exp_avg_sq"].mul_(second).addcmul_(gradient, gradient, value=1 - second)
    count = float(state["step"])
    spread = (state["exp_avg_sq"] / (1 - second**count)).sqrt_().add_(EPSILON)
    return state["exp_avg"] / (1 - first**count) / spread


def orthogonalised(matrix: Tensor, rounds: int = ROUNDS) -> Tensor:
    """The matrix (n, m) with all singular values near 1, by a quintic Newton-Schulz iteration in bfloat16."""
    a, b, c = QUINTIC
    tall = matrix.shape[0] > matrix.shape[1]
    x = (matrix / (matrix.norm() + 1e-7)).bfloat16()
    x = x.T if tall else x
    for _ in range(rounds):
        square = x @ x.T
        x = torch.addmm(x, torch.addmm(square, square, square, beta=b, alpha=c), x, beta=a)
    return (x.T if tall else x).to(matrix.dtype)
