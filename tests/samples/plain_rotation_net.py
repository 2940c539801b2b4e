"""The rotation network of SnapNet as a plain PointNet++ with the same weights, computed anew for each candidate.

It samples centres, finds neighbours by sorting all distances, gathers groups and maps them by convolutions, for the
kits as for the part.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch
from scipy.ndimage import map_coordinates
from torch import Tensor, nn

from baselines.snapnet.config import RotationConfig
from baselines.snapnet.query_volumes import rotated
from baselines.snapnet.rotation import COUNTS, RADII, RotationNet
from baselines.snapnet.set_abstraction import MLP, Dense, SetAbstraction, squared_distances


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
