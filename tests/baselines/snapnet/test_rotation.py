"""SnapNet's rotation network: points, neighbours, what leaves its answer alone, and a plain one beside it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.ndimage import map_coordinates
from torch import Tensor, nn

from baselines.snapnet.candidate_rotations import candidates
from baselines.snapnet.config import ROTATION, RotationConfig
from baselines.snapnet.query_volumes import Where, rotated, sample_points
from baselines.snapnet.rotation import COUNTS, RADII, SPREAD, RotationNet, rotation_loss, rotation_of
from baselines.snapnet.set_abstraction import MLP, Dense, Groups, SetAbstraction
from kit1000.errors import InputError
from kit1000.pose import Pose, quaternion_angle, quaternion_from_rotvec
from kit1000.rng import stream

TOY = replace(
    ROTATION["small"],
    target="candidate",
    part_points=48,
    kit_points=96,
    width=0.125,
    centres=(24, 8),
    neighbours=(0.25, 0.125),
    training_candidates=6,
)


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def scene(config: RotationConfig = TOY, seed: int = 0, scenes: int = 2) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Points of a box and of the block around it, some candidates, and a volume of random values."""
    rng = stream(seed, "scene")
    part = rng.uniform(-1, 1, (scenes, config.part_points, 3)) * (0.025, 0.015, 0.01)
    kit = rng.uniform(-1, 1, (scenes, config.kit_points, 3)) * (0.05, 0.05, 0.01) - (0, 0, 0.015)
    rotations = candidates("ball").wxyz[rng.permutation(391)[: scenes * 20]].reshape(scenes, 20, 4)
    volume = rng.uniform(-1, 1, (scenes, *config.kit_cells))
    part, kit, volume = (torch.from_numpy(values.astype(np.float32)) for values in (part, kit, volume))
    return part, kit, torch.from_numpy(rotations), volume


def random_net(config: RotationConfig = TOY, seed: int = 0) -> RotationNet:
    """Random weights with different scores for candidates, and norms fitted to some scenes."""
    torch.manual_seed(seed)
    net = RotationNet(config)
    with torch.no_grad():
        for number in range(15):
            net.train()(*scene(config, number + 100))
        last = net.head[-1]
        assert isinstance(last, torch.nn.Linear)
        last.weight.mul_(100)
    return net.eval()


def scores(net: RotationNet, part: Tensor, kit: Tensor, rotations: Tensor, volume: Tensor) -> Tensor:
    with torch.inference_mode():
        return net(part, kit, rotations, volume)


def test_the_papers_network_has_the_papers_number_of_parameters():
    count = sum(p.numel() for p in RotationNet(ROTATION["paper"]).parameters())
    assert count == pytest.approx(1.74e6, rel=0.005)


def test_points_inside_are_voxel_centres_without_repetition():
    volume = np.ones((7, 6, 5))
    volume[2:5, 1:4, 1:3] = -0.5
    points = sample_points(volume, 2e-3, "inside", 18, stream(0))
    assert points.dtype == np.float32
    index = np.round(points / 2e-3).astype(int) + (3, 3, 2)
    np.testing.assert_allclose(points, (index - (3, 3, 2)) * 2e-3, atol=1e-7)
    assert np.all(volume[tuple(index.T)] <= 0)
    assert len(np.unique(index, axis=0)) == 18


def test_points_of_a_ball_lie_on_its_surface_and_not_at_the_edge_of_the_observed():
    index = np.moveaxis(np.indices((24, 24, 24)), 0, -1) - 12
    distance = np.linalg.norm(index, axis=-1) - 7.3  # voxels
    volume = np.clip(distance / 5, -1, 1)
    radii = np.linalg.norm(sample_points(volume, 2e-3, "surface", 400, stream(0)), axis=1)
    np.testing.assert_allclose(radii, 7.3 * 2e-3, atol=0.05 * 2e-3)  # far finer than a voxel
    volume[:, :, :12] = np.where(volume[:, :, :12] < -0.9, 1, volume[:, :, :12])  # unknown beyond the truncation
    radii = np.linalg.norm(sample_points(volume, 2e-3, "surface", 400, stream(0)), axis=1)
    np.testing.assert_allclose(radii, 7.3 * 2e-3, atol=0.05 * 2e-3)


@pytest.mark.parametrize("where", ["inside", "surface"])
def test_too_few_points_are_repeated_and_none_give_the_middle(where: Where):
    volume = np.ones((4, 4, 4))
    assert not sample_points(volume, 1e-3, where, 5, stream(0)).any()
    volume[0, 0, :3] = -0.1
    counts = np.unique(sample_points(volume, 1e-3, where, 100, stream(0)), axis=0, return_counts=True)[1]
    assert counts.sum() == 100
    assert counts.max() - counts.min() <= 1
    with pytest.raises(InputError, match="volume"):
        sample_points(np.ones((2, 2)), 1e-3, where, 5, stream(0))


