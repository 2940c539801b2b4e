"""Restoration by the network: each pixel of a body shows the likelier of two surfaces."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from scipy.ndimage import binary_opening, find_objects
from torch import Tensor

from kit1000.perception.calibration import flattened
from kit1000.perception.networks.loading import ready
from kit1000.perception.networks.unet import folded, in_float64
from kit1000.perception.restoration.disparity import (
    Box,
    Evidence,
    cropped_evidence,
    depths,
    evidence,
    padded_box,
    shifted_boxes,
    unlabelled_evidence,
)
from kit1000.perception.restoration.network import SIDE, Mixture, RestorationConfig, RestorationNet
from kit1000.perception.restoration.rules import closed_gaps
from kit1000.perception.sensor_facts import SensorFacts
from kit1000.values import LabelledDepth, View

HEIGHT = 4e-3  # [m] along the ray, in front of the table, from which on something is a body
BORDER = 16  # [px] about bodies
DISPARITY_STEP = 1 / 512  # [px] to which disparities are rounded: the last digits of sums depend on the processor


class Restorer:
    """The network with its weights."""

    def __init__(self, weights: Path | RestorationNet) -> None:
        """weights: stem of the files, or the network itself.

        With masks it calculates in float64: of 399 predictions from images restored in float32 a quarter depended on
        the processor, by up to 2 mm, for about one pixel in 200,000 was rounded otherwise. Without masks only masks
        come of it.
        """
        net = folded(ready(weights, RestorationConfig, RestorationNet)).to("cpu")  # on which the last digits are known
        exact = net.config.labelled
        self.net = in_float64(net) if exact else net.to(memory_format=torch.channels_last)
        self.precision = torch.float64 if exact else torch.float32

    def __call__(self, image: LabelledDepth, sensor: SensorFacts, labels: Sequence[int]) -> LabelledDepth:
        """A calibrated image with its table on its plane and the bodies of some labels denoised.

        Bodies of other labels stay as they were measured, but for their narrow shadows; so does all depth of sensors
        that need no restoring.
        """
        return self.begin(image, sensor).with_bodies(labels) if sensor.kind.restores else image

    def begin(self, image: LabelledDepth, sensor: SensorFacts) -> Restoration:
        """The restoration of a calibrated image, of which no body is denoised yet."""
        closed = closed_gaps(image, sensor.simulated_table)
        return Restoration(self, closed, sensor, evidence(image, closed.view, sensor))

    def without_masks(self, view: View, sensor: SensorFacts) -> View:
        """A calibrated view with bodies and the table about them where they likely are; farther off only the table."""
        read = unlabelled_evidence(view, sensor)
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

    def likeliest(self, read: Evidence, box: Box) -> np.ndarray:
        """(h, w) [px] the likeliest disparities in a box of the image, rounded."""
        with torch.inference_mode():
            likeliest = mixture_in(self.net, read, box, self.precision).likeliest()
        return rounded(likeliest)


@dataclass(frozen=True, eq=False)
class Restoration:
    """The restoration of one image, body by body."""

    restorer: Restorer
    closed: LabelledDepth
    """The image, its table on its plane and narrow shadows of bodies closed."""
    sensor: SensorFacts
    inputs: Evidence
    """What the network reads of the image."""

    def with_bodies(self, labels: Sequence[int], depth: np.ndarray | None = None) -> LabelledDepth:
        """The image with the bodies of some labels denoised.

        depth: (H, W) [m] of the other bodies; by default those of `closed`.
        """
        view = self.closed.view
        restored = (view.depth if depth is None else depth).copy()
        for wide, mask in bodies_in(self.closed, labels):
            found = depths(self._median(wide), view, wide, self.sensor)
            restored[wide] = np.where(mask, found, restored[wide])
        return LabelledDepth(replace(view, depth=restored), self.closed.labels)

    def _median(self, box: Box) -> np.ndarray:
        """(h, w) [px] the median of the likeliest disparities in a box, by images that begin at several pixels.

        The network is coarse inside: where an image begins, to SIDE px, changes what it predicts beside edges.
        """
        boxes = shifted_boxes(box, SIDE, self.closed.view.camera)
        return np.median([self.restorer.likeliest(self.inputs, wide)[inside] for wide, inside in boxes], axis=0)


def bodies_in(image: LabelledDepth, labels: Sequence[int]) -> Iterator[tuple[Box, np.ndarray]]:
    """The box of each body of some labels that the image shows, padded for the network, and its mask (bool) in it."""
    boxes = find_objects(image.labels)
    for label in labels:
        box = boxes[label - 1] if label <= len(boxes) else None
        if box is not None:
            wide = padded_box(box[0], box[1], SIDE, image.view.camera)
            yield wide, image.labels[wide] == label


def mixture_in(net: RestorationNet, read: Evidence, box: Box, precision: torch.dtype) -> Mixture:
    """What a network tells of a box of the image."""
    cut = cropped_evidence(read, box)
    exact = ("disparity", "slope", "level")
    disparity, slope, level = (torch.from_numpy(cut[name])[None].to(precision) for name in exact)
    returned, labels = (torch.from_numpy(cut[name])[None] for name in ("returned", "labels"))
    return net(disparity, returned, labels, slope, level)


def rounded(disparity: Tensor) -> np.ndarray:
    """(h, w) [px] float64: disparities (1, h, w), rounded to DISPARITY_STEP."""
    return np.rint(disparity[0].numpy().astype(np.float64) / DISPARITY_STEP) * DISPARITY_STEP
