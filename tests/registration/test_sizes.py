"""Parts, clearances and plates of any size: the images and volumes of registration are as large as they need to be."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt

from kit1000.camera import Camera, look_at
from kit1000.mesh import Mesh, mesh_from_solid
from kit1000.metrics.volumes import occupancy_iou
from kit1000.perception.completion.parts import CompletedPart, framed
from kit1000.perception.observed.parts import HALF_WIDTH, ObservedPart
from kit1000.pose import Pose, random_quaternions
from kit1000.queries.guesses import MAX_OFFSET
from kit1000.registration.geometry.height_maps import map_cells
from kit1000.registration.geometry.sweeps import BEYOND, CELL, LAYER, REACH, Sweep, envelope_about
from kit1000.registration.search import LEAST_SIDE, SLACK_OFFSET, plate_side
from kit1000.sim.render import render
from kit1000.values import LabelledDepth, View
from kit1000.voxels import Grid, Volume, signed_distance
from tests.samples.completers import Oracle
from tests.samples.shapes import MM, box

CAMERA = Camera(width=400, height=300, fx=420.0, fy=420.0, cx=199.5, cy=149.5)
EYE = look_at((0.35, 0.1, 0.6), (0, 0, 0))
PART, VOXEL = 2, 1e-3


def seen(length: float) -> LabelledDepth:
    """A bar of some length [mm] on a table, 40 mm wide and 30 mm high."""
    return seen_mesh(mesh_from_solid(box(length, 40, 30)).scaled(MM))


def seen_mesh(mesh: Mesh) -> LabelledDepth:
    """A part on a table."""
    table = mesh_from_solid(box(900, 900, 20, (0, 0, -20))).scaled(MM)
    image = render(CAMERA, EYE, [(table, Pose.identity()), (mesh, Pose.identity())], 1)
    return LabelledDepth(View(CAMERA, EYE, image.depth), np.where(image.body_ids > 1, PART, 0).astype(np.uint8))


def cuboid(sides: tuple[float, float, float]) -> Volume:
    """A solid box with sides [m] in a volume that just holds it in any orientation."""
    n = int(np.ceil(np.sqrt(np.square(sides).sum()) / VOXEL)) + 4
    grid = Grid.centred(Pose.identity(), (n, n, n), VOXEL)
    x, y, z = (1e3 * side for side in sides)
    mesh = mesh_from_solid(box(x, y, z, (0, 0, -z / 2))).scaled(MM)
    return signed_distance(grid, [(mesh, Pose.identity())], threads=1)


def swept(part: Volume, rotation: Pose, clearance: float) -> Sweep:
    """The sweep of a part in a rotation about its middle, up to 5 mm above its lowest point."""
    envelope = envelope_about(part, np.zeros(3), rotation, clearance)
    return Sweep.from_envelope(envelope, rotation, float(envelope.min()), 5e-3, clearance)


@pytest.mark.parametrize("length", [40, 60, 110])
def test_the_volume_of_an_observed_part_holds_it(length: float) -> None:
    part = ObservedPart(seen(length), PART, np.array([0, 0, 0.015]))
    volume = part.volume(VOXEL)
    exact = signed_distance(
        volume.grid, [(mesh_from_solid(box(length, 40, 30)).scaled(MM), Pose.identity())], threads=1
    )
    both = ((volume.values < 0) & (exact.values < 0)).sum()
    assert both * VOXEL**3 > 0.85 * (length * 40 * 30 * 1e-9)
    assert occupancy_iou(volume, exact) > 0.85
    assert (part.half_width == HALF_WIDTH) == (length <= 60)  # small parts have the same volume


def test_a_part_larger_than_the_grid_of_the_network_is_completed_in_larger_cells() -> None:
    assert framed(seen(110), PART) is None
    assert framed(seen(60), PART) is not None
    table = mesh_from_solid(box(110, 40, 8, (0, 0, 22)) + box(30, 30, 24)).scaled(MM)  # columns fill all below its top
    part = ObservedPart(seen_mesh(table), PART, np.array([0, 0, 0.015]))
    completed = CompletedPart(part, Oracle(table))
    assert completed.logits is not None
    assert completed.logits.grid.voxel_size > 2e-3
    filled, found = part.volume(VOXEL), completed.volume(VOXEL)
    exact = signed_distance(filled.grid, [(table, Pose.identity())], threads=1)
    assert occupancy_iou(filled, exact) < 0.7
    assert occupancy_iou(found, exact) > 0.85


@settings(max_examples=8)
@given(st.floats(0.02, 0.1), st.floats(0, 12e-3), st.integers(0, 99))
def test_an_image_holds_the_part_and_its_clearance_in_any_rotation(longest: float, clearance: float, seed: int) -> None:
    part = cuboid((longest, 0.02, 0.015))
    rotation = Pose(random_quaternions(np.random.default_rng(seed), 1)[0], np.zeros(3))
    sweep = swept(part, rotation, clearance)
    cells = map_cells(part, clearance, CELL)
    assert sweep.floor.shape == (cells, cells)
    inside = np.isfinite(envelope_about(part, np.zeros(3), rotation, clearance))
    edge = int(min(clearance, 10e-3) / CELL)
    assert inside.any()
    assert not inside[:edge].any()
    assert not inside[-edge - 1 :].any()
    assert not inside[:, :edge].any()
    assert not inside[:, -edge - 1 :].any()


@pytest.mark.parametrize("clearance", [1e-3, 2.5e-3, 10e-3])
def test_distances_from_a_sweep_are_exact_beyond_the_clearance(clearance: float) -> None:
    part = cuboid((0.03, 0.02, 0.01))
    sweep = swept(part, Pose.identity(), clearance)
    envelope = envelope_about(part, np.zeros(3), Pose.identity(), clearance)
    for layer in (0, 3):
        solid = envelope - envelope.min() <= layer * LAYER + 1e-9
        exact = np.maximum(np.asarray(distance_transform_edt(~solid)) - 0.5, 0) * CELL
        reach = max(REACH * CELL, clearance + BEYOND)
        near = exact < reach - CELL
        np.testing.assert_allclose(sweep.distance[layer][near], exact[near], atol=1e-6)
        assert sweep.distance[layer].max() >= clearance + BEYOND - CELL


@settings(max_examples=10)
@given(st.floats(0.02, 0.12), st.floats(1e-3, 10e-3), st.floats(-1, 1), st.floats(-1, 1))
def test_a_plates_map_holds_the_cavity_wherever_a_guess_is(length: float, clearance: float, x: float, y: float) -> None:
    part = cuboid((length, 0.02, 0.015))
    side = plate_side(part, np.zeros(3), clearance)
    corner = np.array([length / 2 + clearance, 0.01 + clearance])
    farthest = np.abs(np.array([x, y])) * (MAX_OFFSET + SLACK_OFFSET) + corner
    assert side >= LEAST_SIDE
    assert (farthest <= side / 2 + VOXEL).all()
