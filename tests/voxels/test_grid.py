"""Grids, volumes, and interpolation."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from kit1000.errors import InputError
from kit1000.mesh import Mesh, mesh_from_solid
from kit1000.pose import Pose
from kit1000.voxels import Grid, Volume, crop, resample, signed_distance, surface_points
from tests.samples.shapes import box

ROTATED = Pose.from_rotvec((0.3, -0.7, 1.1), (0.2, -0.1, 0.05))
GRID = Grid((7, 6, 5), 2e-3, ROTATED)


def any_volume(grid: Grid = GRID, unknown: float = 0.2, seed: int = 0) -> Volume:
    rng = np.random.default_rng(seed)
    values = rng.uniform(-1, 1, grid.shape).astype(np.float32)
    values[rng.random(grid.shape) < unknown] = np.nan
    return Volume(grid, values)


def millimetre_box(x: float, y: float, z: float) -> Mesh:
    """In metres, about the origin."""
    mesh = mesh_from_solid(box(x, y, z)).scaled(1e-3)
    return Mesh(mesh.vertices - mesh.bounds.mean(0), mesh.faces)


def test_indices_is_the_inverse_of_world() -> None:
    indices = np.random.default_rng(1).uniform(-3, 9, (20, 3))
    np.testing.assert_allclose(GRID.indices(GRID.world(indices)), indices, atol=1e-10)


def test_grids_are_equal_when_their_voxels_are() -> None:
    same = Grid((7, 6, 5), 2e-3, ROTATED)
    assert same == GRID
    assert hash(same) == hash(GRID)
    assert GRID.moved(ROTATED) != GRID
    assert GRID != "a grid"


def test_values_cannot_be_written_and_are_a_copy() -> None:
    values = np.zeros(GRID.shape, np.float32)
    volume = Volume(GRID, values)
    values[0, 0, 0] = 1
    assert volume.values[0, 0, 0] == 0
    with pytest.raises(ValueError, match="read-only"):
        volume.values[0, 0, 0] = 1


def test_a_moved_volume_has_its_surface_moved() -> None:
    volume, shift = any_volume(), Pose.from_rotvec((0, 0.2, 1), (1, 2, 3))
    moved = Volume(volume.grid.moved(shift), volume.values)
    np.testing.assert_allclose(surface_points(moved), shift.apply(surface_points(volume)), atol=1e-12)


def test_cropping_moves_no_voxel() -> None:
    volume = any_volume()
    cropped = crop(volume, (2, 1, 1), (3, 4, 2))
    np.testing.assert_array_equal(cropped.values, volume.values[2:5, 1:5, 1:3])
    np.testing.assert_allclose(cropped.grid.centres(), GRID.centres()[2:5, 1:5, 1:3], atol=1e-14)


@pytest.mark.parametrize("start", [(-2, -2, -2), (4, -1, 3), (50, 0, 0), (-50, -50, -50)])
def test_a_crop_is_unknown_outside_the_volume(start: tuple[int, int, int]) -> None:
    volume = any_volume(unknown=0)
    cropped = crop(volume, start, (5, 5, 5))
    index = np.moveaxis(np.indices(cropped.grid.shape), 0, -1) + start
    inside = ((index >= 0) & (index < GRID.shape)).all(-1)
    np.testing.assert_array_equal(cropped.known, inside)
    np.testing.assert_array_equal(cropped.values[inside], volume.values[tuple(index[inside].T)])


def test_resampling_is_the_trilinear_interpolation_of_scipy() -> None:
    volume = any_volume(unknown=0)
    world_from_centre = Pose(ROTATED.wxyz, GRID.world((3, 2.5, 2))) @ Pose.from_rotvec((0.4, 0.2, 0))
    target = Grid.centred(world_from_centre, (9, 9, 9), 1e-3)
    index = np.moveaxis(GRID.indices(target.centres()), -1, 0)
    ours, theirs = resample(volume, target), map_coordinates(volume.values, index, order=1, cval=np.nan)
    assert 0.3 < ours.known.mean() < 1
    np.testing.assert_allclose(ours.values, theirs, atol=2e-6)


def test_resampling_fills_no_unknown_voxel() -> None:
    volume = any_volume(unknown=0.1)
    half = Grid((13, 11, 9), GRID.voxel_size / 2, ROTATED)
    read = resample(volume, half)
    np.testing.assert_array_equal(read.values[::2, ::2, ::2], volume.values)
    pair = (volume.values[:-1] + volume.values[1:]) / 2  # NaN where either is
    np.testing.assert_allclose(read.values[1::2, ::2, ::2], pair, atol=1e-6)


def test_resampling_does_not_depend_on_threads() -> None:
    volume = any_volume(Grid((80, 60, 50), 1e-3, ROTATED))
    target = Grid.centred(Pose.from_rotvec((1, 0.3, 0.2), volume.grid.world((40, 30, 25))), (70, 70, 70), 0.7e-3)
    one, two = (resample(volume, target, threads=n).values for n in (1, 2))
    assert one.tobytes() == two.tobytes()


def test_surface_points_of_a_box_are_on_the_box() -> None:
    grid = Grid.centred(ROTATED, (30, 30, 30), 1e-3)
    volume = signed_distance(grid, [(millimetre_box(13.3, 11.1, 9.7), ROTATED)])
    inside = np.abs(ROTATED.inverse().apply(surface_points(volume))) * 2e3 - (13.3, 11.1, 9.7)
    assert len(inside) > 500
    # exact on faces; beside an edge the distance is not linear within the voxel
    assert np.abs(inside.max(1)).max() < 0.5
    assert np.median(np.abs(inside.max(1))) < 1e-3


def test_surface_points_agree_with_a_plain_search() -> None:
    volume = any_volume(unknown=0.3)
    crossings = []
    for axis in range(3):
        for index in np.ndindex(*GRID.shape):
            after = tuple(np.add(index, np.eye(3, dtype=int)[axis]))
            if after[axis] == GRID.shape[axis]:
                continue
            a, b = float(volume.values[index]), float(volume.values[after])
            if (a < 0) != (b < 0) and abs(a - b) <= 1:
                crossings.append(np.add(index, np.eye(3)[axis] * a / (a - b)))
    np.testing.assert_allclose(surface_points(volume), GRID.world(crossings), atol=1e-9)


def test_without_a_surface_there_are_no_points() -> None:
    assert surface_points(Volume(GRID, np.ones(GRID.shape))).shape == (0, 3)
    assert surface_points(Volume(GRID, np.full(GRID.shape, np.nan))).shape == (0, 3)


def test_the_border_of_the_observed_region_is_no_surface() -> None:
    values = np.array([-0.3, 1.0, 0.4, -0.4], np.float32).reshape(4, 1, 1)
    points = surface_points(Volume(Grid((4, 1, 1), 1.0, Pose.identity()), values))
    np.testing.assert_allclose(points, [[2.5, 0, 0]])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (((0, 4, 4), 1e-3, ROTATED), r"shape: expected 1 voxel or more"),
        (((4, 4), 1e-3, ROTATED), r"shape: expected int64 of shape \(3,\)"),
        (((4, 4, 4.5), 1e-3, ROTATED), r"shape: .*4.5"),
        (((4000, 4000, 4000), 1e-3, ROTATED), r"at most 2\^31"),
        (((4, 4, 4), 0.0, ROTATED), r"voxel_size: expected an edge above 0 m, got 0.0"),
        (((4, 4, 4), float("nan"), ROTATED), r"voxel_size: .*nan"),
        (((4, 4, 4), 1e-3, Pose.identity((2,))), r"world_from_grid: expected one pose"),
        (((4, 4, 4), 1e-3, np.eye(4)), r"world_from_grid: expected one pose"),
    ],
)
def test_an_invalid_grid_is_rejected(arguments: tuple[Any, Any, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Grid(*arguments)


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((5, 6, 7)), r"float32 of shape \(7, 6, 5\).*got \(5, 6, 7\)"),
        (np.full(GRID.shape, 1.5), r"got 1.5 at \(0, 0, 0\)"),
        (np.full(GRID.shape, np.inf), r"got inf"),
        (np.full(GRID.shape, "a"), r"got something else"),
    ],
)
def test_an_invalid_volume_is_rejected(array: np.ndarray, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Volume(GRID, array)


def test_other_invalid_input_is_rejected() -> None:
    volume = any_volume()
    with pytest.raises(InputError, match="shape: expected 1 voxel"):
        crop(volume, (0, 0, 0), (0, 1, 1))
    with pytest.raises(InputError, match="start: expected int64"):
        crop(volume, (0.5, 0, 0), (1, 1, 1))  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="threads: expected a whole number from 1 up"):
        resample(volume, GRID, threads=0)
