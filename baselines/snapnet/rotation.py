"""The rotation network: which of some turned copies of the part fits the kits. PointNet++ with multi-scale grouping.

Layers, radii and counts are the paper's. Where it departs, so that the kits are looked at once for all candidates:

- points are turned about the middle of the part's volume, not about the mean of all points, and that middle is the
  origin; all are divided by the largest distance from it, which no turn changes;
- centres are chosen in each cloud for itself, half of them on the part and half on the kits, by farthest points from
  the first on, so that they turn with the part and are the same for every candidate;
- a group about a centre on the part takes half its members from either cloud, where there are enough; one about a
  centre on the kits takes them from the kits alone: the part looks at the kits, and the kits at themselves;
- who is near whom within a cloud is found before it is turned;
- the head has no batch norms: there they would compare the few candidates of a step with one another, which nobody does
  when answering, and in our trials learning set in later with them.

With `distance` a point of the part also enters with the kits' signed distance where the candidate takes it, looked up
in their volume: a fit can then be told from points alone that lie farther apart than the clearance.

As in the paper the flag of the fourth channel is relative to the centre in the first two levels, like the coordinates:
0 within a cloud and +-2 across. Its sign says more only in the last level.

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
from baselines.snapnet.points import sampled, turned
from baselines.snapnet.set_abstraction import Chain, Groups, Level, farthest, within

RADII = ((0.1, 0.2, 0.4), (0.2, 0.4, 0.8))  # of the scales of both levels, over the largest distance of a point
COUNTS = ((16, 32, 128), (32, 64, 128))  # members of a group
WIDTHS = (
    ((32, 32, 64), (64, 64, 128), (64, 96, 128)),
    ((64, 64, 128), (128, 128, 256), (128, 128, 256)),
)
LAST = (256, 512, 1024)
HEAD = (512, 256)
SPREAD = math.radians(3)  # of the target: half the way from a candidate to the next
AROUND = math.radians(15)  # candidates of the mean; 8 to 20 degrees did about as well on the validation split
AT_ONCE = 8  # candidates that answering takes together: their rows stay in the cache of a processor


@dataclass(frozen=True, eq=False)
class _Clouds:
    """The points of one level, and which of them are the centres of the next: (B, S) indices into either cloud."""

    own: Tensor
    """(B, P, 3) of the part before it is turned."""
    moved: Tensor
    """(B, C, P, 3) of the part, turned."""
    kit: Tensor
    """(B, K, 3)."""
    part_centres: Tensor
    kit_centres: Tensor
    apart: Tensor | None = None
    """(B, C, P, F) what the part's points are told of the kits, where they are; of the first level."""

    def some(self, chosen: slice) -> _Clouds:
        """Just some of the candidates."""
        return replace(self, moved=self.moved[:, chosen], apart=None if self.apart is None else self.apart[:, chosen])

    @property
    def told(self) -> Tensor | None:
        """The same as features of the bank, nothing for the kits' own points. (B C P + B K, F)."""
        if self.apart is None:
            return None
        return functional.pad(self.apart.flatten(0, 2), (0, 0, 0, self.kit.shape[:2].numel()))

    @property
    def places(self) -> Tensor:
        """All as one bank, the part's points first: coordinates and 0. (B C P + B K, 3)."""
        return torch.cat([self.moved.flatten(0, 2), self.kit.flatten(0, 1)])

    def next(self, counts: tuple[int, int]) -> _Clouds:
        """The centres, of which the first few are the next centres: a prefix of farthest points is farthest too."""
        copies = self.moved.shape[1]
        chosen = self.part_centres[:, None].expand(-1, copies, -1).flatten(0, 1)  # (B C, S)
        moved = _taken(self.moved.flatten(0, 1), chosen).unflatten(0, (len(self.own), copies))
        own, kit = _taken(self.own, self.part_centres), _taken(self.kit, self.kit_centres)
        first = (_numbered(cloud, count) for cloud, count in zip((own, kit), counts, strict=True))
        return _Clouds(own, moved, kit, *first)


