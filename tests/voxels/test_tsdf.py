"""The truncated signed distance of depth images compared with plain numpy and with planes; what remains unknown."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from kit1000.camera import Camera, look_at
from kit1000.errors import InputError
from kit1000.pose import Pose
from kit1000.sim.render import render
from kit1000.values import View
from kit1000.voxels import Grid, tsdf
from tests.samples.shapes import as_part, ring_plate

CAMERA = Camera(width=160, height=120, fx=150.0, fy=140.0, cx=78.3, cy=61.7)
SQUARE = Camera(width=101, height=101, fx=400.0, fy=400.0, cx=50.0, cy=50.0)
AHEAD = Grid.centred(Pose.from_translation((0, 0, 0.5)), (21, 21, 41), 2e-3)
PART = as_part(ring_plate(14)).mesh


def plain(grid: Grid, view: View, mask: np.ndarray | None = None, truncation: float | None = None) -> np.ndarray:
    """`tsdf` in plain numpy."""
    limit = 5 * grid.voxel_size if truncation is None else truncation
    x, y, z = np.moveaxis(view.world_from_camera.inverse().apply(grid.centres()), -1, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.floor(view.camera.fx * x / z + view.camera.cx + 0.5)
        v = np.floor(view.camera.fy * y / z + view.camera.cy + 0.5)
    inside = (z > 0) & (u >= 0) & (v >= 0) & (u < view.camera.width) & (v < view.camera.height)
    pixel = np.where(inside, v, 0).astype(int), np.where(inside, u, 0).astype(int)
    depth = np.where(inside, view.depth[pixel], 0)
    values = np.minimum((depth - z) / limit, 1)
    values[values < -1] = np.nan
    if mask is not None:
        values = np.where(mask[pixel], values, np.where(z <= depth, 1, np.nan))
    values[depth == 0] = np.nan
    return values


def differing(a: np.ndarray, b: np.ndarray) -> float:
    """Fraction of voxels that differ by more than 1e-5: those that project midway between two pixels."""
    same = (np.isnan(a) & np.isnan(b)) | (np.abs(a - b) <= 1e-5)
    return float(1 - same.mean())


def rough_view(seed: int, world_from_camera: Pose) -> View:
    """Random depths, a fifth of the pixels without return."""
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.35, 0.65, (CAMERA.height, CAMERA.width))
    return View(CAMERA, world_from_camera, np.where(rng.random(depth.shape) < 0.2, 0, depth))


def level_view(depth: float) -> View:
    """A wall across the optical axis."""
    return View(SQUARE, Pose.identity(), np.full((101, 101), depth, np.float32))


def part_view(eye: tuple[float, float, float] = (0.15, 0.1, 0.2), times: float = 3.0) -> View:
    camera = CAMERA.scaled(times)
    world_from_camera = look_at(eye, (0, 0, 0))
    return View(camera, world_from_camera, render(camera, world_from_camera, [(PART, Pose.identity())], 1).depth)


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("truncation", [None, 0.03, 1e-4])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_agrees_with_plain_numpy(seed: int, truncation: float | None, masked: bool) -> None:
    rng = np.random.default_rng(seed)
    view = rough_view(seed, look_at(rng.uniform(-0.3, 0.3, 3) + (0, 0, 0.6), (0, 0, 0)))
    mask = rng.random(view.depth.shape) < 0.5 if masked else None
    grid = Grid.centred(Pose.from_rotvec(rng.normal(size=3)), (50, 40, 90), 7e-3)  # wider than the image
    ours = tsdf(grid, view, mask, truncation)
    assert 0.01 < ours.known.mean() < 0.9
    assert differing(ours.values, plain(grid, view, mask, truncation)) < 1e-4


def test_a_grid_around_the_camera_is_unknown_behind_it() -> None:
    view = rough_view(0, Pose.identity())
    grid = Grid.centred(Pose.identity(), (20, 20, 21), 0.03)
    values = tsdf(grid, view).values
    assert np.isnan(values[:, :, :11]).all()  # the eleventh layer is in the camera plane
    assert differing(values, plain(grid, view)) < 1e-3
    assert np.isnan(tsdf(grid.moved(Pose.from_translation((0, 0, -1))), view).values).all()


def test_voxels_without_a_return_outside_the_image_or_occluded_are_unknown() -> None:
    depth = np.full((101, 101), 0.5, np.float32)
    depth[:, :40] = 0
    wide = Grid.centred(Pose.from_translation((0, 0, 0.5)), (81, 3, 41), 2e-3)
    values = tsdf(wide, View(SQUARE, Pose.identity(), depth)).values
    x, _, z = np.moveaxis(wide.centres(), -1, 0)
    u = 400 * x / z + 50
    assert np.isnan(values[(u < 39.4)]).all()  # no return
    assert np.isnan(values[(u > 100.6)]).all()  # outside the image
    assert np.isnan(values[z > 0.5101]).all()  # hidden
    assert not np.isnan(values[(u > 39.6) & (u < 100.4) & (z < 0.5099)]).any()


def test_beside_the_mask_voxels_are_free_up_to_the_depth() -> None:
    mask = np.zeros((101, 101), bool)
    mask[:, 50:] = True
    volume = tsdf(AHEAD, level_view(0.5), mask)
    x, _, z = np.moveaxis(AHEAD.centres(), -1, 0)
    beside, on = 400 * x / z < -0.6, 400 * x / z > -0.4
    assert (volume.values[beside & (z < 0.4999)] == 1).all()
    assert np.isnan(volume.values[beside & (z > 0.5001)]).all()
    np.testing.assert_array_equal(volume.values[on], tsdf(AHEAD, level_view(0.5)).values[on])


def test_threads_change_no_byte() -> None:
    grid = Grid.centred(Pose.from_rotvec((0.1, 0.2, 0.3)), (90, 80, 70), 1e-3)
    view = part_view()
    mask = view.depth > 0.25
    volumes = [tsdf(grid, view, mask, threads=n) for n in (1, 2, 5, None)]
    assert len({volume.values.tobytes() for volume in volumes}) == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"mask": np.ones((3, 3), bool)}, r"mask: expected bool of shape \(101, 101\), got shape \(3, 3\)"),
        ({"mask": np.full((101, 101), 7)}, r"mask: .* which is no bool"),
        ({"truncation": 0.0}, r"truncation: expected a distance above 0 m, got 0.0"),
        ({"truncation": float("inf")}, r"truncation: .*inf"),
        ({"threads": 0}, r"threads: expected a whole number from 1 up"),
        ({"threads": 1.5}, r"threads: .*got 1.5"),
    ],
)
def test_invalid_input_is_rejected(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        tsdf(AHEAD, level_view(0.5), **arguments)


def test_a_negative_depth_is_rejected() -> None:
    with pytest.raises(InputError, match=r"depth: expected 0 \(no return\) or more, got -0.5"):
        tsdf(AHEAD, level_view(-0.5))
