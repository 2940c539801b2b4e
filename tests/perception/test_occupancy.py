"""The filled share of cells: closed forms of boxes, the volume of any solid, and points counted inside."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from kit1000.mesh import Mesh, mesh_from_solid
from kit1000.perception.observed.occupancy import filled_share
from kit1000.pose import Pose, random_quaternions
from kit1000.voxels import Grid
from tests.samples.shapes import MM, box, ell, ring_plate

CELL = 1e-3
GRID = Grid.centred(Pose.from_translation((0.001, -0.002, 0.012)), (56, 52, 40), CELL)


def mesh_of(solid) -> Mesh:
    return mesh_from_solid(solid).scaled(MM)


@settings(max_examples=12, deadline=None)
@given(st.lists(st.floats(2.0, 20.0), min_size=3, max_size=3), st.lists(st.floats(-4.0, 4.0), min_size=3, max_size=3))
def test_a_level_box_fills_its_share_of_every_cell(size: list[float], shift: list[float]) -> None:
    body, pose = mesh_of(box(size[0], size[1], size[2])), Pose.from_translation(np.array(shift) * MM)
    share = filled_share(body, pose, GRID, columns=24)
    low, high = body.bounds + pose.xyz
    axes = [
        np.clip(np.minimum(c + CELL / 2, b) - np.maximum(c - CELL / 2, a), 0, CELL) / CELL
        for c, a, b in zip(
            (GRID.centres()[:, 0, 0, 0], GRID.centres()[0, :, 0, 1], GRID.centres()[0, 0, :, 2]), low, high, strict=True
        )
    ]
    exact = axes[0][:, None, None] * axes[1][:, None] * axes[2]
    assert np.abs(share - exact).max() < 2 / 24


@pytest.mark.parametrize("solid", [ell(), ring_plate(20)], ids=["ell", "ring"])
def test_a_turned_solid_fills_its_volume_and_agrees_with_points_counted_inside(solid) -> None:
    body = mesh_of(solid)
    pose = Pose(random_quaternions(np.random.default_rng(3), 1)[0], np.array([0.001, 0.0, 0.012]))
    body = Mesh((body.vertices - body.centroid) * 0.7, body.faces)
    share = filled_share(body, pose, GRID)
    assert share.sum() * CELL**3 == pytest.approx(body.volume, rel=2e-3)
    moved = body.moved(pose)
    inside = trimesh.Trimesh(moved.vertices, moved.faces)
    rng = np.random.default_rng(0)
    cells = rng.choice(np.flatnonzero((share > 0.1) & (share < 0.9)), 40, replace=False)
    full = rng.choice(np.flatnonzero(share > 0.999), 10, replace=False)
    for cell in np.concatenate([cells, full]):
        place = GRID.world(np.array(np.unravel_index(cell, share.shape)))
        points = place + CELL * (rng.random((1000, 3)) - 0.5)
        assert share.flat[cell] == pytest.approx(inside.contains(points).mean(), abs=0.2)
    assert share[0].max() == 0


def test_a_solid_that_leaves_the_grid_fills_it_up_to_its_border() -> None:
    share = filled_share(mesh_of(box(100, 100, 100)), Pose.from_translation((0, 0, -0.05)), GRID)
    np.testing.assert_array_equal(share, 1)


def test_lines_through_vertices_and_along_edges_are_counted_once() -> None:
    """A box of whole cells whose edges lie on lines: at each of them one of two faces counts."""
    grid = Grid((20, 20, 20), CELL, Pose.from_translation((-0.0095, -0.0095, 0.0005)))
    low = 2.25  # [mm] on a line of columns=2
    share = filled_share(mesh_of(box(2 * low, 2 * low, 6)), Pose.identity(), grid)
    assert set(np.unique(share)) <= {0.0, 0.25, 0.5, 1.0}
    assert share.sum() == pytest.approx(6 * (2 * low) ** 2, rel=0.15)
