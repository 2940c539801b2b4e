"""The position network: layers, correlation, loss and predicted offset, against plain code and closed forms."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from baselines.snapnet import convolutions
from baselines.snapnet.config import POSITION, PositionConfig
from baselines.snapnet.convolutions import SingleChannelConv, correlate, downsampled
from baselines.snapnet.position import Encoder, PositionNet, kit_region, position_loss, position_of, target_of
from kit1000.errors import InputError

TOY = PositionConfig(1e-3, (16, 16, 32), (48, 32, 64), (8, 8, 9), channels=(2, 3, 4, 5, 6), features=3)
LOSS = PositionConfig(2e-3, (16, 16, 16), (32, 32, 32), (6, 7, 8))


@pytest.fixture(autouse=True)
def one_thread() -> None:
    torch.set_num_threads(1)
    torch.manual_seed(7)


def toy(config: PositionConfig = TOY, batch: int = 2) -> tuple[PositionNet, Tensor, Tensor]:
    return PositionNet(config), torch.randn(batch, *config.part_cells), torch.randn(batch, *config.kit_cells)


def centred(scores: Tensor) -> Tensor:
    """(B, x, y, z) minus the mean of each sample, which a softmax ignores."""
    return scores - scores.mean(dim=(1, 2, 3), keepdim=True)


def cells(config: PositionConfig, *offset: float) -> Tensor:
    """(1, 3) [m] of an offset in cells."""
    return torch.tensor([offset]) * 2 * config.voxel


def test_parameters_are_as_many_as_in_the_paper() -> None:
    encoder = Encoder(POSITION["paper"].channels, POSITION["paper"].features)
    assert sum(weight.numel() for weight in encoder.parameters()) == 2_918_214
    assert (encoder.u1.in_channels, encoder.u2.in_channels, encoder.u3.in_channels) == (384, 192, 96)


@pytest.mark.parametrize("preset", POSITION)
def test_presets_fit(preset: str) -> None:
    config = POSITION[preset]
    for (first, last), part, kit, window in zip(
        kit_region(config), config.part_cells, config.kit_cells, config.window, strict=True
    ):
        assert 0 <= first < last <= kit // 2
        assert first + window // 2 + part // 4 == kit // 4  # at cell w // 2, voxel n // 2 coincides with voxel n // 2


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(
    "config",
    [
        TOY,
        replace(TOY, kit_cells=(64, 48, 96)),
        replace(TOY, kit_cells=(32, 32, 48), window=(9, 9, 9)),
        replace(TOY, window=(4, 1, 17)),
    ],
)
def test_scores_are_those_of_the_plain_scheme(config: PositionConfig, dtype: torch.dtype) -> None:
    net, part, kit = toy(config)
    ours = net.to(dtype)(part.to(dtype), kit.to(dtype))
    plain = plain_scores(net.double(), part.double(), kit.double())
    assert ours.shape == plain.shape == (2, *config.window)
    assert plain.std() > 1e-3
    assert (centred(ours) - centred(plain)).abs().max() < (1e-4 if dtype is torch.float32 else 1e-10)


def test_gradients_are_those_of_the_plain_scheme() -> None:
    net, part, kit = toy()
    net, part, kit = net.double(), part.double(), kit.double()
    aim = torch.randn(2, *TOY.window).double()
    taken = [
        torch.autograd.grad((make(part, kit).flatten(1).softmax(1) * aim.flatten(1)).sum(), list(net.parameters()))
        for make in (net, lambda part, kit: plain_scores(net, part, kit))
    ]
    for ours, plain in zip(*taken, strict=True):
        assert torch.allclose(ours, plain, rtol=1e-8, atol=1e-10)


def test_correlation_keeps_small_differences_beside_large_sums() -> None:
    part, kit = torch.rand(1, 2, 12, 12, 12) + 5, torch.rand(1, 2, 20, 20, 20) + 5
    exact = correlate(part.double(), kit.double(), (8, 8, 8))
    assert (correlate(part, kit, (8, 8, 8)) - exact).abs().max() < 1e-4 * exact.std()


@pytest.mark.parametrize("rows", [1, 3, 4])
def test_slabs_change_nothing(monkeypatch: pytest.MonkeyPatch, rows: int) -> None:
    first, second, volume = SingleChannelConv(3), nn.Conv3d(3, 4, 3, stride=2, padding=1), torch.randn(2, 1, 16, 8, 6)
    whole = downsampled(first, second, volume)
    monkeypatch.setattr(convolutions, "SLAB", 0)
    monkeypatch.setattr(convolutions, "SLAB_ROWS", rows)
    assert torch.allclose(downsampled(first, second, volume), whole, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"part_cells": (24, 16, 16)}, "multiples of 16"),
        ({"kit_cells": (16, 32, 64)}, "do not fit"),
        ({"window": (0, 8, 8)}, "do not fit"),
    ],
)
def test_impossible_sizes_are_refused(change: dict[str, tuple[int, int, int]], reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        PositionNet(replace(TOY, **change))  # pyright: ignore[reportArgumentType]


def test_volumes_of_other_sizes_are_refused() -> None:
    net, part, kit = toy()
    with pytest.raises(InputError, match=r"kit: expected volumes \(B, 48, 32, 64\)"):
        net(part, kit[:, 1:])
    with pytest.raises(InputError, match="part: expected volumes"):
        net(part[0], kit)


def test_the_loss_is_smallest_at_the_target() -> None:
    offset = cells(LOSS, 0.25, -1.5, 0.4)
    scores = torch.zeros(1, *LOSS.window, requires_grad=True)
    loss = position_loss(scores, offset, LOSS)
    loss.sum().backward()
    assert scores.grad is not None
    target = scores.detach().softmax(0) * 0 + 1 / (6 * 7 * 8) - scores.grad  # the gradient is softmax minus target
    assert target.sum().item() == pytest.approx(1, abs=1e-5)
    assert position_of(target.clamp(min=0).log(), LOSS).numpy() == pytest.approx(offset.numpy(), abs=1e-8)
    best = position_loss(target.clamp(min=1e-30).log(), offset, LOSS)
    shares = (0.75, 0.25), (0.5, 0.5), (0.6, 0.4)
    entropy = -sum(share * math.log(share) for pair in shares for share in pair)
    assert best.item() == pytest.approx(entropy, rel=1e-4)


@pytest.mark.parametrize("offset", [(0, 0, 0), (0.5, -0.5, 0.1), (-3, -3, -4), (2, 3, 3), (1.99, 2.6, -3.7)])
def test_a_spread_target_is_recovered_exactly(offset: tuple[float, float, float]) -> None:
    position = torch.tensor([offset], dtype=torch.float64)
    target = target_of(position + torch.tensor([3, 3, 4]), LOSS.window).unflatten(1, LOSS.window)
    predicted = position_of(target.log() + 5, LOSS) / (2 * LOSS.voxel)
    assert predicted.numpy() == pytest.approx(position.numpy(), abs=1e-9)


def test_the_peak_cell_gives_its_centre() -> None:
    config = replace(LOSS, peak="cell")
    scores = torch.zeros(2, *LOSS.window)
    scores[0, 3, 3, 4] = scores[1, 5, 0, 7] = 1
    expected = torch.tensor([[0.0, 0, 0], [2, -3, 3]]) * 4e-3
    assert torch.allclose(position_of(scores, config), expected)


@pytest.mark.parametrize("target", ["cell", "spread"])
@pytest.mark.parametrize("offset", [(-3.51, 0, 0), (0, 3.51, 0), (0, 0, 3.51), (0, 9, -9)])
def test_an_offset_outside_the_window_has_no_loss(target: str, offset: tuple[float, float, float]) -> None:
    config = replace(LOSS, target=target)  # pyright: ignore[reportArgumentType]
    scores = torch.randn(2, *LOSS.window, requires_grad=True)
    loss = position_loss(scores, cells(LOSS, *offset).repeat(2, 1), config)
    loss.sum().backward()
    assert scores.grad is not None
    assert loss.tolist() == [0, 0]
    assert not scores.grad.any()


def test_an_offset_within_half_a_cell_of_the_edge_counts_as_the_edge() -> None:
    scores = torch.randn(1, *LOSS.window)
    beyond = position_loss(scores, cells(LOSS, 2.4, 0, -4.4), LOSS)
    assert beyond.item() == pytest.approx(-scores.flatten(1).log_softmax(1).view_as(scores)[0, 5, 3, 0].item())


def balls(config: PositionConfig, offsets: Tensor) -> tuple[Tensor, Tensor]:
    """Balls of different radii: in the middle of part volumes, and at offsets (B, 3) [voxels] in kit volumes."""
    volumes = []
    for sizes, shift in ((config.part_cells, torch.zeros_like(offsets)), (config.kit_cells, offsets)):
        axes = [torch.arange(n) - n // 2 for n in sizes]
        grid = torch.stack(torch.meshgrid(*axes, indexing="ij"), dim=-1)[None]  # (1, x, y, z, 3)
        distance = torch.linalg.norm(grid - shift[:, None, None, None], dim=-1)
        volumes.append(((distance - torch.linspace(3, 5, len(offsets))[:, None, None, None]) / 3).clamp(-1, 1))
    return volumes[0], volumes[1]


@pytest.mark.slow
def test_one_batch_is_memorised() -> None:
    config = PositionConfig(1e-3, (16, 16, 16), (32, 32, 32), (8, 8, 8), channels=(4, 8, 8, 8, 8), features=2)
    offsets = torch.tensor([[4.0, -2, 5], [-5, 3, 0], [1, 1, -6]])
    part, kit = balls(config, offsets)
    net = PositionNet(config)
    adam = torch.optim.Adam(net.parameters(), 3e-3)
    for _ in range(50):
        loss = position_loss(net(part, kit), offsets * config.voxel, config).mean()
        adam.zero_grad()
        loss.backward()
        adam.step()
    error = torch.linalg.norm(position_of(net(part, kit), config) - offsets * config.voxel, dim=1)
    assert error.max() < 1e-3  # half a cell


def test_the_network_names_no_device() -> None:
    """It runs on torch's meta device, which refuses tensors of any other."""
    net, part, kit = toy()
    net, part, kit = net.to("meta"), part.to("meta"), kit.to("meta")
    scores = net(part, kit)
    assert scores.device.type == position_of(scores, TOY).device.type == "meta"
    loss = position_loss(scores, torch.zeros(2, 3, device="meta"), TOY)
    assert loss.device.type == "meta"
    loss.mean().backward()