def test_rotation_is_that_of_poses_and_the_same_alone_to_the_bit():
    part, _, rotations, _ = scene()
    result = rotated(part, rotations)
    for number in range(2):
        poses = Pose(rotations[number].numpy(), np.zeros(3))
        np.testing.assert_allclose(result[number], poses[:, None].apply(part[number].numpy()), atol=1e-7)
    assert torch.equal(result[:, 3:4], rotated(part, rotations[:, 3:4]))


@pytest.mark.parametrize("config", [TOY, replace(TOY, centres=(25, 9), kit_distance=False)])
def test_logits_are_those_of_a_plain_network_with_the_same_weights(config):
    net = random_net(config)
    part, kit, rotations, volume = scene(config)
    result = scores(net, part, kit, rotations, volume)
    assert result.std() > 0.03
    with torch.inference_mode():
        for number in range(2):
            one = slice(number, number + 1)
            plain = plain_scores(net, part[one], kit[one], rotations[one], volume[one])
            torch.testing.assert_close(result[one], plain, atol=1e-4, rtol=0)


def test_the_sign_of_a_quaternion_and_the_size_of_the_scene_do_not_matter():
    net = random_net()
    part, kit, rotations, volume = scene()
    result = scores(net, part, kit, rotations, volume)
    torch.testing.assert_close(scores(net, part, kit, -rotations, volume), result)
    net.config = replace(TOY, voxel=4 * TOY.voxel)
    torch.testing.assert_close(
        scores(net, part * 4, kit * 4, rotations, volume), result
    )  # by a power of two: to the bit


def test_a_scene_without_points_has_finite_logits():
    origin = torch.zeros(1, TOY.part_points, 3)
    result = scores(random_net(), origin, torch.zeros(1, TOY.kit_points, 3), *scene(scenes=1)[2:])
    assert torch.isfinite(result).all()


def test_one_batch_is_memorised():
    torch.manual_seed(0)
    net = RotationNet(TOY).train()
    part, kit, rotations, volume = scene()
    rotations = rotations[:, :6]
    correct = torch.tensor([4, 1])
    optimizer = torch.optim.Adam(net.parameters(), 3e-3)
    for _ in range(40):
        loss = rotation_loss(net(part, kit, rotations, volume), correct, torch.ones(2, 6), TOY).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    assert rotation_loss(net(part, kit, rotations, volume), correct, torch.ones(2, 6), TOY).mean() < 0.1
    assert torch.equal(net(part, kit, rotations, volume).argmax(1), correct)


def test_gradients_are_those_of_finite_differences():
    torch.manual_seed(0)
    level = SetAbstraction(3, [[5, 4]]).double().train()
    points, features = torch.randn(12, 4).double(), torch.randn(12, 3).double().requires_grad_()
    groups = Groups(torch.arange(6), [torch.randint(12, (6, 5))])
    assert torch.autograd.gradcheck(lambda x: level(points, x, groups), (features,))


def test_a_gaussian_of_the_angle_minimises_the_loss_of_a_spread_target():
    angles = torch.tensor([[0.0, 0.05, 0.1], [0.02, 0.3, 0.02]])
    config = replace(TOY, target="spread")
    gaussian = -((angles / SPREAD) ** 2) / 2
    best = rotation_loss(gaussian, torch.tensor([0, 0]), angles, config)
    for seed in range(20):
        torch.manual_seed(seed)
        other = gaussian + 0.3 * torch.randn(2, 3)
        assert (rotation_loss(other, torch.tensor([0, 0]), angles, config) > best).all()


def test_the_mean_around_the_best_candidate_lies_between_candidates():
    rotations, truth = candidates("ball").wxyz, quaternion_from_rotvec([0.13, -0.05, 0.21])
    gaussian = torch.tensor(-((quaternion_angle(rotations, truth) / SPREAD) ** 2) / 2)[None]
    signs = np.where(np.arange(len(rotations)) % 2, 1.0, -1.0)[:, None]
    errors = {}
    for peak in ("candidate", "mean"):
        result = [rotation_of(gaussian, torch.tensor(q)[None], peak) for q in (rotations, rotations * signs)]
        errors[peak] = [float(quaternion_angle(q[0].numpy(), truth)) for q in result]
    np.testing.assert_allclose(errors["candidate"], quaternion_angle(rotations, truth).min(), atol=1e-9)
    np.testing.assert_allclose(errors["mean"], 0, atol=np.radians(0.5))


