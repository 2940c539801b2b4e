"""python examples/train_network.py tiny

Trains a small 3D convolutional network that predicts the position error of the user's initial guess from two signed
distance volumes, one of the part and one of the kit. Prints the mean error left, in training and in validation. Takes
10 s on two cores; the handful of queries of `tiny` is memorised, not generalised. Needs `pip install 'kit1000[learn]'`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro
from torch import nn

from kit1000 import Dataset, Pose, Query, Truth
from kit1000.dataset.torch import QueryDataset, query_item
from kit1000.voxels import Grid, tsdf

SHAPE, VOXEL = (32, 32, 32), 3e-3  # number of voxels; edge of a voxel [m]


def volumes(query: Query, truth: Truth | None, rng: np.random.Generator) -> dict[str, Any]:
    """Signed distances around the pivot, of the part and of the kits; voxel (i, j, k) coincides after the guess."""
    assert query.guess is not None
    goal = Pose.from_translation(query.guess.apply(query.pivot))
    kit = tsdf(Grid.centred(goal, SHAPE, VOXEL), query.view, query.kit_region)
    part = tsdf(Grid.centred(query.guess.inverse() @ goal, SHAPE, VOXEL), query.view, query.part_mask)
    return {"part": part.filled(1.0), "kit": kit.filled(1.0), **query_item(query, truth)}  # unknown: as if free


def network() -> nn.Module:
    """(n, 2, 32, 32, 32) volumes to (n, 3) offsets [mm]."""
    encoder = (nn.Conv3d(2, 16, 5, 3), nn.ReLU(), nn.Conv3d(16, 32, 3, 2), nn.ReLU())
    return nn.Sequential(*encoder, nn.Flatten(), nn.Linear(32 * 4**3, 3))


def error_mm(net: nn.Module, batch: dict[str, torch.Tensor]) -> torch.Tensor:
    """Mean length of the offset that is left [mm]."""
    volumes = torch.stack([batch["part"], batch["kit"]], dim=1)  # (n, 2, 32, 32, 32)
    return (net(volumes) - batch["offset"] * 1e3).norm(dim=1).mean()


def main(data: tyro.conf.Positional[Path] = Path("tiny"), epochs: int = 10) -> None:
    """Train on the track snap.

    Args:
        data: the dataset folder.
        epochs: passes over the training split.
    """
    dataset = Dataset(data)
    train, val = (QueryDataset(dataset.split(name, truth=True), "snap", volumes) for name in ("train", "val"))
    loader = torch.utils.data.DataLoader(train, batch_size=6, shuffle=True)
    net = network()
    optimizer = torch.optim.Adam(net.parameters(), 2e-3)
    for epoch in range(epochs):
        losses = []
        for batch in loader:
            loss = error_mm(net, batch)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            losses.append(loss.item())
        print(f"epoch {epoch}: {sum(losses) / len(losses):.1f} mm left in training")
    with torch.no_grad():
        (batch,) = torch.utils.data.DataLoader(val, batch_size=len(val))
        print(f"validation: {error_mm(net, batch):.1f} mm left on {len(val)} queries")


if __name__ == "__main__":
    tyro.cli(main)
