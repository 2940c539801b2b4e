"""The rotation network: scores candidate rotations of the part. PointNet++ with multi-scale grouping.

Layers, radii and counts are the paper's. It departs in these points, so that the kits are processed once for all
candidates:

- points are rotated about the middle of the part's volume, not about the mean of all points, and that middle is the
  origin; all are divided by the largest distance from it, which no rotation changes;
- centres are chosen in each cloud by itself, half of them on the part and half on the kits, by farthest point sampling
  from the first point on, so that they rotate with the part and are the same for every candidate;
- a group about a centre on the part takes half its members from each cloud, where there are enough; one about a centre
  on the kits takes them from the kits alone;
- neighbours within a cloud are found before it is rotated;
- the head has no batch norms: they would normalise over the few candidates of a training step, and there is no such
  batch in prediction; in our trials training with them took off later.

With `kit_distance`, the kits' signed distance at each rotated point of the part is an input feature, interpolated in
their volume: a fit is then visible in points that are farther apart than the clearance.

As in the paper the flag of the fourth channel is relative to the centre in the first two levels, like the coordinates:
0 within a cloud and +-2 across. Its sign matters only in the last level.

Letters: B scenes, C candidates, P points of the part, K of the kits, S centres, k members, F features.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.snapnet.config import RotationConfig
from baselines.snapnet.query_volumes import interpolated, rotated
from baselines.snapnet.set_abstraction import MLP, Groups, SetAbstraction, ball_query, farthest_points

RADII = ((0.1, 0.2, 0.4), (0.2, 0.4, 0.8))  # of the scales of both levels, relative to the largest distance of a point
COUNTS = ((16, 32, 128), (32, 64, 128))  # members of a group
WIDTHS = (
    ((32, 32, 64), (64, 64, 128), (64, 96, 128)),
    ((64, 64, 128), (128, 128, 256), (128, 128, 256)),
)
LAST = (256, 512, 1024)
HEAD = (512, 256)
SPREAD = math.radians(3)  # standard deviation of the target: half the distance between candidates
MEAN_ANGLE = math.radians(15)  # of the candidates in the mean from the best; 8 to 20 degrees did about as well
BATCH = 8  # candidates scored together in prediction: their rows stay in the cache of a CPU


@dataclass(frozen=True, eq=False)
class _Clouds:
    """The points of one level, and which of them are the centres of the next: (B, S) indices into either cloud."""

    part: Tensor
    """(B, P, 3) before the rotation."""
    rotated: Tensor
    """(B, C, P, 3) the part's points, rotated."""
    kit: Tensor
    """(B, K, 3)."""
    part_centres: Tensor
    kit_centres: Tensor
    part_features: Tensor | None = None
    """(B, C, P, F) input features of the rotated points; at the first level."""

    def subset(self, chosen: slice) -> _Clouds:
        """Some of the candidates."""
        features = None if self.part_features is None else self.part_features[:, chosen]
        return replace(self, rotated=self.rotated[:, chosen], part_features=features)

    @property
    def features(self) -> Tensor | None:
        """Input features of the bank, 0 for the kits' points. (B C P + B K, F)."""
        if self.part_features is None:
            return None
        return functional.pad(self.part_features.flatten(0, 2), (0, 0, 0, self.kit.shape[:2].numel()))

    @property
    def bank(self) -> Tensor:
        """All points, the part's first. (B C P + B K, 3)."""
        return torch.cat([self.rotated.flatten(0, 2), self.kit.flatten(0, 1)])

    def next(self, counts: tuple[int, int]) -> _Clouds:
        """The centres, of which the first ones are the next centres: a prefix of farthest points is farthest too."""
        copies = self.rotated.shape[1]
        chosen = self.part_centres[:, None].expand(-1, copies, -1).flatten(0, 1)  # (B C, S)
        moved = _gather(self.rotated.flatten(0, 1), chosen).unflatten(0, (len(self.part), copies))
        part, kit = _gather(self.part, self.part_centres), _gather(self.kit, self.kit_centres)
        first = (torch.arange(count, device=part.device).expand(len(part), -1) for count in counts)
        return _Clouds(part, moved, kit, *first)


