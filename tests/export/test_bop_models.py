"""Tests of the models of a BOP export: stable numbers, valid symmetries, diameters and normals in closed form."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from hypothesis import given, settings
from manifold3d import Manifold
from scipy.spatial.distance import pdist

from kit1000.dataset.geometry import Geometry
from kit1000.export.bop import diameter, model_info, object_numbers, ply_bytes, vertex_normals
from kit1000.mesh import mesh_from_solid
from kit1000.pose import Pose
from kit1000.symmetry import Symmetry
from kit1000.values import Part
from tests.samples.kits import sample_part
from tests.samples.shapes import as_part, cylinder
from tests.samples.strategies import poses


def geometry(*splits: str) -> Geometry:
    """The tables of two parts and two assemblies in each split."""
    rows = {f"{split}-{i:04d}": {"split": split} for split in splits for i in range(2)}
    return cast(Geometry, SimpleNamespace(parts=rows, assemblies=dict(rows)))


def test_numbers_of_objects_do_not_depend_on_a_test_split_that_is_withheld() -> None:
    whole, rest = object_numbers(geometry("train", "val", "test")), object_numbers(geometry("train", "val"))
    assert sorted(whole.values()) == list(range(1, 13))
    assert rest.items() < whole.items()


def symmetric_parts() -> dict[str, Part]:
    return {
        "none": as_part(Manifold.cube((40, 28, 30), center=True)),
        "D2": as_part(Manifold.cube((40, 28, 30), center=True), Symmetry.dihedral(2)),
        "free": as_part(cylinder(30, 40, top=20), Symmetry.free()),
        "free_flipped": as_part(cylinder(30, 40), Symmetry.free_flipped()),
    }


@pytest.mark.parametrize("name", symmetric_parts())
def test_listed_symmetries_leave_the_model_as_it_is(name: str) -> None:
    part = symmetric_parts()[name]
    info = model_info(part.mesh, part.symmetry)
    discrete = [np.reshape(rows, (4, 4)) for rows in info.get("symmetries_discrete", [])]
    assert len(discrete) == part.symmetry.order - 1
    assert not any(np.allclose(turn, np.eye(4)) for turn in discrete)
    vertices = part.mesh.vertices * 1e3
    for turn in discrete:
        assert np.linalg.det(turn) == pytest.approx(1)
        moved = vertices @ turn[:3, :3].T + turn[:3, 3]
        apart = np.linalg.norm(moved[:, None] - vertices, axis=-1).min(1)
        assert apart.max() < 1e-3 * info["diameter"] or "free" in name
    lines = info.get("symmetries_continuous", [])
    assert len(lines) == (part.symmetry.axis is not None)
    for line in lines:  # any turn keeps the distance from the axis and the place along it
        axis, offset = np.array(line["axis"]), np.array(line["offset"])
        along = (vertices - offset) @ axis
        radius = np.linalg.norm(vertices - offset - along[:, None] * axis, axis=1)
        assert len(np.unique(np.round(np.stack([along, radius]), 6), axis=1).T) == 2


@given(poses())
@settings(max_examples=20)
def test_the_diameter_is_the_largest_vertex_distance_in_any_rotation(pose: Pose) -> None:
    mesh = sample_part("tee").mesh.moved(pose)
    assert diameter(mesh) == pytest.approx(pdist(mesh.vertices).max())


def test_vertex_normals_of_a_box_point_along_its_diagonals() -> None:
    box = mesh_from_solid(Manifold.cube((2, 3, 4), center=True))
    np.testing.assert_allclose(vertex_normals(box), np.sign(box.vertices) / np.sqrt(3), atol=1e-12)


def test_a_ply_states_its_unit() -> None:
    assert b"comment KIT1000, millimetres\n" in ply_bytes(sample_part("tee").mesh)
