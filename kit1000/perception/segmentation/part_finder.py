"""The network that separates parts, and its use: each pixel votes for the middle of its part, and votes gather there.

B batch; images are (B, H, W), sides multiples of `SIDE`; heights count from the table, in the pixels that they would
fill at their own distance, so a scene of another size looks alike from a distance in proportion.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from scipy.ndimage import gaussian_filter, maximum_filter
from torch import Tensor

from kit1000.perception.networks.inference import on_cpu, on_grid
from kit1000.perception.networks.unet import UNet, UNetConfig
from kit1000.perception.restoration.disparity import Box, Inputs, cropped_inputs, median_of_shifts, padded_box
from kit1000.perception.segmentation.instances import Bodies, on_far_half
from kit1000.values import View

PACK = 2  # pixels along each side that are channels of one pixel of the network
MAPS, DIRECTIONS = 3, 3  # channels: of a pixel; of the direction that is up
SIDE = PACK * 8  # [px] of which sides of images are multiples
HEIGHT_UNIT = 32.0  # [px] of a height of 1 in the input
OFFSET_UNIT = 16.0  # [px] of an offset of 1 in the output
VOTE_SPREAD = 3.0  # [px] standard deviation of the votes of a part, about
MIDDLES_APART = 8  # [px] between the middles of two parts, at least
LEAST_VOTES = 40  # pixels that gather there
BORDER = 16  # [px] about the parts
OFFSET_STEP = 1 / 8  # [px] to which votes are rounded: sums of float32 depend on the processor
LOGIT_STEP = 1 / 64  # the same of the logits
ON_BODIES = 0.5  # least share of a part's pixels that lie on bodies: elsewhere noise looks like one


class Votes(NamedTuple):
    """What each pixel says."""

    offset: Tensor
    """(B, 2, H, W) [px] across and down, to the mean of the visible pixels of its part."""
    part: Tensor
    """(B, H, W) logit of showing a part."""


class Instances(NamedTuple):
    """The parts that the network sees in an image."""

    labels: np.ndarray
    """(H, W) int: from 1 on the pixels of each part, 0 elsewhere."""
    logits: np.ndarray
    """(H, W) of showing a part; 0 where none is looked for."""


class CentresNet(UNet):
    """Heights to votes."""

    def __init__(self, config: UNetConfig) -> None:
        super().__init__(PACK * PACK * MAPS + DIRECTIONS, PACK * PACK * 3, config)

    def forward(self, measured: Tensor, restored: Tensor, returned: Tensor, up: Tensor) -> Votes:
        """The votes of each pixel.

        Args:
            measured: (B, H, W) [px] heights as measured; any where nothing returned.
            restored: (B, H, W) [px] the same in the restored image.
            returned: (B, H, W) bool.
            up: (B, 3) unit vector in the camera frame.
        """
        scaled = restored / HEIGHT_UNIT
        maps = torch.stack([scaled, measured / HEIGHT_UNIT, returned.to(scaled.dtype)], 1)
        packed = F.pixel_unshuffle(maps, PACK)
        inputs = torch.cat([packed, up[:, :, None, None].expand(-1, -1, *packed.shape[2:])], 1)
        out = F.pixel_shuffle(self.image(inputs.contiguous(memory_format=torch.channels_last)), PACK).float()
        return Votes(OFFSET_UNIT * out[:, :2], out[:, 2])


def inputs_of(bodies: Bodies) -> Inputs:
    """What the network reads of the bodies of an image: see `CentresNet.forward`; (H, W) arrays and `up` (3,)."""
    return inputs_between(bodies.measured, bodies.view)


def inputs_between(measured: View, restored: View) -> Inputs:
    """The same of a measured image and the restored one; (H, W) arrays and `up` (3,)."""
    return {
        "measured": _heights(measured),
        "restored": _heights(restored),
        "returned": measured.depth > 0,
        "up": measured.world_from_camera.inverse().rotate((0.0, 0.0, 1.0)).astype(np.float32),
    }


def _heights(view: View) -> np.ndarray:
    """(H, W) float32 [px] heights above the table, as long as they would be in the image; 0 without surface."""
    camera, pose = view.camera, view.world_from_camera
    x, y, z = pose.rotation_matrix()[2]
    across = (np.arange(camera.width) - camera.cx) / camera.fx * x
    down = (np.arange(camera.height) - camera.cy) / camera.fy * y
    seen = view.depth > 0
    height = pose.xyz[2] / np.where(seen, view.depth, 1.0) + across + down[:, None] + z
    return np.where(seen, camera.fx * height, 0.0).astype(np.float32)


def gathered(places: np.ndarray, part: np.ndarray) -> np.ndarray:
    """(H, W) int: from 1 on the pixels of each part, 0 elsewhere.

    Args:
        places: (2, H, W) [px] row and column of the middle of the part that a pixel shows.
        part: (H, W) bool: pixels that show one.
    """
    labels = np.zeros(part.shape, int)
    votes = places[:, part]
    peaks = _peaks(votes, part.shape)
    if len(peaks):
        away = np.square(votes[:, :, None] - peaks.T[:, None]).sum(0)
        labels[part] = 1 + away.argmin(1)
    return labels


def _peaks(votes: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """(n, 2) [px] where votes (2, k) gather in an image of a shape."""
    row, column = np.rint(np.clip(votes, 0, np.array(shape)[:, None] - 1)).astype(int)
    counts = np.bincount(row * shape[1] + column, minlength=int(np.prod(shape))).reshape(shape)
    density = gaussian_filter(counts.astype(float), VOTE_SPREAD)
    near = 2 * np.pi * VOTE_SPREAD**2 * density  # votes there, if they spread like that
    highest = (density == maximum_filter(density, 2 * MIDDLES_APART + 1)) & (near >= LEAST_VOTES)
    return np.argwhere(highest).astype(float)


class PartFinder:
    """The network with its weights."""

    def __init__(self, weights: Path | CentresNet) -> None:
        """weights: stem of the files, or the network itself."""
        self.net = on_cpu(weights, UNetConfig, CentresNet)

    def __call__(self, bodies: Bodies) -> np.ndarray:
        """(H, W) int: from 1 on the pixels of each part of an image, 0 elsewhere."""
        return self.instances(bodies).labels

    def instances(self, bodies: Bodies) -> Instances:
        """The parts of an image, and how sure each pixel is."""
        labels, logits = np.zeros(bodies.parts.shape, int), np.zeros(bodies.parts.shape)
        rows, columns = (np.flatnonzero(bodies.parts.any(axis)) for axis in (1, 0))
        if len(rows) == 0:
            return Instances(labels, logits)
        tall, broad = (slice(max(line[0] - BORDER, 0), line[-1] + BORDER + 1) for line in (rows, columns))
        box = padded_box(tall, broad, SIDE, bodies.view.camera)
        offset, logits[box] = self.votes(bodies, box)
        found = gathered(
            np.indices(offset.shape[1:]) + offset[::-1], (logits[box] > 0) & ~on_far_half(bodies.points[box])
        )
        pixels, shared = (
            np.bincount(found[mask], minlength=found.max() + 1) for mask in (found > 0, bodies.parts[box])
        )
        labels[box] = np.where((shared >= ON_BODIES * pixels)[found], found, 0)
        return Instances(labels, logits)

    def votes(self, bodies: Bodies, box: Box) -> tuple[np.ndarray, np.ndarray]:
        """(2, h, w) [px] across and down; (h, w) logits of showing a part.

        Each is the median by images that begin at several pixels, see `median_of_shifts`.
        """
        read, camera = inputs_of(bodies), bodies.view.camera
        votes = median_of_shifts(lambda wide: self._votes(read, wide), box, SIDE, camera)
        return votes[:2], votes[2] * LOGIT_STEP

    def _votes(self, inputs: Inputs, box: Box) -> np.ndarray:
        """(3, h, w) offsets [px] across and down, and logits of showing a part; rounded."""
        cut = cropped_inputs(inputs, box)
        batch = [torch.from_numpy(cut[name])[None] for name in ("measured", "restored", "returned", "up")]
        with torch.inference_mode():
            votes = self.net(*batch)
        offset = on_grid(votes.offset[0].numpy().astype(float), OFFSET_STEP)
        return np.concatenate([offset, np.rint(votes.part.numpy() / LOGIT_STEP)])
