"""Muon: steps that are near to orthogonal, of Adam's size; AdamW where it says so; a run that resumes to the bit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from baselines.training.loop import TrainConfig, train
from baselines.training.muon import ADAM_RATE, BETAS, EPSILON, Muon, orthogonalised
from kit1000.rng import stream


@pytest.mark.parametrize("shape", [(24, 90), (90, 24), (32, 32)])
def test_all_singular_values_come_near_to_one(shape: tuple[int, int]) -> None:
    torch.manual_seed(0)
    left, _, right = torch.linalg.svd(torch.randn(shape), full_matrices=False)
    matrix = left * torch.logspace(-1, 1, min(shape)) @ right
    values = torch.linalg.svdvals(orthogonalised(matrix, rounds=6).float())
    assert values.min() > 0.5
    assert values.max() < 1.4


def test_its_other_parameters_are_stepped_by_adamw() -> None:
    torch.manual_seed(2)
    ours, theirs = (torch.nn.Parameter(torch.linspace(-1, 1, 7)) for _ in range(2))
    muon = Muon([{"params": [ours], "orthogonal": False, "weight_decay": 0.1}], 0.03)
    adam = torch.optim.AdamW([theirs], 0.03 * ADAM_RATE, BETAS, EPSILON, weight_decay=0.1)
    for _ in range(5):
        ours.grad = torch.randn(7)
        theirs.grad = ours.grad.clone()
        muon.step()
        adam.step()
    torch.testing.assert_close(ours, theirs)


class Blur:
    """Learns to blur an image, by convolutions."""

    def __init__(self) -> None:
        torch.manual_seed(0)
        self.model = torch.nn.Sequential(
            torch.nn.Conv2d(1, 8, 3, padding=1), torch.nn.BatchNorm2d(8), torch.nn.Conv2d(8, 1, 3, padding=1)
        )

    def example(self, rng: np.random.Generator) -> dict[str, np.ndarray]:
        image = rng.random((1, 12, 12), dtype=np.float32)
        return {"image": image, "blurred": (image + np.roll(image, 1, 1) + np.roll(image, 1, 2)) / 3}

    def validation_keys(self) -> range:
        return range(4)

    def validation_example(self, key: int) -> dict[str, np.ndarray]:
        return self.example(stream(0, "validation", key))

    def loss(self, batch: dict[str, torch.Tensor]) -> torch.Tensor:
        return (self.model(batch["image"]) - batch["blurred"]).square().mean()

    def measure(self, batch: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
        return {"error": (self.model(batch["image"]).float() - batch["blurred"]).square().flatten(1).mean(1)}


def test_a_run_in_bfloat16_with_muon_resumes_to_the_bit(tmp_path: Path) -> None:
    config = TrainConfig(
        *(12, 4, "muon", 1e-2), decay="linear", ema_decay=0.9, mixed_precision="bfloat16", validate_every=6,
        checkpoint_every=3, workers=0, threads=1,
    )  # fmt: skip
    train(Blur(), config, tmp_path / "whole", device="cpu")
    limited = TrainConfig(**{**config.__dict__, "time_limit_s": 0.0})
    while train(Blur(), limited, tmp_path / "parts", device="cpu").stopped_by == "time":
        pass
    weights = [(tmp_path / folder / "best.safetensors").read_bytes() for folder in ("whole", "parts")]
    assert weights[0] == weights[1]
