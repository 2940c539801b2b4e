"""The network that restores depth, and its use: on noisy images of stereo cameras, and on holes in images of scanners.

In a restored image, each pixel of a body shows the likelier of two surfaces. In a scanner's image, pixels with a return
stay as they were measured; a hole is filled if the network is sure of its depth. Its disparities are those that the
d415 would measure, so that scanners of any baseline look alike.

Disparities count from that of the table's plane [px]: 0 on the table, more for what is nearer. B batch; images are
(B, H, W), sides multiples of `PACK * 8`; features (B, C, H / 2, W / 2), channels last in memory.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from scipy.ndimage import binary_opening, find_objects
from torch import Tensor

from kit1000.perception.calibration import flattened
from kit1000.perception.networks.inference import on_cpu, on_grid, ready
from kit1000.perception.networks.unet import UNet, UNetConfig
from kit1000.perception.restoration.disparity import (
    Box,
    Inputs,
    cropped_inputs,
    depths,
    labelled_inputs,
    median_of_shifts,
    padded_box,
    unlabelled_inputs,
)
from kit1000.perception.restoration.rules import closed_gaps
from kit1000.perception.sensor_facts import SensorFacts, simulated_sensor
from kit1000.values import LabelledDepth, View

PACK = 2  # pixels along each side that are channels of one pixel of the network
MAPS, PLANE = 4, 3  # channels: of a pixel; two slopes of the table's plane and the level of noise
SIDE = PACK * 8  # [px] of which sides of images are multiples
DISPARITY_UNIT = 4.0  # [px] of a disparity of 1 in the input
SLOPE_UNIT = 0.05  # [px/px] of a slope of 1
LEVEL_UNIT = 0.2  # [px] of a level of 1
LEAST_SPREAD, FIRST_SPREAD = 0.01, 0.1  # [px]
HEIGHT = 4e-3  # [m] along the ray, in front of the table, from which on something is a body
BORDER = 16  # [px] about bodies
DISPARITY_STEP = 1 / 512  # [px] to which disparities are rounded: the last digits of sums depend on the processor
UNIT = simulated_sensor("d415")  # sensor in whose disparities the network reads and predicts depths
LEAST_SURE = 0.5  # probability of a depth within NEAR, from which on it is filled in
NEAR = 0.12  # [px] of disparity: 1.5 mm from 0.8 m
SURE_DECIMALS = 6  # of that probability: the last digits of exponentials depend on the processor


@dataclass(frozen=True)
class RestorationConfig(UNetConfig):
    """Sizes of the network, and what it reads."""

    labelled: bool = True
    """Whether it reads masks; without them it says where bodies end."""


class Mixture(NamedTuple):
    """What is known of the surface of each pixel: one of two disparities, each with a Laplace distribution."""

    disparity: Tensor
    """(B, 2, H, W) [px] the medians."""
    spread: Tensor
    """(B, 2, H, W) [px] mean absolute deviations."""
    log_share: Tensor
    """(B, 2, H, W) logarithms of the weights."""

    def log_likelihood(self, disparity: Tensor) -> Tensor:
        """(B, H, W) of disparities (B, H, W) [px]."""
        away = (disparity[:, None] - self.disparity).abs() / self.spread
        return torch.logsumexp(self.log_share - torch.log(2 * self.spread) - away, 1)

    def likeliest(self) -> Tensor:
        """(B, H, W) [px]: the median of the likelier component; never one between a near and a far surface."""
        second = self.log_share[:, 1] > self.log_share[:, 0]
        return torch.where(second, self.disparity[:, 1], self.disparity[:, 0])

    def probability_near(self, disparity: Tensor, reach: float) -> Tensor:
        """(B, H, W) that the surface is within a reach [px] of disparities (B, H, W) [px]."""
        away = disparity[:, None] - self.disparity
        near = _laplace((away + reach) / self.spread) - _laplace((away - reach) / self.spread)
        return (self.log_share.exp() * near).sum(1)


def _laplace(x: Tensor) -> Tensor:
    """The cumulative distribution of a Laplace variable of median 0 and mean absolute deviation 1."""
    return torch.where(x < 0, x.clamp(max=0).exp() / 2, 1 - (-x.clamp(min=0)).exp() / 2)


class RestorationNet(UNet):
    """Measured disparities to a mixture a pixel."""

    def __init__(self, config: RestorationConfig) -> None:
        super().__init__(PACK * PACK * MAPS + PLANE, PACK * PACK * 5, config)
        torch.nn.init.zeros_(self.head.weight)  # at first the measured disparities

    def forward(self, disparity: Tensor, returned: Tensor, labels: Tensor, slope: Tensor, level: Tensor) -> Mixture:
        """The mixture of each pixel.

        Args:
            disparity: (B, H, W) [px] measured; where nothing returned, any estimate of it.
            returned: (B, H, W) bool.
            labels: (B, H, W) uint8: 0 the table, 1 the kits, 2 a part; 0 everywhere without masks.
            slope: (B, 2) [px/px] of the disparity of the table's plane, across and down.
            level: (B, 1) [px] how noisy the image is, see `disparity.noise_level`.
        """
        scaled = disparity / DISPARITY_UNIT
        maps = torch.stack([scaled, returned.to(scaled.dtype), *((labels == k).to(scaled.dtype) for k in (1, 2))], 1)
        plane = torch.cat([slope / SLOPE_UNIT, level / LEVEL_UNIT], 1)[:, :, None, None]
        packed = F.pixel_unshuffle(maps, PACK)
        inputs = torch.cat([packed, plane.expand(-1, -1, *packed.shape[2:])], 1)
        out = F.pixel_shuffle(self.image(inputs.contiguous(memory_format=torch.channels_last)), PACK).float()
        spread = FIRST_SPREAD * torch.exp(out[:, 2:4].clamp(-8, 4)) + LEAST_SPREAD
        log_share = F.logsigmoid(torch.cat([out[:, 4:], -out[:, 4:]], 1))
        return Mixture(disparity[:, None] + out[:, :2], spread, log_share)


class Restorer:
    """The network that denoises, with its weights."""

    def __init__(self, weights: Path | RestorationNet) -> None:
        """weights: stem of the files, or the network itself; it calculates in float64 unless it only finds masks."""
        net = ready(weights, RestorationConfig, RestorationNet)
        self.net = on_cpu(net, RestorationConfig, RestorationNet, exact=net.config.labelled)
        self.precision = torch.float64 if net.config.labelled else torch.float32

    def __call__(self, image: LabelledDepth, sensor: SensorFacts, labels: Sequence[int]) -> LabelledDepth:
        """A calibrated image with its table on its plane and the bodies of some labels denoised.

        Bodies of other labels stay as they were measured, but for their narrow shadows; so does all depth of sensors
        that need no restoring.
        """
        return self.begin(image, sensor).with_bodies(labels) if sensor.kind.restores else image

    def begin(self, image: LabelledDepth, sensor: SensorFacts) -> Restoration:
        """The restoration of a calibrated image, of which no body is denoised yet."""
        closed = closed_gaps(image, sensor.simulated_table)
        return Restoration(self, closed, sensor, labelled_inputs(image, closed.view, sensor))

    def without_masks(self, view: View, sensor: SensorFacts) -> View:
        """A calibrated view with bodies and the table about them where they likely are; farther off only the table."""
        read = unlabelled_inputs(view, sensor)
        nothing = np.zeros(view.depth.shape, np.uint8)
        depth = flattened(view, nothing, sensor.simulated_table).depth.copy()
        in_front = read["disparity"] * view.depth**2 / sensor.gain(view.camera)  # [m] of the table
        high = np.asarray(binary_opening((in_front > HEIGHT) & read["returned"], np.ones((3, 3))), bool)
        rows, columns = (np.flatnonzero(high.any(axis)) for axis in (1, 0))
        if len(rows):
            tall, broad = (slice(max(line[0] - BORDER, 0), line[-1] + BORDER + 1) for line in (rows, columns))
            wide = padded_box(tall, broad, SIDE, view.camera)
            depth[wide] = depths(self.likeliest(read, wide), view, wide, sensor)
        return replace(view, depth=depth)

    def likeliest(self, read: Inputs, box: Box) -> np.ndarray:
        """(h, w) [px] the likeliest disparities in a box of the image, rounded."""
        with torch.inference_mode():
            return rounded(self.mixture(read, box).likeliest())

    def mixture(self, read: Inputs, box: Box) -> Mixture:
        """What the network predicts for a box of the image."""
        cut = cropped_inputs(read, box)
        exact = ("disparity", "slope", "level")
        disparity, slope, level = (torch.from_numpy(cut[name])[None].to(self.precision) for name in exact)
        returned, labels = (torch.from_numpy(cut[name])[None] for name in ("returned", "labels"))
        return self.net(disparity, returned, labels, slope, level)


@dataclass(frozen=True, eq=False)
class Restoration:
    """The restoration of one image, body by body."""

    restorer: Restorer
    closed: LabelledDepth
    """The image, its table on its plane and narrow shadows of bodies closed."""
    sensor: SensorFacts
    inputs: Inputs
    """What the network reads of the image."""

    def with_bodies(self, labels: Sequence[int], depth: np.ndarray | None = None) -> LabelledDepth:
        """The image with the bodies of some labels denoised.

        depth: (H, W) [m] of the other bodies; by default those of `closed`.
        """
        view = self.closed.view
        restored = (view.depth if depth is None else depth).copy()
        for wide, mask in bodies_in(self.closed, labels):
            median = median_of_shifts(partial(self.restorer.likeliest, self.inputs), wide, SIDE, view.camera)
            found = depths(median, view, wide, self.sensor)
            restored[wide] = np.where(mask, found, restored[wide])
        return LabelledDepth(replace(view, depth=restored), self.closed.labels)


def bodies_in(image: LabelledDepth, labels: Sequence[int]) -> Iterator[tuple[Box, np.ndarray]]:
    """The box of each body of some labels that the image shows, padded for the network, and its mask (bool) in it."""
    boxes = find_objects(image.labels)
    for label in labels:
        box = boxes[label - 1] if label <= len(boxes) else None
        if box is not None:
            wide = padded_box(box[0], box[1], SIDE, image.view.camera)
            yield wide, image.labels[wide] == label


def rounded(disparity: Tensor) -> np.ndarray:
    """(h, w) [px] float64: disparities (1, h, w), rounded to DISPARITY_STEP."""
    return on_grid(disparity[0].numpy().astype(np.float64), DISPARITY_STEP)


def holes(image: LabelledDepth) -> np.ndarray:
    """(H, W) bool: the pixels of bodies without a return."""
    return (image.labels > 0) & (image.view.depth == 0)


def hole_inputs(image: LabelledDepth, simulated: bool = True) -> Inputs:
    """What the network reads of a calibrated image, see `labelled_inputs`; holes hold a first estimate from beside.

    simulated: whether the table is that of generated scenes.
    """
    return labelled_inputs(image, closed_gaps(image, simulated).view, UNIT)


class HoleFiller(Restorer):
    """The network that fills holes, with its weights."""

    def __call__(self, image: LabelledDepth, sensor: SensorFacts, labels: Sequence[int]) -> LabelledDepth:
        """A calibrated image with the holes of the bodies of some labels filled if the network is sure."""
        read, empty = hole_inputs(image, sensor.simulated_table), holes(image)
        depth = image.view.depth.copy()
        for wide, mask in bodies_in(image, labels):
            disparity, sure = self._likeliest(read, wide)
            filled = empty[wide] & mask & (sure >= LEAST_SURE)
            depth[wide] = np.where(filled, depths(disparity, image.view, wide, UNIT), depth[wide])
        return replace(image, view=replace(image.view, depth=depth))

    def _likeliest(self, read: Inputs, box: Box) -> tuple[np.ndarray, np.ndarray]:
        """(h, w) [px] the likeliest disparities in a box, rounded, and the probability that they are right to NEAR."""
        with torch.inference_mode():
            mixture = self.mixture(read, box)
            likeliest = mixture.likeliest()
            sure = mixture.probability_near(likeliest, NEAR)
        return rounded(likeliest), np.round(sure[0].numpy(), SURE_DECIMALS)