class RotationNet(nn.Module):
    """Scores rotations of a part about the middle of its volume.

    Coordinates are float32 throughout. Features have the type of the weights, which may differ by level: with
    `net.levels.to(torch.bfloat16)` nearly all work is done in bfloat16, and the last level and the head in float32.
    """

    def __init__(self, config: RotationConfig) -> None:
        super().__init__()
        self.config = config
        widths = [[[self._wide(n) for n in scale] for scale in level] for level in WIDTHS]
        last, head = [self._wide(n) for n in LAST], [self._wide(n) for n in HEAD]
        first, second = (sum(scale[-1] for scale in level) for level in widths)
        self.levels = nn.ModuleList(
            [SetAbstraction(int(config.kit_distance), widths[0]), SetAbstraction(first, widths[1])]
        )
        self.last = MLP([4 + second, *last])
        self.head = nn.Sequential(
            *(nn.Linear(last[-1], head[0]), nn.ReLU()),
            *(nn.Linear(head[0], head[1]), nn.ReLU()),
            nn.Linear(head[1], 1),
        )

    def forward(self, part: Tensor, kit: Tensor, rotations: Tensor, volume: Tensor | None = None) -> Tensor:
        """Score rotations; in training all at once, otherwise the kits once and the rotations in batches.

        Args:
            part: (B, P, 3) [m] about the middle of the part's volume, before any of the rotations.
            kit: (B, K, 3) [m] about the same middle, at the predicted position.
            rotations: (B, C, 4) wxyz, on the left.
            volume: (B, nx, ny, nz) of the kits about the same middle, in voxels of the config; for `kit_distance`.

        Returns:
            (B, C) logits.
        """
        scaled, kit = _scaled(part, kit)
        centres = (farthest_points(cloud, count) for cloud, count in zip((scaled, kit), self._shares(0), strict=True))
        scene = _Clouds(scaled, rotated(scaled, rotations), kit, *centres)
        if self.config.kit_distance:
            assert volume is not None, "the config has kit_distance"
            distance = interpolated(volume, rotated(part.float(), rotations), self.config.voxel)
            scene = replace(scene, part_features=distance[..., None])
        if self.training:
            parts, kits = self._features(scene, None)
            return self._score(parts, kits)
        kits = self._features(scene.subset(slice(0)), None)[1]
        batches = (scene.subset(slice(first, first + BATCH)) for first in range(0, rotations.shape[1], BATCH))
        return torch.cat([self._score(self._features(clouds, kits)[0], kits) for clouds in batches], 1)

    def _features(self, clouds: _Clouds, kits: list[Tensor] | None) -> tuple[Tensor, list[Tensor]]:
        """The features of all points, level by level.

        Args:
            clouds: of the first level.
            kits: features of the kits, if they are computed already.

        Returns:
            Features of each rotated part (B, C, F), and of the kits: (B S, F) of both levels and (B, F) of the last.
        """
        scenes, copies = clouds.rotated.shape[:2]
        features = clouds.features
        if features is not None:
            features = features.to(next(self.levels.parameters()).dtype)
        made: list[Tensor] = []
        for number, level in enumerate(self.levels):
            groups = _part_groups(clouds, number, self._counts(number))
            parts = len(groups.centres)
            if kits is None:
                groups = groups.joined(_kit_groups(clouds, number, self._counts(number)))
            pooled = level(_flagged(clouds), features, groups)
            made.append(kits[number] if kits else pooled[parts:])
            features = torch.cat([pooled[:parts], made[-1]])
            clouds = clouds.next(self._shares(1))
        assert features is not None
        rows = torch.cat([_flagged(clouds).to(self.dtype), features.to(self.dtype)], -1)
        parts = scenes * copies * clouds.part.shape[1]
        rows = self.last(rows[:parts] if kits else rows)
        made.append(kits[-1] if kits else rows[parts:].unflatten(0, (scenes, -1)).amax(1))
        return rows[:parts].unflatten(0, (scenes, copies, clouds.part.shape[1])).amax(2), made

    def _score(self, parts: Tensor, kits: list[Tensor]) -> Tensor:
        """Logits (B, C) from features (B, C, F) of the rotated parts and those of the kits (B, F)."""
        both = torch.maximum(parts, kits[-1][:, None])
        return self.head(both.flatten(0, 1)).view(both.shape[:2])

    @property
    def dtype(self) -> torch.dtype:
        """Type of the last level and of the logits."""
        return next(self.last.parameters()).dtype

    def _wide(self, channels: int) -> int:
        return max(8, round(channels * self.config.width))

    def _counts(self, level: int) -> tuple[int, ...]:
        """Members of a group at each scale."""
        return tuple(max(2, round(count * self.config.neighbours[level])) for count in COUNTS[level])

    def _shares(self, level: int) -> tuple[int, int]:
        """Centres on the part and on the kits."""
        half = self.config.centres[level] // 2
        return half, self.config.centres[level] - half


