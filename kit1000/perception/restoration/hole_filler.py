"""Holes in a scanner's image, filled by a network: shadows of its projector, and what jumps and steep walls lose.

Pixels with a return stay as they were measured. A hole is filled where the network is sure of its depth; elsewhere it
stays. Disparities are those that the d415 would measure, so that scanners of any baseline look alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from kit1000.perception.networks.loading import ready
from kit1000.perception.networks.unet import folded, in_float64
from kit1000.perception.restoration.disparity import Box, Evidence, depths, evidence
from kit1000.perception.restoration.network import RestorationConfig, RestorationNet
from kit1000.perception.restoration.restorer import bodies_in, mixture_in, rounded
from kit1000.perception.restoration.rules import closed_gaps
from kit1000.perception.sensor_facts import SensorFacts, simulated_sensor
from kit1000.values import LabelledDepth

UNIT = simulated_sensor("d415")  # sensor in whose disparities the network reads and predicts depths
LEAST_SURE = 0.5  # probability of a depth within NEAR, from which on it is filled in
NEAR = 0.12  # [px] of disparity: 1.5 mm from 0.8 m
SURE_DECIMALS = 6  # of that probability: the last digits of exponentials depend on the processor


def holes(image: LabelledDepth) -> np.ndarray:
    """(H, W) bool: the pixels of bodies without a return."""
    return (image.labels > 0) & (image.view.depth == 0)


def hole_evidence(image: LabelledDepth, simulated: bool = True) -> Evidence:
    """What the network reads of a calibrated image, see `evidence`; holes hold a first estimate from beside.

    simulated: whether the table is that of generated scenes.
    """
    return evidence(image, closed_gaps(image, simulated).view, UNIT)


class HoleFiller:
    """The network with its weights."""

    def __init__(self, weights: Path | RestorationNet) -> None:
        """weights: stem of the files, or the network itself; it calculates in float64, see `Restorer`."""
        self.net = in_float64(folded(ready(weights, RestorationConfig, RestorationNet)).to("cpu"))

    def __call__(self, image: LabelledDepth, sensor: SensorFacts, labels: Sequence[int]) -> LabelledDepth:
        """A calibrated image with the holes of the bodies of some labels filled where the network is sure."""
        read, empty = hole_evidence(image, sensor.simulated_table), holes(image)
        depth = image.view.depth.copy()
        for wide, mask in bodies_in(image, labels):
            disparity, sure = self._likeliest(read, wide)
            filled = empty[wide] & mask & (sure >= LEAST_SURE)
            depth[wide] = np.where(filled, depths(disparity, image.view, wide, UNIT), depth[wide])
        return replace(image, view=replace(image.view, depth=depth))

    def _likeliest(self, read: Evidence, box: Box) -> tuple[np.ndarray, np.ndarray]:
        """(h, w) [px] the likeliest disparities in a box, rounded, and the probability that they are right to NEAR."""
        with torch.inference_mode():
            mixture = mixture_in(self.net, read, box, torch.float64)
            likeliest = mixture.likeliest()
            sure = mixture.probability_near(likeliest, NEAR)
        return rounded(likeliest), np.round(sure[0].numpy(), SURE_DECIMALS)
