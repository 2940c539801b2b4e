"""Parts completed by a network: interpolated logits, mirror images, what is seen stays as it was seen; bad weights."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates

from kit1000.camera import Camera, look_at
from kit1000.errors import InputError
from kit1000.mesh import Mesh, mesh_from_solid
from kit1000.metrics.volumes import occupancy_iou
from kit1000.perception.completion.parts.completed import SEEN_FREE, CompletedPart, FillLogits, PartCompleter
from kit1000.perception.completion.parts.frame import CODE, SHAPE, FramedPart, framed, grid_at
from kit1000.perception.completion.parts.network import CompletionConfig, CompletionNet
from kit1000.perception.networks.weight_files import save_weights
from kit1000.perception.observed.parts import ObservedPart
from kit1000.pose import Pose
from kit1000.registration.inputs.volume_sources import DepthSource
from kit1000.sim.render import render
from kit1000.values import FIRST_PART_LABEL, LabelledDepth, View
from kit1000.voxels import Grid, signed_distance
from tests.samples.completers import Oracle
from tests.samples.shapes import MM, box

CAMERA = Camera(width=400, height=300, fx=500.0, fy=500.0, cx=199.5, cy=149.5)
EYE = look_at((0.3, 0.1, 0.55), (0, 0, 0))
PART, VOXEL = 2, 1e-3
SMALL = CompletionConfig(widths=(8, 8, 8, 8), blocks=1)


def table_tee() -> Mesh:
    """A column under a wide top: columns would fill all below it."""
    return mesh_from_solid(box(36, 30, 8, (0, 0, 22)) + box(10, 10, 24)).scaled(MM)


def observed(mesh: Mesh) -> ObservedPart:
    table = mesh_from_solid(box(600, 600, 20, (0, 0, -20))).scaled(MM)
    image = render(CAMERA, EYE, [(table, Pose.identity()), (mesh, Pose.identity())], 1)
    labels = np.where(image.body_ids > 1, PART, 0).astype(np.uint8)
    return ObservedPart(LabelledDepth(View(CAMERA, EYE, image.depth), labels), PART, np.array([0, 0, 0.02]))


def network(seed: int = 0) -> CompletionNet:
    torch.manual_seed(seed)
    return CompletionNet(SMALL)


@settings(max_examples=15, deadline=None)
@given(st.floats(-3, 3), st.floats(-5e-3, 5e-3), st.floats(-5e-3, 5e-3), st.integers(0, 99))
def test_logits_are_interpolated_at_the_voxels_of_another_grid(yaw: float, x: float, y: float, seed: int) -> None:
    source = Grid.centred(Pose.from_rotvec((0, 0, yaw), (x, y, 0.004)), (14, 12, 10), VOXEL)
    values = np.random.default_rng(seed).normal(size=source.shape).astype(np.float32)
    grid = Grid.centred(Pose.from_translation((0, 0, 0.004)), (40, 40, 24), VOXEL / 2)
    found = FillLogits(source, values).at(grid, (1, 1, 2))
    indices = source.indices(grid.centres()[:, :, ::2])
    expected = map_coordinates(values, np.moveaxis(indices, -1, 0), order=1, mode="nearest")
    inside = ((indices >= 0.01) & (indices <= np.array(source.shape) - 1.01)).all(-1)
    outside = ((indices < -0.51) | (indices > np.array(source.shape) - 0.49)).any(-1)
    np.testing.assert_allclose(found[inside], expected[inside], atol=1e-5)
    assert (found[outside] == SEEN_FREE).all()
    assert inside.any()


def test_mirrored_evidence_gives_mirrored_logits() -> None:
    completer = PartCompleter(network())
    codes = np.random.default_rng(1).integers(-CODE, CODE + 1, SHAPE).astype(np.int8)
    camera = np.array([0.7, 0.8], np.float32)
    here, there = (completer(FramedPart(grid_at(0, 0, 0), side, camera)) for side in (codes, codes[:, ::-1].copy()))
    np.testing.assert_allclose(here.values[:, ::-1], there.values, atol=2 / 64)
    assert (here.values[codes == CODE] == SEEN_FREE).all()
    assert ((here.probability >= 0) & (here.probability <= 1)).all()


def test_a_known_part_is_completed_to_itself_where_columns_fill_what_is_not_there() -> None:
    mesh = table_tee()
    part = observed(mesh)
    completed = CompletedPart(part, Oracle(mesh))
    volume = completed.volume(VOXEL)
    exact = signed_distance(volume.grid, [(mesh, Pose.identity())], threads=1).values
    assert occupancy_iou(part.volume(VOXEL).values, exact) < 0.8
    assert occupancy_iou(volume.values, exact) > 0.93
    assert volume.grid == part.volume(VOXEL).grid
    probability = completed.probability(VOXEL)
    assert probability.grid == volume.grid
    assert occupancy_iou(probability.values, exact) > 0.9
    evidence = completed.evidence(VOXEL)
    np.testing.assert_array_equal(evidence.filled.values, volume.values)
    np.testing.assert_array_equal(evidence.possible.values, part.evidence(VOXEL).possible.values)


def test_the_height_of_a_completed_part_is_what_is_seen_of_it() -> None:
    part = observed(table_tee())
    query: Any = SimpleNamespace(image=part.image, part=PART - FIRST_PART_LABEL, pivot=part.pivot, sensor="ideal")
    assert DepthSource(query, Oracle(table_tee())).height == pytest.approx(30e-3, abs=2e-4)
    assert DepthSource(query).height is None  # as high as its filled columns
    assert DepthSource(query, Oracle(table_tee()), part.image).height is None  # noisy


@pytest.mark.parametrize("seed", range(2))
def test_what_is_seen_stays_as_it_was_seen_whatever_a_network_fills_behind_it(seed: int) -> None:
    part, net = observed(table_tee()), network(seed)
    torch.nn.init.constant_(net.head.bias, 1.0)  # pyright: ignore[reportArgumentType] (most of what is hidden is filled)
    columns, volume = part.columns(VOXEL), CompletedPart(part, PartCompleter(net)).volume(VOXEL)
    seen = columns.distance[::2, ::2]
    assert (volume.values[seen > 0] >= 0).all()
    near = (seen < 0) & (seen > -0.2)  # less than half a millimetre behind a surface
    assert (volume.values[near] < 0).mean() > 0.8  # but for pieces that nothing joins


def test_a_part_without_a_return_is_completed_by_columns() -> None:
    part = observed(table_tee())
    image = part.image
    blind = np.where(image.labels == PART, np.float32(0), image.view.depth)
    dropped = replace(part, image=LabelledDepth(replace(image.view, depth=blind), image.labels))
    completed = CompletedPart(dropped, PartCompleter(network()))
    assert framed(dropped.image, PART) is None
    np.testing.assert_array_equal(completed.volume(VOXEL).values, dropped.volume(VOXEL).values)
    assert (completed.probability(VOXEL).values == 1).all()


def test_weights_of_another_network_are_refused(tmp_path: Path) -> None:
    net = network()
    save_weights(tmp_path / "none", net, {"about": {"network": {"cells": 3}}})
    with pytest.raises(InputError, match="no config of a CompletionNet"):
        PartCompleter(tmp_path / "none")
    values = {"widths": [8, 8, 8, 8], "blocks": 2, "parts": 1, "parts_seed": 0, "d415_share": 0.0}
    save_weights(tmp_path / "deep", net, {"about": {"network": values}})
    with pytest.raises(InputError, match="which this network has"):
        PartCompleter(tmp_path / "deep")
    save_weights(tmp_path / "good", net, {"about": {"network": values | {"blocks": 1}}})
    assert torch.equal(PartCompleter(tmp_path / "good").net.head.weight, net.head.weight)
