"""The training tasks of completion: whose images they show, and validation on parts of any size."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from baselines.training.tasks.part_completion import CompletionTask, DrawnParts, DrawnViews, completion_task
from kit1000.dataset.reader import Dataset
from kit1000.perception.completion import parts
from kit1000.perception.completion.parts import CODE
from kit1000.rng import stream

SEED = 7


@pytest.fixture(scope="module")
def tasks(mini: Path) -> dict[float, CompletionTask]:
    """By the share of examples that the d415 measures."""
    return {share: completion_task(Dataset(mini), "small", d415_share=share) for share in (0, 0.35, 1)}


def test_a_task_is_validated_on_images_such_as_it_learns_from(tasks: dict[float, CompletionTask]) -> None:
    assert {key.sensor for key in tasks[0].validation_keys()} == {"ideal"}
    assert {key.sensor for key in tasks[0.35].validation_keys()} == {"ideal", "d415"}
    assert {key.sensor for key in tasks[1].validation_keys()} == {"d415"}


def test_the_share_of_the_d415_decides_who_measures_an_example(tmp_path: Path) -> None:
    """Of one generator the view is the same; noise moves its surfaces."""
    parts = DrawnParts(SEED, 4, tmp_path)
    for i in range(2):
        exact, noisy = (DrawnViews(parts, share).example(stream(2, i)) for share in (0.0, 1.0))
        np.testing.assert_allclose(exact["camera"], noisy["camera"], atol=0.02)
        assert np.mean(exact["codes"] != noisy["codes"]) > 0.01


def test_a_part_beyond_the_grid_is_validated_shrunk(
    tasks: dict[float, CompletionTask], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Flying pixels make some parts look larger than the grid; a run that met one ended at its first validation."""
    task = tasks[1]
    key = task.validation_keys()[0]
    whole = task.validation_example(key)
    task.kept.clear()
    monkeypatch.setattr(parts, "CELL", parts.CELL / 4)  # a grid of 20 x 20 x 13 mm
    monkeypatch.setattr(parts, "LARGEST", parts.LARGEST / 4)
    monkeypatch.setattr(parts, "TYPICAL", parts.TYPICAL / 4)
    shrunk = task.validation_example(key)
    task.kept.clear()
    filled = [example["solid"].astype(float).sum() for example in (whole, shrunk)]
    assert filled[1] == pytest.approx(filled[0], rel=0.7)
    assert (np.abs(shrunk["codes"]) < CODE).any()


def test_the_measure_of_the_truth_is_zero(tasks: dict[float, CompletionTask]) -> None:
    task = tasks[1]
    batch = {
        name: torch.from_numpy(value)[None]
        for name, value in task.validation_example(task.validation_keys()[0]).items()
    }
    batch["solid"] = (batch["solid"] > 127).to(torch.uint8) * 255
    batch["codes"][batch["solid"] > 0] = batch["codes"][batch["solid"] > 0].clamp(max=0)

    class Knowing(torch.nn.Module):
        def forward(self, codes: torch.Tensor, camera: torch.Tensor) -> torch.Tensor:
            return (batch["solid"].float() / 255 - 0.5) * 40

    measured = CompletionTask(task.training, task.dataset, "val", Knowing()).measure(batch)  # type: ignore[arg-type]
    assert measured["wrong"].item() == 0
    assert measured["brier_hidden"].item() == pytest.approx(0, abs=1e-6)