class RotationNet(nn.Module):
    """Scores turns of a part about the middle of its volume.

    Places are float32 throughout. Features have the type of the weights, which may be two: with
    `net.levels.to(torch.bfloat16)` nearly all work is done in half the bits, and the choice among what it yields in
    float32.
    """

    def __init__(self, config: RotationConfig) -> None:
        super().__init__()
        self.config = config
        widths = [[[self._wide(n) for n in scale] for scale in level] for level in WIDTHS]
        last, head = [self._wide(n) for n in LAST], [self._wide(n) for n in HEAD]
        first, second = (sum(scale[-1] for scale in level) for level in widths)
        self.levels = nn.ModuleList([Level(int(config.distance), widths[0]), Level(first, widths[1])])
        self.last = Chain([4 + second, *last])
        self.head = nn.Sequential(
            *(nn.Linear(last[-1], head[0]), nn.ReLU()),
            *(nn.Linear(head[0], head[1]), nn.ReLU()),
            nn.Linear(head[1], 1),
        )

    def forward(self, part: Tensor, kit: Tensor, turns: Tensor, volume: Tensor | None = None) -> Tensor:
        """Score turns; in training all in one go, otherwise the kits once and the turns a few at a time.

        Args:
            part: (B, P, 3) [m] about the middle of the part's volume, as the part lies before any of the turns.
            kit: (B, K, 3) [m] about the same middle, where the part is to go.
            turns: (B, C, 4) wxyz, on the left.
            volume: (B, nx, ny, nz) of the kits about the same middle, in voxels of the config; read for distances.

        Returns:
            (B, C) logits.
        """
        own, kit = _scaled(part, kit)
        centres = (farthest(cloud, count) for cloud, count in zip((own, kit), self._shares(0), strict=True))
        scene = _Clouds(own, turned(own, turns), kit, *centres)
        if self.config.distance:
            assert volume is not None, "the config has distances"
            told = sampled(volume, turned(part.float(), turns), self.config.voxel)
            scene = replace(scene, apart=told[..., None])
        if self.training:
            found, kits = self._features(scene, None)
            return self._judge(found, kits)
        kits = self._features(scene.some(slice(0)), None)[1]
        few = (scene.some(slice(first, first + AT_ONCE)) for first in range(0, turns.shape[1], AT_ONCE))
        return torch.cat([self._judge(self._features(clouds, kits)[0], kits) for clouds in few], 1)

    def _features(self, clouds: _Clouds, kits: list[Tensor] | None) -> tuple[Tensor, list[Tensor]]:
        """What the network sees in all points.

        Args:
            clouds: of the first level.
            kits: features of the kits, where they are known already.

        Returns:
            Features of each turned part (B, C, F), and of the kits: (B S, F) of both levels and (B, F) of the last.
        """
        scenes, copies = clouds.moved.shape[:2]
        features = clouds.told
        if features is not None:
            features = features.to(next(self.levels.parameters()).dtype)
        made: list[Tensor] = []
        for number, level in enumerate(self.levels):
            groups = _part_groups(clouds, number, self._counts(number))
            parts = len(groups.centres)
            if kits is None:
                groups = groups.joined(_kit_groups(clouds, number, self._counts(number)))
            found = level(_flagged(clouds, self.config), features, groups)
            made.append(kits[number] if kits else found[parts:])
            features = torch.cat([found[:parts], made[-1]])
            clouds = clouds.next(self._shares(1))
        assert features is not None
        rows = torch.cat([_flagged(clouds, self.config).to(self.dtype), features.to(self.dtype)], -1)
        parts = scenes * copies * clouds.own.shape[1]
        rows = self.last(rows[:parts] if kits else rows)
        made.append(kits[-1] if kits else rows[parts:].unflatten(0, (scenes, -1)).amax(1))
        return rows[:parts].unflatten(0, (scenes, copies, clouds.own.shape[1])).amax(2), made

    def _judge(self, found: Tensor, kits: list[Tensor]) -> Tensor:
        """Logits (B, C) of features (B, C, F) of the part, beside those of the kits (B, F)."""
        both = torch.maximum(found, kits[-1][:, None])
        return self.head(both.flatten(0, 1)).view(both.shape[:2])

    @property
    def dtype(self) -> torch.dtype:
        """Of the last level and of the logits."""
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


def rotation_loss(logits: Tensor, nearest: Tensor, distances: Tensor, config: RotationConfig) -> Tensor:
    """Cross-entropy over the candidates that were shown.

    Args:
        logits: (B, C).
        nearest: (B,) int64, which of them is nearest to a right turn.
        distances: (B, C) [rad] of each to the nearest right turn.
        config: `target` "spread" asks for exp(-(d / SPREAD)^2 / 2) over the candidates in place of the right one
            alone; `weight` "distance" multiplies by exp(d / d_max) - 1 of the best candidate's distance, as the release
            does; where the network is right it then learns nothing.

    Returns:
        (B,).
    """
    wanted = nearest
    if config.target == "spread":
        wanted = (-((distances.float() / SPREAD) ** 2) / 2).softmax(1)
    loss = functional.cross_entropy(logits.float(), wanted, reduction="none")
    if config.weight == "even":
        return loss
    chosen = distances.gather(1, logits.argmax(1, keepdim=True))[:, 0]
    return loss * torch.expm1(chosen / distances.amax(1).clamp(min=1e-9))


