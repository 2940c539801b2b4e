"""Reliefs of solids against rays, closed forms and a search that reads every sample; dilation against brute force."""

from __future__ import annotations

from itertools import product

import numpy as np
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from kit1000.mesh import Mesh
from kit1000.pose import Pose
from kit1000.registration.geometry.height_maps import RADIUS, dilated, lower_envelope, read_value
from kit1000.voxels import Grid, signed_distance
from tests.samples.registration_cases import columns, cuboid, volume_of
from tests.samples.strategies import poses, quaternions

IDENTITY = Pose.identity()


@given(pose=poses(), along=quaternions())
@settings(max_examples=10)
def test_the_envelope_is_that_of_every_sample_read(pose: Pose, along: np.ndarray) -> None:
    """Bit for bit: samples below the box of values other than 1, which are not read, change no step."""
    grid = Grid.centred(Pose.from_translation(pose.xyz), (64, 64, 64), 1e-3)
    volume = signed_distance(grid, [(cuboid(), pose)], threads=1)
    assert (volume.values == 1).any()
    about, cells = Pose(along, np.zeros(3)) @ Pose.from_translation(-pose.xyz), 24
    envelope = lower_envelope(volume, about, 2e-3, cells)
    from_plane = volume.grid.world_from_grid.inverse() @ about.inverse()
    linear, origin = from_plane.rotation_matrix() / 1e-3, from_plane.xyz / 1e-3
    box = np.array(list(product(*[(side.min() - 1.0, side.max() + 1.0) for side in np.nonzero(volume.occupied)])))
    assert about.apply(volume.grid.world(box))[:, 2].min() > -RADIUS  # so that all begin there
    for i, j in product(range(cells), repeat=2):
        (u, v), w, before, low, height = columns(2e-3, cells)[i, j], -RADIUS, 1.0, -RADIUS, np.inf
        while w < RADIUS and height == np.inf:
            at = [linear[k, 0] * u + linear[k, 1] * v + origin[k] + linear[k, 2] * w for k in range(3)]
            value = read_value(volume.values, *at)
            if value < 0:
                height = low + (w - low) * before / (before - value) if before > value else w
            before, low = value, w
            w += max(value * 5e-3, 0.25e-3)
        assert envelope[i, j] == height


def test_the_envelope_of_a_ball_is_a_bowl() -> None:
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.02)
    volume = volume_of(Mesh(np.array(ball.vertices), np.array(ball.faces, dtype=np.int32)))
    out = np.linalg.norm(columns(1e-3, 60), axis=-1)
    envelope = lower_envelope(volume, IDENTITY, 1e-3, 60)
    np.testing.assert_allclose(envelope[out < 0.018], -np.sqrt(0.02**2 - out[out < 0.018] ** 2), atol=0.05e-3)
    assert np.isposinf(envelope[out > 0.0202]).all()


def lowest_around(image: np.ndarray, radius: float) -> np.ndarray:
    """The minimum within a radius [cells] of each cell, cell by cell."""
    n = len(image)
    low = np.full((n, n), np.inf)
    for i, j in np.ndindex(n, n):
        u, v = np.ogrid[:n, :n]
        low[i, j] = image[(u - i) ** 2 + (v - j) ** 2 <= radius**2].min()
    return low


def spotted(seed: int, n: int = 17) -> np.ndarray:
    """(n, n) random heights, most columns empty."""
    rng = np.random.default_rng(seed)
    return np.where(rng.random((n, n)) < 0.15, rng.uniform(-0.02, 0, (n, n)), np.inf)


@given(cells=st.integers(0, 5), seed=st.integers(0, 99))
def test_dilation_by_whole_cells_is_the_minimum_in_a_disc(cells: int, seed: int) -> None:
    image = spotted(seed)
    np.testing.assert_array_equal(dilated(image, 0.5e-3, cells * 0.5e-3), lowest_around(image, cells + 0.5))


@given(clearance=st.floats(0, 2.5e-3), seed=st.integers(0, 99))
def test_dilation_reaches_the_clearance_to_within_half_a_cell(clearance: float, seed: int) -> None:
    image, cell = spotted(seed), 0.5e-3
    bigger = dilated(image, cell, clearance)
    assert (bigger <= lowest_around(image, clearance / cell - 1e-9)).all()
    assert (bigger >= lowest_around(image, np.sqrt(2) * clearance / cell + 0.5)).all()
