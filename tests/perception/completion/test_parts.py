"""Parts completed by a network: its loss, interpolated logits, mirror images; what is seen stays as it was seen."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates

from kit1000.camera import Camera, look_at
from kit1000.mesh import Mesh, mesh_from_solid
from kit1000.metrics.volumes import occupancy_iou
from kit1000.perception.completion.parts import (
    CODE,
    SEEN_FREE,
    SHAPE,
    CompletedPart,
    CompletionNet,
    FillLogits,
    FramedPart,
    PartCompleter,
    completion_loss,
    grid_at,
    network_input,
)
from kit1000.perception.networks.unet import UNetConfig
from kit1000.perception.observed.parts import ObservedPart
from kit1000.pose import Pose
from kit1000.registration.part_volume import seen_part
from kit1000.sim.render import render
from kit1000.values import LabelledDepth, View
from kit1000.voxels import Grid, signed_distance
from tests.samples.completers import Oracle
from tests.samples.shapes import MM, box

CAMERA = Camera(width=400, height=300, fx=500.0, fy=500.0, cx=199.5, cy=149.5)
EYE = look_at((0.3, 0.1, 0.55), (0, 0, 0))
PART, VOXEL = 2, 1e-3
SMALL = UNetConfig(widths=(8, 8, 8, 8))


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
    evidence = completed.bounds(VOXEL)
    np.testing.assert_array_equal(evidence.filled.values, volume.values)
    np.testing.assert_array_equal(evidence.possible.values, part.bounds(VOXEL).possible.values)


def test_the_height_of_a_completed_part_is_what_is_seen_of_it() -> None:
    part, oracle = observed(table_tee()), Oracle(table_tee())
    assert seen_part(part, part.image, oracle, restores=False).height == pytest.approx(30e-3, abs=2e-4)
    assert seen_part(part, part.image, None, restores=False).height is None  # as high as its filled columns
    assert seen_part(part, part.image, oracle, restores=True).height is None  # noisy


SIZES = (2, 8, 8, 16)


def batch(seed: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Logits, codes, solid."""
    torch.manual_seed(seed)
    codes = torch.randint(-CODE, CODE + 1, SIZES, dtype=torch.int8)
    codes[torch.rand(SIZES) < 0.3] = CODE
    return 3 * torch.randn(SIZES), codes, torch.randint(0, 256, SIZES).to(torch.uint8)


def test_a_part_that_is_all_seen_free_has_a_finite_loss() -> None:
    logits, codes, solid = batch(0)
    loss = completion_loss(logits.requires_grad_(), torch.full_like(codes, CODE), torch.zeros_like(solid))
    loss.backward()
    assert torch.isfinite(loss)
    assert logits.grad is not None
    assert (logits.grad == 0).all()


def test_mirrored_evidence_is_a_mirrored_image_and_the_net_has_a_logit_a_cell() -> None:
    torch.manual_seed(0)
    codes = torch.randint(-CODE, CODE + 1, (1, 40, 40, 208), dtype=torch.int8)
    camera = torch.tensor([[0.7, 0.9]])
    here, there = network_input(codes, camera), network_input(codes.flip(2), camera)
    torch.testing.assert_close(here.flip(3), there)
    net = network()
    with torch.autocast("cpu", torch.bfloat16):
        logits = net.eval()(codes, camera)
    assert logits.shape == codes.shape
    assert torch.isfinite(logits).all()