def turn_of(logits: Tensor, turns: Tensor, peak: Literal["candidate", "mean"]) -> Tensor:
    """The best turn, or the mean of those around it by their probability.

    Args:
        logits: (B, C).
        turns: (B, C, 4) wxyz.
        peak: which of the two.

    Returns:
        (B, 4) unit, wxyz.
    """
    best = logits.argmax(1)
    chosen = turns[torch.arange(len(best)), best]
    if peak == "candidate":
        return chosen
    same = (turns * chosen[:, None]).sum(-1, keepdim=True)  # cosine of half the angle between, but for the sign
    weight = logits.softmax(1)[..., None] * same.sign() * (same.abs() >= math.cos(AROUND / 2))
    return functional.normalize((weight * turns).sum(1), dim=1)


def _scaled(part: Tensor, kit: Tensor) -> tuple[Tensor, Tensor]:
    """Both clouds (B, N, 3) over the largest distance of any point of a scene from the origin."""
    far = torch.maximum(*(cloud.float().norm(dim=-1).amax(1) for cloud in (part, kit)))
    far = far.clamp(min=1e-9)[:, None, None]  # a scene of nothing but its middle stays there
    return part.float() / far, kit.float() / far


def _flagged(clouds: _Clouds, config: RotationConfig) -> Tensor:
    """The bank with its flag. (N, 4)."""
    sign = 1.0 if config.flag == "paper" else -1.0
    flag = clouds.moved.new_full((len(clouds.places), 1), -sign)
    flag[: clouds.moved.shape[:3].numel()] = sign
    return torch.cat([clouds.places, flag], -1)


def _part_groups(clouds: _Clouds, level: int, counts: tuple[int, ...]) -> Groups:
    """About centres on the part: half the members from the part and half from the kits; B C S of them."""
    scenes, copies, points = clouds.moved.shape[:3]
    centres = clouds.part_centres
    near = within(_taken(clouds.own, centres), clouds.own, RADII[level], tuple(k - k // 2 for k in counts))
    places = clouds.next((0, 0)).moved  # (B, C, S, 3)
    across = within(places.flatten(1, 2), clouds.kit, RADII[level], tuple(k // 2 for k in counts))
    start = torch.arange(scenes * copies, device=centres.device).view(scenes, copies, 1, 1) * points
    kit_start = (
        scenes * copies * points + torch.arange(scenes, device=centres.device)[:, None, None] * clouds.kit.shape[1]
    )
    members = []
    for same, other in zip(near, across, strict=True):
        same = _filled(same)[:, None] + start  # (B, C, S, k - k // 2)
        other = torch.where(other < 0, -1, other + kit_start).view(*same.shape[:3], other.shape[-1])
        other = torch.where(other < 0, same[..., :1], other)
        members.append(torch.cat([same, other], -1).flatten(0, 2))
    return Groups((centres[:, None] + start[..., 0]).flatten(), members)


def _kit_groups(clouds: _Clouds, level: int, counts: tuple[int, ...]) -> Groups:
    """About centres on the kits: all members from the kits; B S of them."""
    scenes, points = clouds.kit.shape[:2]
    near = within(_taken(clouds.kit, clouds.kit_centres), clouds.kit, RADII[level], counts)
    start = torch.arange(scenes, device=clouds.kit.device)[:, None] * points + clouds.moved.shape[:3].numel()
    members = [(_filled(index) + start[..., None]).flatten(0, 1) for index in near]
    return Groups((clouds.kit_centres + start).flatten(), members)


def _filled(index: Tensor) -> Tensor:
    """Indices (..., k) with the first in place of those that are missing."""
    return torch.where(index < 0, index[..., :1], index)


def _taken(points: Tensor, index: Tensor) -> Tensor:
    """Points (B, N, 3) at indices (B, S). (B, S, 3)."""
    return points.gather(1, index[..., None].expand(-1, -1, 3))


def _numbered(cloud: Tensor, count: int) -> Tensor:
    """The first indices of each scene. (B, N, 3) -> (B, count) int64."""
    return torch.arange(count, device=cloud.device).expand(len(cloud), -1)
