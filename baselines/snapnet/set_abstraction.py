"""The layers of PointNet++ (Qi et al. 2017), set abstraction with multi-scale grouping, on flat banks of points.

A bank is a list of points (N, 3) of any number of clouds; a group is a centre among them and k members, given by index.
Groups of many copies of a scene thus go through a layer at once, and what the copies share is in the bank once.
Letters: B scenes, C candidates, N points of a bank, G groups, k members of a group, F features.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from kit1000.numerics.compiled import compiled


class Dense(nn.Module):
    """Linear map, batch norm over all rows, ReLU. (..., inputs) -> (..., outputs)."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.linear = nn.Linear(inputs, outputs, bias=False)  # the norm has one
        self.norm = nn.BatchNorm1d(outputs)

    def forward(self, rows: Tensor) -> Tensor:
        return self.after(functional.linear(rows, self.linear.weight))

    def after(self, mapped: Tensor) -> Tensor:
        """Norm and ReLU, which follow the linear map."""
        return self.normed(mapped).relu_()

    def normed(self, mapped: Tensor) -> Tensor:
        """The norm of each feature over all rows, (..., F)."""
        return self.norm(mapped.flatten(0, -2)).view_as(mapped)

    def folded(self) -> tuple[Tensor, Tensor]:
        """Weight (outputs, inputs) and bias (outputs,) of the linear map and the norm together, when not training."""
        mean, var = self.norm.running_mean, self.norm.running_var
        assert mean is not None
        assert var is not None
        scale = self.norm.weight / torch.sqrt(var + self.norm.eps)
        return self.linear.weight * scale[:, None], self.norm.bias - mean * scale


class MLP(nn.Module):
    """Dense layers from each width to the next. (N, F) -> (N, F')."""

    def __init__(self, widths: Sequence[int]) -> None:
        super().__init__()
        self.layers = nn.ModuleList(Dense(a, b) for a, b in pairwise(widths))

    def __iter__(self) -> Iterator[Dense]:
        return (cast(Dense, layer) for layer in self.layers)

    def forward(self, rows: Tensor) -> Tensor:
        return mlp(list(self), rows)


def mlp(layers: list[Dense], rows: Tensor) -> Tensor:
    """The layers applied to rows (N, F), with the norms folded into the maps when not training. (N, F')."""
    for layer in layers:
        if layer.training:
            rows = layer(rows)
        else:
            weight, bias = layer.folded()
            rows = torch.addmm(bias, rows, weight.T).relu_()
    return rows


@dataclass(frozen=True, eq=False)
class Groups:
    """Indices into a bank: centres (G,) and, for each scale, members (G, k)."""

    centres: Tensor
    members: list[Tensor]

    def joined(self, other: Groups) -> Groups:
        """These groups followed by others."""
        members = [torch.cat(both) for both in zip(self.members, other.members, strict=True)]
        return Groups(torch.cat([self.centres, other.centres]), members)


class SetAbstraction(nn.Module):
    """One set abstraction at several scales: an MLP on the members of each group, then the maximum over them.

    The input of a member is its coordinates and flag relative to those of the centre, and its features.
    """

    def __init__(self, features: int, widths: list[list[int]]) -> None:
        """features: input features of a point, 0 for none; widths: of the layers of each scale."""
        super().__init__()
        self.scales = nn.ModuleList(MLP([4 + features, *layers]) for layers in widths)

    def forward(self, points: Tensor, features: Tensor | None, groups: Groups) -> Tensor:
        """The features of groups.

        Args:
            points: (N, 4) coordinates and flag.
            features: (N, F), or None.
            groups: indices into both.

        Returns:
            (G, F') of all scales, concatenated.
        """
        centre = points[groups.centres][:, None]  # (G, 1, 4)
        scales = []
        for layers, index in zip(self.scales, groups.members, strict=True):
            relative = points[index] - centre  # (G, k, 4)
            pooled = _pooled if self.training else _pooled_folded
            scales.append(pooled(list(cast(MLP, layers)), relative, features, index))
        return torch.cat(scales, -1)


def _pooled(layers: list[Dense], relative: Tensor, features: Tensor | None, index: Tensor) -> Tensor:
    """(G, k, 4) -> (G, F'): the layers, then the maximum over the members."""
    weight = layers[0].linear.weight
    rows = functional.linear(relative, weight[:, :4])
    if features is not None:  # the map is linear: once for each point, not for each member
        rows = rows + functional.embedding(index, functional.linear(features, weight[:, 4:]))
    rows = layers[0].after(rows)
    for layer in layers[1:-1]:
        rows = layer(rows)
    rows = layers[-1].normed(functional.linear(rows, layers[-1].linear.weight))
    return cast(Tensor, _MaxPool.apply(rows)).relu()  # the maximum commutes with ReLU, and leaves fewer rows