def plain_scores(net: PositionNet, part: Tensor, kit: Tensor) -> Tensor:
    """The scores of `net`, by the release's scheme: (B, px, py, pz), (B, kx, ky, kz) -> (B, wx, wy, wz)."""
    batch, window = len(part), net.config.window
    key = F.pad(plain_features(net.kit, kit), (0, 1) * 3)  # the padded query may reach one behind the end
    query = F.pad(plain_features(net.part, part), (0, 1) * 3)  # (B, F, p/2 + 1, ...)
    for axis, (first, _) in enumerate(net.region, start=2):
        key = key.narrow(axis, first, query.shape[axis] + window[axis - 2] - 1)
    sums = F.conv3d(key.flatten(0, 1)[None], query.flatten(0, 1)[:, None], groups=key.shape[:2].numel())
    return sums.unflatten(1, (batch, -1))[0].sum(dim=1)  # (B, wx, wy, wz)


def plain_features(net: Encoder, volume: Tensor) -> Tensor:
    """The features of the encoder, module by module: (B, x, y, z) -> (B, F, x/2, y/2, z/2)."""
    d1 = F.relu(net.d1(volume[:, None]))
    d2 = F.relu(net.d2(d1))
    d3 = F.relu(net.d3(d2))
    d4 = F.relu(net.d4(d3))
    features = F.relu(net.b(d4))
    for layer, fine in ((net.u1, d4), (net.u2, d3), (net.u3, d2)):
        concatenated = torch.cat([fine, F.interpolate(features, scale_factor=2.0)], dim=1)
        features = F.relu(F.conv3d(concatenated, layer.weight, layer.bias, padding=1))
    return net.f(features)
