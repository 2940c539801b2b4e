"""Fresh parts: closed, about their centre of mass, at rest on their faces; the same from shards and by themselves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from baselines.training.tasks import part_completion
from baselines.training.tasks.part_completion import (
    LEAST_PIXELS,
    DrawnPart,
    DrawnParts,
    DrawnViews,
    beside,
    drawn_part,
    resting_pose,
)
from kit1000.mesh import solid_from_mesh
from kit1000.perception.completion.parts import CODE
from kit1000.rng import stream
from kit1000.sim.footprints import footprint, footprint_distance
from kit1000.sim.layout import MAX_PART_RADIUS

SEED = 7


@pytest.fixture(scope="module")
def parts() -> list[DrawnPart]:
    return [drawn_part(SEED, i) for i in range(8)]


def test_parts_are_solids_about_their_centre_of_mass_that_the_table_has_room_for(parts: list[DrawnPart]) -> None:
    for part in parts:
        assert solid_from_mesh(part.mesh).volume() > 0
        assert np.abs(part.mesh.centroid).max() < 1e-6
        assert np.linalg.norm(part.mesh.extents) / 2 <= MAX_PART_RADIUS
        assert part.probability.sum() == pytest.approx(1)


def test_a_resting_part_touches_the_table_with_its_face_and_nothing_is_below(parts: list[DrawnPart]) -> None:
    for part in parts:
        for face in range(len(part.down)):
            pose = resting_pose(part, face, 0.7)
            heights = pose.apply(part.mesh.vertices)[:, 2]
            assert heights.min() == pytest.approx(0, abs=1e-9)
            assert (heights < 1e-6).sum() >= 3
            np.testing.assert_allclose(pose.rotate(part.down[face]), (0, 0, -1), atol=1e-9)


def test_a_neighbour_stands_beside_the_part_at_its_gap_or_farther(parts: list[DrawnPart]) -> None:
    first, second = parts[0], parts[1]
    pose, other = resting_pose(first, 0, 0.3), resting_pose(second, 0, 1.0)
    outline = footprint(first.mesh, pose)
    for direction in np.arange(0, 6.3, 0.7):
        moved = beside(outline, second.mesh, other, float(direction), 3e-3)
        assert footprint_distance(outline, footprint(second.mesh, moved)) >= 3e-3 - 1e-12
        assert moved.xyz[2] == other.xyz[2]


def test_a_shard_holds_the_parts_that_are_made_without_it(
    tmp_path: Path, parts: list[DrawnPart], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(part_completion, "SHARD", 4)
    made, read = (DrawnParts(SEED, 8, tmp_path) for _ in range(2))
    for part, one, other in zip(parts, made, read, strict=True):
        for name in ("down", "probability"):
            np.testing.assert_array_equal(getattr(part, name), getattr(one, name))
        for mesh in (one.mesh, other.mesh):
            np.testing.assert_array_equal(part.mesh.vertices, mesh.vertices)
            np.testing.assert_array_equal(part.mesh.faces, mesh.faces)
    assert len(list(tmp_path.rglob("output.pkl"))) == 2
    with pytest.raises(IndexError):
        made[8]


def test_an_example_depends_on_its_generator_alone_and_its_truth_fits_its_evidence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(part_completion, "SHARD", 4)
    views = DrawnViews(DrawnParts(SEED, 8, tmp_path), d415_share=0.35)
    for i in range(6):
        example, again = (views.example(stream(1, i)) for _ in range(2))
        for name, value in example.items():
            np.testing.assert_array_equal(value, again[name])
        codes, solid = example["codes"], example["solid"] / 255
        assert 4 * solid[codes == CODE].sum() < solid.sum()  # the d415 sees through thin edges, never through a part
        assert (np.abs(codes) < CODE).sum() > LEAST_PIXELS
        assert solid.max() == 1
        assert 0 < example["camera"][0] < np.pi / 2