def plain_scores(net: RotationNet, part: Tensor, kit: Tensor, rotations: Tensor, volume: Tensor) -> Tensor:
    """The same function of the same weights, computed anew for each candidate. Rotations (1, n, 4) -> (1, n)."""
    number, config = rotations.shape[1], net.config
    scale = torch.cat([part, kit], 1).norm(dim=-1).max()
    part_points, kit_points = (cloud.expand(number, -1, -1) / scale for cloud in (part, kit))
    moved = rotated(part / scale, rotations)[0]  # (n, P, 3)
    features = plain_distances(part, kit, rotations, volume, config) if config.kit_distance else None
    for stage, level in enumerate(net.levels):
        assert isinstance(level, SetAbstraction)
        half = config.centres[stage] // 2
        chosen = [plain_farthest(part_points, half), plain_farthest(kit_points, config.centres[stage] - half)]
        places = with_flag(moved, kit_points)
        points = part_points.shape[1]
        centres = torch.cat([chosen[0], chosen[1] + points], 1)
        found = []
        for layers, radius, count in zip(level.scales, RADII[stage], COUNTS[stage], strict=True):
            k = max(2, round(count * config.neighbours[stage]))
            index = plain_groups(part_points, moved, kit_points, chosen, radius, k)
            rows = gather(places, index.flatten(1)).unflatten(1, index.shape[1:]) - gather(places, centres)[:, :, None]
            if features is not None:
                rows = torch.cat([rows, gather(features, index.flatten(1)).unflatten(1, index.shape[1:])], -1)
            assert isinstance(layers, MLP)
            found.append(convolved(layers, rows.permute(0, 3, 1, 2)).amax(3).transpose(1, 2))
        features = torch.cat(found, -1)
        part_points, moved, kit_points = (
            gather(part_points, chosen[0]),
            gather(moved, chosen[0]),
            gather(kit_points, chosen[1]),
        )
    assert features is not None
    rows = torch.cat([with_flag(moved, kit_points), features], -1).transpose(1, 2)[..., None]
    return net.head(convolved(net.last, rows).amax((2, 3))).T


def plain_distances(part: Tensor, kit: Tensor, rotations: Tensor, volume: Tensor, config: RotationConfig) -> Tensor:
    """The kits' distance at the rotated part's points, 0 for the kits' points. (n, P + K, 1)."""
    middle = np.array(volume.shape[1:]) // 2
    places = np.moveaxis(rotated(part, rotations)[0].numpy() / config.voxel + middle, -1, 0)
    found = map_coordinates(volume[0].numpy(), places, order=1, mode="nearest")
    return nn.functional.pad(torch.from_numpy(found.astype(np.float32))[..., None], (0, 0, 0, kit.shape[1]))


def convolved(layers: Iterable[Dense], image: Tensor) -> Tensor:
    """(n, F, G, k) through 1 x 1 convolutions, norms and ReLUs."""
    for layer in layers:
        mapped = nn.functional.conv2d(image, layer.linear.weight[:, :, None, None])
        norm = layer.norm
        mean, var = norm.running_mean, norm.running_var
        image = torch.relu(nn.functional.batch_norm(mapped, mean, var, norm.weight, norm.bias, False, 0.0, norm.eps))
    return image


def plain_groups(
    part_points: Tensor, moved: Tensor, kit_points: Tensor, chosen: list[Tensor], radius: float, k: int
) -> Tensor:
    """Members (n, G, k) in the bank of part and kits."""
    points = part_points.shape[1]
    same = plain_ball_query(gather(part_points, chosen[0]), part_points, radius, k - k // 2)
    across = plain_ball_query(gather(moved, chosen[0]), kit_points, radius, k // 2)
    across = torch.where(across < 0, same[..., :1], across + points)
    kits = padded(plain_ball_query(gather(kit_points, chosen[1]), kit_points, radius, k)) + points
    return torch.cat([torch.cat([padded(same), across], -1), kits], 1)


def padded(index: Tensor) -> Tensor:
    """The first index in place of missing ones (-1)."""
    return torch.where(index < 0, index[..., :1], index)


def squared_distances(a: Tensor, b: Tensor) -> Tensor:
    """(...) of points (..., 3), broadcasting."""
    x, y, z = (a - b).unbind(-1)
    return x * x + y * y + z * z


def plain_ball_query(centres: Tensor, points: Tensor, radius: float, k: int) -> Tensor:
    """First k indices within the radius, by sorting all; -1 where there are no more."""
    distance = squared_distances(centres[:, :, None], points[:, None])
    order = torch.arange(points.shape[1]).expand(distance.shape).clone()
    order[distance > np.float32(radius) ** 2] = points.shape[1]
    first = order.sort(-1).values[..., :k]
    first = torch.where(first == points.shape[1], -1, first)
    return nn.functional.pad(first, (0, k - first.shape[-1]), value=-1)


def plain_farthest(points: Tensor, count: int) -> Tensor:
    """Farthest points, one after another."""
    chosen = torch.zeros(len(points), count, dtype=torch.long)
    nearest, last = torch.full(points.shape[:2], torch.inf), torch.zeros(len(points), dtype=torch.long)
    for step in range(count):
        chosen[:, step] = last
        nearest = torch.minimum(nearest, squared_distances(points, gather(points, last[:, None])))
        last = nearest.max(-1).indices
    return chosen


def gather(points: Tensor, index: Tensor) -> Tensor:
    """(n, N, F) at (n, S) -> (n, S, F)."""
    return points[torch.arange(len(points))[:, None], index]


def with_flag(moved: Tensor, kit_points: Tensor) -> Tensor:
    clouds = ((moved, 1.0), (kit_points, -1.0))
    return torch.cat([nn.functional.pad(cloud, (0, 1), value=value) for cloud, value in clouds], 1)
