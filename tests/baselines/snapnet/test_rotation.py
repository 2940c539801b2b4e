"""The rotation network: points of volumes, neighbours, what leaves its answer alone, and a plain one beside it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.ndimage import map_coordinates
from torch import Tensor

from baselines.snapnet import rotation
from baselines.snapnet.candidate_rotations import candidates
from baselines.snapnet.config import ROTATION, RotationConfig
from baselines.snapnet.query_volumes import Where, interpolated, rotated, sample_points
from baselines.snapnet.rotation import SPREAD, RotationNet, rotation_loss, rotation_of
from baselines.snapnet.set_abstraction import (
    Groups,
    SetAbstraction,
    ball_query,
    ball_query_sorted,
    farthest_points,
    squared_distances,
)
from kit1000.errors import InputError
from kit1000.pose import Pose, quaternion_angle, quaternion_from_rotvec, quaternion_multiply
from kit1000.rng import stream
from tests.samples.plain_rotation_net import plain_farthest, plain_scores

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


def test_values_between_voxels_are_those_of_a_linear_interpolation():
    volume = stream(0).uniform(-1, 1, (2, 7, 6, 5)).astype(np.float32)
    points = stream(1).uniform(-9e-3, 9e-3, (2, 3, 40, 3)).astype(np.float32)  # some of them outside
    result = interpolated(torch.from_numpy(volume), torch.from_numpy(points), 2e-3)
    for number in range(2):
        indices = np.moveaxis(points[number] / 2e-3 + (3, 3, 2), -1, 0)
        wanted = map_coordinates(volume[number], indices, order=1, mode="nearest")
        np.testing.assert_allclose(result[number], wanted, atol=1e-5)


def test_farthest_points_are_those_of_the_plain_search_and_fewer_are_a_prefix():
    part = scene()[0]
    chosen = farthest_points(part, 20)
    assert torch.equal(chosen, plain_farthest(part, 20))
    assert torch.equal(chosen[:, :7], farthest_points(part, 7))


def test_a_ball_query_gives_the_first_points_within_the_radius():
    part, kit, _, _ = scene()
    radii, counts = (0.005, 0.02, 0.05), (4, 9, 120)
    result = ball_query(part, kit, radii, counts)
    for one, other in zip(result, ball_query_sorted(part, kit, radii, counts), strict=True):
        assert torch.equal(one, other)
    near = squared_distances(part[:, :, None], kit[:, None]) <= np.float32(0.02) ** 2
    for centre in range(part.shape[1]):
        first = near[1, centre].nonzero()[:9, 0].tolist()
        assert result[1][1, centre].tolist() == first + [-1] * (9 - len(first))


def test_a_set_abstraction_ignores_the_order_of_members_and_a_shift_of_the_scene():
    torch.manual_seed(0)
    level = SetAbstraction(0, [[8, 8], [8, 12]]).eval()
    points = torch.randn(50, 4)
    members = [torch.randint(50, (10, 6)), torch.randint(50, (10, 9))]
    groups = Groups(torch.arange(10), members)
    result = level(points, None, groups)
    shuffled = Groups(groups.centres, [index[:, torch.randperm(index.shape[1])] for index in members])
    torch.testing.assert_close(level(points, None, shuffled), result)
    torch.testing.assert_close(level(points + torch.tensor([3.0, -2, 1, 0.5]), None, groups), result)


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


def test_norms_folded_into_the_maps_change_nothing():
    net = random_net()
    result = scores(net, *scene())
    for module in net.modules():
        module.training = not isinstance(module, torch.nn.BatchNorm1d)
    torch.testing.assert_close(scores(net, *scene()), result, atol=1e-4, rtol=0)


def test_candidates_are_scored_independently(monkeypatch):
    net = random_net()
    part, kit, rotations, volume = scene()
    result = scores(net, part, kit, rotations, volume)
    order = torch.randperm(20)
    torch.testing.assert_close(scores(net, part, kit, rotations[:, order], volume), result[:, order], atol=1e-4, rtol=0)
    monkeypatch.setattr(rotation, "BATCH", 3)
    torch.testing.assert_close(scores(net, part, kit, rotations, volume), result, atol=1e-4, rtol=0)
    torch.testing.assert_close(scores(net, part[1:], kit[1:], rotations[1:], volume[1:]), result[1:], atol=1e-4, rtol=0)


def test_the_sign_of_a_quaternion_and_the_size_of_the_scene_do_not_matter():
    net = random_net()
    part, kit, rotations, volume = scene()
    result = scores(net, part, kit, rotations, volume)
    torch.testing.assert_close(scores(net, part, kit, -rotations, volume), result)
    net.config = replace(TOY, voxel=4 * TOY.voxel)
    torch.testing.assert_close(
        scores(net, part * 4, kit * 4, rotations, volume), result
    )  # by a power of two: to the bit


def test_rotating_the_part_first_is_rotating_by_the_product():
    net = random_net()
    part, kit, rotations, volume = scene(scenes=1)
    first = Pose.from_rotvec([0.1, -0.2, 0.3])
    before = torch.from_numpy(first.apply(part.numpy()))
    product = torch.from_numpy(quaternion_multiply(rotations.numpy(), first.wxyz))
    result = scores(net, before.float(), kit, rotations, volume)
    torch.testing.assert_close(result, scores(net, part, kit, product, volume), atol=1e-3, rtol=0)


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


def test_the_loss_is_cross_entropy():
    logits, correct = torch.tensor([[2.0, 0, 1], [0, 3, 0]]), torch.tensor([2, 1])
    angles = torch.tensor([[0.3, 0.2, 0.0], [0.1, 0.0, 0.4]])
    plain = -logits.log_softmax(1)[[0, 1], correct]
    torch.testing.assert_close(rotation_loss(logits, correct, angles, TOY), plain)


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
