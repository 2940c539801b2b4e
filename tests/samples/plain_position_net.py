"""The position network of SnapNet by the release's scheme, module by module, with the same weights as ours."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from baselines.snapnet.position import Encoder, PositionNet


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
