"""The relief of a plate, its hidden cells completed by the network."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from kit1000.perception.completion.kits.network import KitCompletionConfig, KitCompletionNet, likely_depths
from kit1000.perception.networks.loading import ready
from kit1000.perception.observed.filled_columns import ObservedColumns
from kit1000.perception.observed.fusion import MaskedView
from kit1000.perception.observed.pixels import subpixel_points
from kit1000.perception.observed.relief import CELL, CELLS, DEEPEST, CompletedRelief, SeenRelief
from kit1000.values import ASSEMBLY_LABEL, LabelledDepth

DEPTH_STEP = 0.01  # [mm] to which depths are rounded: sums of float32 depend on the processor


class ReliefCompleter:
    """The network with its weights."""

    def __init__(self, weights: Path | KitCompletionNet) -> None:
        """weights: stem of the files, or the network itself."""
        net = ready(weights, KitCompletionConfig, KitCompletionNet).to("cpu")  # on which the last digits are known
        self.net = net.to(memory_format=torch.channels_last)

    def __call__(self, relief: SeenRelief) -> CompletedRelief:
        """The relief with likely depths of its hidden cells, never above what is seen free.

        They follow from the mean of the logits of the relief and of its mirror image.
        """
        least, seen = (np.stack([image, image[:, ::-1]]) for image in (relief.least, relief.seen))
        camera = torch.from_numpy(np.stack([relief.camera, relief.camera]))
        with torch.inference_mode():
            logits = self.net(torch.from_numpy(least), torch.from_numpy(seen), camera)
            likely = likely_depths((logits[:1] + logits[1:].flip(3)) / 2)[0].numpy()
        rounded = (np.rint(likely / DEPTH_STEP) * DEPTH_STEP).astype(np.float32)
        hidden = np.maximum(rounded, relief.least)
        return CompletedRelief(relief, np.where(relief.seen, relief.least, hidden))


def filled_by_columns(image: LabelledDepth, shown: SeenRelief) -> CompletedRelief:
    """The relief as `ObservedKits` fills it without the network: DEEPEST in a cell without an observed point."""
    mask = image.labels == ASSEMBLY_LABEL
    half, deep = CELL * CELLS / 2, 1e-3 * DEEPEST
    images, points = [MaskedView(image.view, mask)], subpixel_points(image.view, mask)
    solid = ObservedColumns.of(images, points, shown.world_from_plate, (half, deep), -deep, CELL).filled_cells()
    layers = np.where(solid.any(-1), solid.shape[-1] - solid[..., ::-1].argmax(-1), 0)  # up to the surface
    depth = np.clip(DEEPEST + 0.25 - layers, 0, DEEPEST)  # the middle of the lowest lies 0.25 mm above DEEPEST
    return CompletedRelief(shown, depth.reshape(CELLS, 2, CELLS, 2).mean((1, 3)).astype(np.float32))