def _pooled_folded(layers: list[Dense], relative: Tensor, features: Tensor | None, index: Tensor) -> Tensor:
    """The same with the norms folded into the maps, and the last bias and ReLU after the maximum."""
    weight, bias = layers[0].folded()
    groups, members = index.shape
    rows = torch.addmm(bias, relative.flatten(0, 1).to(weight.dtype), weight[:, :4].T)  # (G k, F)
    if features is not None:
        rows += torch.index_select(features @ weight[:, 4:].T, 0, index.flatten())
    rows = mlp(layers[1:-1], rows.relu_())
    weight, bias = layers[-1].folded()
    return (rows @ weight.T).view(groups, members, -1).amax(1).add_(bias).relu_()


class _MaxPool(torch.autograd.Function):
    """The maximum over the members, (G, k, F) -> (G, F). torch's own gradient of it is far slower on a CPU."""

    @staticmethod
    def forward(ctx: Any, rows: Tensor) -> Tensor:
        image = rows[None].permute(0, 3, 1, 2)  # (1, F, G, k), its features side by side in memory
        values, index = functional.max_pool2d(image, (1, rows.shape[1]), return_indices=True)
        ctx.shape = rows.shape
        ctx.save_for_backward(index[0, :, :, 0].T)  # (G, F), among all G k rows
        return values[0, :, :, 0].T.contiguous()

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> Tensor:
        (index,) = ctx.saved_tensors
        groups, members, features = ctx.shape
        return grads[0].new_zeros(groups * members, features).scatter_(0, index, grads[0]).view(ctx.shape)


def farthest_points(points: Tensor, count: int) -> Tensor:
    """Farthest point sampling: the first point, then always the one farthest from all chosen before.

    Args:
        points: (B, N, 3).
        count: how many, at most N.

    Returns:
        (B, count) indices; of equally far points the first. A smaller count gives a prefix.
    """
    chosen = np.empty((len(points), count), np.int64)
    _farthest(_as_array(points), chosen)
    return torch.from_numpy(chosen).to(points.device)


def ball_query(centres: Tensor, points: Tensor, radii: tuple[float, ...], counts: tuple[int, ...]) -> list[Tensor]:
    """The first points, in their order, within each radius of each centre.

    Args:
        centres: (B, S, 3).
        points: (B, N, 3).
        radii: one for each scale.
        counts: k of each scale.

    Returns:
        For each scale, (B, S, k) indices; -1 where there are no more.
    """
    indices = np.full((*centres.shape[:2], sum(counts)), -1, np.int64)
    ends = np.concatenate([[0], np.cumsum(counts)])
    limits = np.array([np.float32(radius) ** 2 for radius in radii], np.float32)
    _scan(_as_array(centres), _as_array(points), limits, ends, indices)
    return [torch.from_numpy(indices[..., a:b]).to(points.device) for a, b in pairwise(ends.tolist())]


def _as_array(points: Tensor) -> np.ndarray:
    return np.ascontiguousarray(points.detach().cpu().numpy(), np.float32)


@compiled
def _farthest(points, chosen):
    """Write the indices (B, count) of points (B, N, 3) float32."""
    number = points.shape[1]
    nearest = np.empty(number, np.float32)
    for scene in range(len(points)):
        cloud = points[scene]
        nearest[:] = np.inf
        last = 0
        for step in range(chosen.shape[1]):
            chosen[scene, step] = last
            cx, cy, cz = cloud[last, 0], cloud[last, 1], cloud[last, 2]
            last, most = 0, np.float32(-1)
            for i in range(number):
                x, y, z = cloud[i, 0] - cx, cloud[i, 1] - cy, cloud[i, 2] - cz
                nearest[i] = min(nearest[i], x * x + y * y + z * z)
                if nearest[i] > most:
                    last, most = i, nearest[i]


@compiled
def _scan(centres, points, limits, ends, indices):
    """Write the first points (B, N, 3) within each of the rising limits about each centre (B, S, 3), all float32."""
    scales = len(limits)
    have = np.empty(scales, np.int64)
    for scene in range(len(centres)):
        cloud = points[scene]
        for c in range(centres.shape[1]):
            cx, cy, cz = centres[scene, c, 0], centres[scene, c, 1], centres[scene, c, 2]
            have[:] = ends[:-1]
            missing = scales
            for i in range(len(cloud)):
                x, y, z = cx - cloud[i, 0], cy - cloud[i, 1], cz - cloud[i, 2]
                square = x * x + y * y + z * z
                if square > limits[scales - 1]:
                    continue
                for scale in range(scales):
                    if square <= limits[scale] and have[scale] < ends[scale + 1]:
                        indices[scene, c, have[scale]] = i
                        have[scale] += 1
                        missing -= have[scale] == ends[scale + 1]
                if missing == 0:
                    break
