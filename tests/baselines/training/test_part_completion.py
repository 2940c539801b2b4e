"""Completion of parts: parts that are sampled in space, and the examples and measures made of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from baselines.training.tasks import part_completion
from baselines.training.tasks.part_completion import (
    LEAST_PIXELS,
    CompletionTask,
    DrawnPart,
    DrawnParts,
    DrawnViews,
    beside,
    completion_task,
    drawn_part,
    resting_pose,
)
from kit1000.dataset.reader import Dataset
from kit1000.mesh import solid_from_mesh
from kit1000.perception.completion import parts
from kit1000.perception.completion.parts import CODE
from kit1000.rng import stream
from kit1000.sim.footprints import footprint, footprint_distance
from kit1000.sim.layout import MAX_PART_RADIUS

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


@pytest.fixture(scope="module")
def drawn() -> list[DrawnPart]:
    return [drawn_part(SEED, i) for i in range(8)]


def test_parts_are_solids_about_their_centre_of_mass_that_the_table_has_room_for(drawn: list[DrawnPart]) -> None:
    for part in drawn:
        assert solid_from_mesh(part.mesh).volume() > 0
        assert np.abs(part.mesh.centroid).max() < 1e-6
        assert np.linalg.norm(part.mesh.extents) / 2 <= MAX_PART_RADIUS
        assert part.probability.sum() == pytest.approx(1)


def test_a_resting_part_touches_the_table_with_its_face_and_nothing_is_below(drawn: list[DrawnPart]) -> None:
    for part in drawn:
        for face in range(len(part.down)):
            pose = resting_pose(part, face, 0.7)
            heights = pose.apply(part.mesh.vertices)[:, 2]
            assert heights.min() == pytest.approx(0, abs=1e-9)
            assert (heights < 1e-6).sum() >= 3
            np.testing.assert_allclose(pose.rotate(part.down[face]), (0, 0, -1), atol=1e-9)


def test_a_neighbour_stands_beside_the_part_at_its_gap_or_farther(drawn: list[DrawnPart]) -> None:
    first, second = drawn[0], drawn[1]
    pose, other = resting_pose(first, 0, 0.3), resting_pose(second, 0, 1.0)
    outline = footprint(first.mesh, pose)
    for direction in np.arange(0, 6.3, 0.7):
        moved = beside(outline, second.mesh, other, float(direction), 3e-3)
        assert footprint_distance(outline, footprint(second.mesh, moved)) >= 3e-3 - 1e-12
        assert moved.xyz[2] == other.xyz[2]


def test_a_shard_holds_the_parts_that_are_made_without_it(
    tmp_path: Path, drawn: list[DrawnPart], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(part_completion, "SHARD", 4)
    made, read = (DrawnParts(SEED, 8, tmp_path) for _ in range(2))
    for i, part in enumerate(drawn):
        one, other = made[i], read[i]
        for name in ("down", "probability"):
            np.testing.assert_array_equal(getattr(part, name), getattr(one, name))
        for mesh in (one.mesh, other.mesh):
            np.testing.assert_array_equal(part.mesh.vertices, mesh.vertices)
            np.testing.assert_array_equal(part.mesh.faces, mesh.faces)
    assert len(list(tmp_path.rglob("output.pkl"))) == 2


def test_an_example_depends_on_its_generator_alone_and_its_truth_fits_its_evidence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(part_completion, "SHARD", 4)
    views = DrawnViews(DrawnParts(SEED, 8, tmp_path), d415_share=0.35)
    for i in range(3):
        example, again = (views.example(stream(1, i)) for _ in range(2))
        for name, value in example.items():
            np.testing.assert_array_equal(value, again[name])
        codes, solid = example["codes"], example["solid"] / 255
        assert 4 * solid[codes == CODE].sum() < solid.sum()  # the d415 sees through thin edges, never through a part
        assert (np.abs(codes) < CODE).sum() > LEAST_PIXELS
        assert solid.max() == 1
        assert 0 < example["camera"][0] < np.pi / 2