def rotation_loss(logits: Tensor, nearest: Tensor, angles: Tensor, config: RotationConfig) -> Tensor:
    """Cross-entropy over the candidates.

    Args:
        logits: (B, C).
        nearest: (B,) int64, the candidate nearest to a correct rotation.
        angles: (B, C) [rad] of each to the nearest correct rotation.
        config: `target` "spread": weights exp(-(a / SPREAD)^2 / 2) of the angles a in place of a one-hot target.

    Returns:
        (B,).
    """
    target = nearest
    if config.target == "spread":
        target = (-((angles.float() / SPREAD) ** 2) / 2).softmax(1)
    return functional.cross_entropy(logits.float(), target, reduction="none")


def rotation_of(logits: Tensor, rotations: Tensor, peak: Literal["candidate", "mean"]) -> Tensor:
    """The best candidate, or the mean of those within MEAN_ANGLE of it, weighted by probability.

    Args:
        logits: (B, C).
        rotations: (B, C, 4) wxyz.
        peak: which of the two.

    Returns:
        (B, 4) unit, wxyz.
    """
    best = logits.argmax(1)
    chosen = rotations[torch.arange(len(best)), best]
    if peak == "candidate":
        return chosen
    cosine = (rotations * chosen[:, None]).sum(-1, keepdim=True)  # of half the angle between, up to the sign
    weight = logits.softmax(1)[..., None] * cosine.sign() * (cosine.abs() >= math.cos(MEAN_ANGLE / 2))
    return functional.normalize((weight * rotations).sum(1), dim=1)


def _scaled(part: Tensor, kit: Tensor) -> tuple[Tensor, Tensor]:
    """Both clouds (B, N, 3), divided by the largest distance of any point of a scene from the origin."""
    far = torch.maximum(*(cloud.float().norm(dim=-1).amax(1) for cloud in (part, kit)))
    far = far.clamp(min=1e-9)[:, None, None]  # all points of a scene may be at the origin
    return part.float() / far, kit.float() / far


def _flagged(clouds: _Clouds) -> Tensor:
    """The bank with the flag of each point: +1 on the part, -1 on the kits. (N, 4)."""
    flag = clouds.rotated.new_full((len(clouds.bank), 1), -1.0)
    flag[: clouds.rotated.shape[:3].numel()] = 1.0
    return torch.cat([clouds.bank, flag], -1)


def _part_groups(clouds: _Clouds, level: int, counts: tuple[int, ...]) -> Groups:
    """Groups about centres on the part, half the members from the part and half from the kits; B C S of them."""
    scenes, copies, points = clouds.rotated.shape[:3]
    centres = clouds.part_centres
    near = ball_query(_gather(clouds.part, centres), clouds.part, RADII[level], tuple(k - k // 2 for k in counts))
    centre_points = clouds.next((0, 0)).rotated  # (B, C, S, 3)
    across = ball_query(centre_points.flatten(1, 2), clouds.kit, RADII[level], tuple(k // 2 for k in counts))
    start = torch.arange(scenes * copies, device=centres.device).view(scenes, copies, 1, 1) * points
    kit_start = (
        scenes * copies * points + torch.arange(scenes, device=centres.device)[:, None, None] * clouds.kit.shape[1]
    )
    members = []
    for same, other in zip(near, across, strict=True):
        same = _padded(same)[:, None] + start  # (B, C, S, k - k // 2)
        other = torch.where(other < 0, -1, other + kit_start).view(*same.shape[:3], other.shape[-1])
        other = torch.where(other < 0, same[..., :1], other)
        members.append(torch.cat([same, other], -1).flatten(0, 2))
    return Groups((centres[:, None] + start[..., 0]).flatten(), members)


def _kit_groups(clouds: _Clouds, level: int, counts: tuple[int, ...]) -> Groups:
    """Groups about centres on the kits, all members from the kits; B S of them."""
    scenes, points = clouds.kit.shape[:2]
    near = ball_query(_gather(clouds.kit, clouds.kit_centres), clouds.kit, RADII[level], counts)
    start = torch.arange(scenes, device=clouds.kit.device)[:, None] * points + clouds.rotated.shape[:3].numel()
    members = [(_padded(index) + start[..., None]).flatten(0, 1) for index in near]
    return Groups((clouds.kit_centres + start).flatten(), members)


def _padded(index: Tensor) -> Tensor:
    """Indices (..., k) with the first in place of missing ones (-1)."""
    return torch.where(index < 0, index[..., :1], index)


def _gather(points: Tensor, index: Tensor) -> Tensor:
    """Points (B, N, 3) at indices (B, S). (B, S, 3)."""
    return points.gather(1, index[..., None].expand(-1, -1, 3))
