"""Restoration of noisy depth: ideal images stay, the table is flat, gaps close, and edges return to where they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.ndimage import binary_erosion

from kit1000.camera import look_at
from kit1000.mesh import Mesh
from kit1000.perception.restoration import restored, restored_query
from kit1000.perception.restoration.rules import GAP, close_gaps
from kit1000.perception.sensor_facts import simulated_sensor
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.sim.cameras import CAMERA
from kit1000.sim.layout import table
from kit1000.sim.render import render
from kit1000.sim.sensors import SENSORS, sense
from kit1000.values import LabelledDepth, Query, View

CAMERA_POSE = look_at((0.25, 0.03, 0.6), (0.0, 0.03, 0.02))  # sees no edge of the table
TOP, FLOOR = 0.05, 0.01  # [m] heights of a ring and of the block in it: 45 mm of depth along the ray, 2 px or more

D415 = simulated_sensor("d415")


@pytest.fixture(scope="module")
def ring() -> LabelledDepth:
    """A ring with a floor, one body, on the table."""
    outside = trimesh.creation.box(
        extents=(0.2, 0.2, TOP), transform=trimesh.transformations.translation_matrix((0, 0, TOP / 2))
    )
    hole = trimesh.creation.box(
        extents=(0.1, 0.1, TOP), transform=trimesh.transformations.translation_matrix((0, 0, TOP / 2 + FLOOR))
    )
    cut = outside.difference(hole)
    body = Mesh(np.array(cut.vertices), np.array(cut.faces, dtype=np.int32))
    image = render(CAMERA, CAMERA_POSE, [(table(), Pose.identity()), (body, Pose.identity())])
    return LabelledDepth(View(CAMERA, CAMERA_POSE, image.depth), (image.body_ids == 2).astype(np.uint8))


def measured(image: LabelledDepth, seed: int) -> LabelledDepth:
    return LabelledDepth(sense("d415", image.view, stream(seed, "ring")), image.labels)


def query_of(image: LabelledDepth, sensor: str) -> Query:
    return Query("q", "s", "snap", sensor, 0, True, np.zeros(3), None, lambda: image)


def heights(image: LabelledDepth) -> np.ndarray:
    return image.view.world_from_camera.apply(image.view.camera.unproject(image.view.depth))[..., 2]


def test_an_ideal_image_is_not_touched(ring: LabelledDepth) -> None:
    query = query_of(ring, "ideal")
    assert restored(ring, simulated_sensor("ideal")) is ring
    assert restored_query(query) is query


def test_a_query_is_restored_once_and_keeps_all_else(ring: LabelledDepth) -> None:
    query = query_of(measured(ring, 0), "d415")
    there = restored_query(query)
    assert there.image is there.image
    assert there.image.view.depth.tobytes() == restored(query.image, D415).view.depth.tobytes()
    assert replace(there, read_image=query.read_image).read_image is query.read_image
    assert (there.id, there.sensor, there.guess) == (query.id, query.sensor, query.guess)


def test_the_table_lies_on_its_plane(ring: LabelledDepth) -> None:
    flat = restored(measured(ring, 0), D415)
    on_table = (ring.labels == 0) & (ring.view.depth > 0)
    assert np.abs(heights(flat)[on_table]).max() < 1e-6


def test_an_exact_image_changes_only_in_front_of_its_jumps(ring: LabelledDepth) -> None:
    exact = restored(ring, D415)
    changed = np.abs(exact.view.depth - ring.view.depth) > 3e-4
    reach = SENSORS["d415"].fattening_px
    top = (ring.labels == 1) & (heights(ring) > TOP - 1e-3)
    inner = np.asarray(binary_erosion(top, np.ones((2 * int(reach) + 1,) * 2)), bool)
    assert changed.any()
    assert not changed[inner].any()
    assert not changed[(ring.labels == 1) & (heights(ring) < FLOOR + 1e-3)].any()


def test_fattened_edges_return_to_where_they_are(ring: LabelledDepth) -> None:
    """On average, as how far the sensor extends an edge is random: most of the floor that it hides comes back."""
    floor = (ring.labels == 1) & (heights(ring) < FLOOR + 1e-3)
    lost, left = [], []
    for seed in range(3):
        image = measured(ring, seed)
        lost.append(hidden_floor(ring, image, floor))
        left.append(hidden_floor(ring, restored(image, D415), floor))
    assert np.mean(lost) > 2 * np.any(floor, axis=0).sum()  # two pixels on each column
    assert abs(np.mean(left)) < 0.5 * np.mean(lost)


def hidden_floor(true: LabelledDepth, image: LabelledDepth, floor: np.ndarray) -> int:
    """How many pixels of the floor an image shows near the top, less those of the top near the floor."""
    low = (true.labels == 1) & (image.view.depth > 0) & (heights(image) < (TOP + FLOOR) / 2)
    return int((floor & ~low).sum() - (low & (heights(true) > TOP - 1e-3)).sum())


def test_gaps_take_the_farther_side_and_wide_ones_stay(ring: LabelledDepth) -> None:
    image = measured(ring, 0)
    row = int(np.flatnonzero((ring.labels == 1).any(1)).mean())
    first, last = np.flatnonzero(ring.labels[row] == 1)[[0, -1]]
    depth = image.view.depth.copy()
    depth[row, first + 12 : first + 12 + GAP] = 0
    depth[row, last - 12 - 3 * GAP : last - 12] = 0
    holed = LabelledDepth(replace(image.view, depth=depth), image.labels)
    closed = restored(holed, D415).view.depth[row]
    assert (closed[first + 12 : first + 12 + GAP] > 0).all()
    assert (closed[last - 12 - 2 * GAP : last - 12 - GAP] == 0).all()


@given(image=arrays(np.float32, (9, 11), elements=st.sampled_from([0.0, 0.0, 0.5, 0.6, 0.7])))
def test_gaps_closed_along_columns_too_are_the_farther_of_both_ways(image: np.ndarray) -> None:
    """And the same on the transposed image; what returned stays."""
    mask = np.ones(image.shape, bool)
    rows, columns, both, transposed = image.copy(), image.T.copy(), image.copy(), image.T.copy()
    close_gaps(rows, mask)
    close_gaps(columns, mask.T)
    close_gaps(both, mask, columns=True)
    close_gaps(transposed, mask.T, columns=True)
    np.testing.assert_array_equal(both, np.maximum(rows, columns.T))
    np.testing.assert_array_equal(both, transposed.T)
    np.testing.assert_array_equal(both[image > 0], image[image > 0])


def test_a_moved_world_changes_nothing_in_the_image(ring: LabelledDepth) -> None:
    """Shifts and turns about the vertical, where the image shows no outline of the table."""
    image = measured(ring, 1)
    motion = Pose.from_rotvec((0, 0, 0.7), (0.1, -0.05, 0))
    moved = LabelledDepth(replace(image.view, world_from_camera=motion @ image.view.world_from_camera), image.labels)
    here, there = restored(image, D415).view, restored(moved, D415).view
    np.testing.assert_allclose(there.depth, here.depth, atol=2e-6)
    np.testing.assert_allclose((motion @ here.world_from_camera).xyz, there.world_from_camera.xyz, atol=1e-7)


def test_an_image_without_bodies_or_returns_passes(ring: LabelledDepth) -> None:
    nothing = LabelledDepth(ring.view, np.zeros_like(ring.labels))
    blind = LabelledDepth(replace(ring.view, depth=np.zeros_like(ring.view.depth)), ring.labels)
    assert not restored(blind, D415).view.depth[ring.labels > 0].any()
    assert restored(nothing, D415).view.depth.shape == ring.view.depth.shape
