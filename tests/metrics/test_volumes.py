"""IoU and chamfer distance of volumes: closed forms, brute force, symmetry, and the formulas of the paper's release."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from kit1000.errors import InputError, ShapeError
from kit1000.mesh import Mesh, mesh_from_solid
from kit1000.metrics.volumes import known_share, occupancy_iou, surface_chamfer
from kit1000.pose import Pose
from kit1000.voxels import Grid, Volume, signed_distance, surface_points
from tests.samples.shapes import box
from tests.samples.strategies import poses

MM = 1e-3

ORIGIN = Pose.identity()


def grid(n: int = 64, voxel: float = 1 * MM) -> Grid:
    """A cube about the origin; voxel centres lie at odd multiples of `voxel` / 2."""
    return Grid.centred(ORIGIN, (n, n, n), voxel)


def block(x: float, y: float, z: float, shift: tuple[float, float, float] = (0, 0, 0)) -> Mesh:
    """A box [mm] with its centre at `shift` [mm]."""
    return mesh_from_solid(box(x, y, z, at=(0, 0, -z / 2)).translate(shift)).scaled(MM)


def volume(mesh: Mesh, on: Grid | None = None, world_from_body: Pose = ORIGIN) -> Volume:
    return signed_distance(on or grid(), [(mesh, world_from_body)], threads=1)


def ball(radius: float, centre: tuple[float, float, float] = (0, 0, 0), on: Grid | None = None) -> Volume:
    """Signed distances of a ball in closed form. radius, centre: [m]"""
    on = on or grid()
    distance = np.linalg.norm(on.centres() - np.array(centre), axis=-1) - radius
    return Volume(on, np.clip(distance / (5 * on.voxel_size), -1, 1))


def masked(known: np.ndarray, of: Volume) -> Volume:
    """A volume with more unknown voxels. known: (nx, ny, nz) bool"""
    return Volume(of.grid, np.where(known, of.values, np.nan))


def values() -> st.SearchStrategy[np.ndarray]:
    """Signed distances (3, 4, 2) with zeros and unknown voxels."""
    numbers = st.sampled_from([-1.0, -0.5, 0.0, 0.25, 1.0, float("nan")])
    return arrays.arrays(np.float32, (3, 4, 2), elements=numbers)


# --- occupancy ---


@given(a=values(), b=values())
def test_the_iou_equals_a_loop_over_voxels(a: np.ndarray, b: np.ndarray) -> None:
    both = either = known = 0
    for x, y in zip(a.ravel().tolist(), b.ravel().tolist(), strict=True):
        if x == x and y == y:
            known += 1
            both += x < 0 and y < 0
            either += x < 0 or y < 0
    expected = (both / either if either else 1.0) if known else 0.0
    assert occupancy_iou(a, b) == expected
    assert occupancy_iou(b, a) == expected
    unit = Grid((3, 4, 2), 1.0, ORIGIN)
    assert occupancy_iou(Volume(unit, a), Volume(unit, b)) == expected
    assert known_share(a, b) == (known / np.count_nonzero(b == b) if (b == b).any() else 1.0)


def test_voxels_unknown_in_either_volume_are_left_out() -> None:
    true, dented = volume(block(30, 20, 20)), volume(block(20, 20, 20, (-5, 0, 0)))
    known = true.grid.centres()[..., 0] < 0.005
    assert occupancy_iou(true, dented) == pytest.approx(2 / 3)
    assert occupancy_iou(true, masked(known, dented)) == 1
    assert known_share(masked(known, dented), true) == known.mean()
    assert known_share(true, masked(known, dented)) == 1


def test_volumes_without_known_or_occupied_voxels() -> None:
    true, free, unknown = (Volume(grid(4), np.full((4, 4, 4), value)) for value in (-0.5, 1.0, np.nan))
    assert occupancy_iou(free, free) == 1
    assert occupancy_iou(true, free) == 0
    assert occupancy_iou(true, unknown) == occupancy_iou(unknown, unknown) == 0
    assert known_share(unknown, true) == 0
    assert known_share(unknown, unknown) == 1
    assert surface_chamfer(free, unknown) == 0  # no surface in either


# --- chamfer distance ---


@given(pose=poses(), scale=st.floats(0.1, 10))
def test_the_distance_equals_all_pairs_in_any_world_frame_and_scale(pose: Pose, scale: float) -> None:
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(40, 3)), rng.normal(size=(60, 3)) + 0.3
    pairs = np.linalg.norm(a[:, None] - b, axis=-1)
    expected = (pairs.min(1).mean() + pairs.min(0).mean()) / 2
    assert surface_chamfer(a, b) == pytest.approx(expected, rel=1e-12)
    assert surface_chamfer(b, a) == surface_chamfer(a, b)
    moved = (scale * pose.apply(a), scale * pose.apply(b))
    assert surface_chamfer(*moved) == pytest.approx(scale * expected, rel=1e-6)


def test_a_volume_has_the_distance_of_its_surface_points() -> None:
    a, b = ball(0.02), volume(block(30, 20, 20))
    assert surface_chamfer(a, b) == surface_chamfer(surface_points(a), surface_points(b))
    away = Volume(a.grid.moved(Pose.from_translation((0.1, 0, 0))), a.values)
    assert surface_chamfer(away, b) > 0.05  # volumes are posed in the world


def test_no_surface_is_infinitely_far_from_a_surface() -> None:
    nothing = np.empty((0, 3))
    assert surface_chamfer(nothing, nothing) == 0
    assert surface_chamfer(nothing, ball(0.02)) == surface_chamfer(ball(0.02), nothing) == float("inf")


# --- wrong input ---


def test_volumes_that_cannot_be_compared_are_refused() -> None:
    with pytest.raises(InputError, match=r"expected two on one grid; kit1000\.voxels\.resample samples"):
        occupancy_iou(ball(0.02), ball(0.02, on=grid(voxel=2 * MM)))
    with pytest.raises(ShapeError, match=r"two of one shape, got \(2, 2, 2\) and \(2, 2, 3\)"):
        occupancy_iou(np.zeros((2, 2, 2)), np.zeros((2, 2, 3)))
    with pytest.raises(ShapeError, match=r"b: expected a Volume, or signed distances .* got bool"):
        occupancy_iou(np.zeros((2, 2, 2)), np.zeros((2, 2, 2), bool))
    with pytest.raises(ShapeError, match=r"a: expected float64 of shape \(n, 3\), got shape \(2, 2, 2\)"):
        surface_chamfer(np.zeros((2, 2, 2)), np.zeros((1, 3)))
