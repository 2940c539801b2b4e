"""Parts by the network: the pixels of one part vote for one place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from kit1000.perception.networks.loading import ready
from kit1000.perception.networks.unet import folded
from kit1000.perception.restoration.disparity import Box, Evidence, cropped_evidence, padded_box, shifted_boxes
from kit1000.perception.segmentation.bodies import Bodies, on_far_half
from kit1000.perception.segmentation.evidence import evidence_of
from kit1000.perception.segmentation.network import SIDE, CentresConfig, CentresNet
from kit1000.perception.segmentation.votes import gathered

BORDER = 16  # [px] about the parts
OFFSET_STEP = 1 / 8  # [px] to which votes are rounded: sums of float32 depend on the processor
LOGIT_STEP = 1 / 64  # the same of the logits
ON_BODIES = 0.5  # least share of a part's pixels that lie on bodies: elsewhere noise looks like one


class PartFinder:
    """The network with its weights."""

    def __init__(self, weights: Path | CentresNet) -> None:
        """weights: stem of the files, or the network itself."""
        net = folded(ready(weights, CentresConfig, CentresNet)).to("cpu")  # on which the last digits are known
        self.net = net.to(memory_format=torch.channels_last)

    def __call__(self, bodies: Bodies) -> np.ndarray:
        """(H, W) int: from 1 on the pixels of each part of an image, 0 elsewhere."""
        labels = np.zeros(bodies.parts.shape, int)
        rows, columns = (np.flatnonzero(bodies.parts.any(axis)) for axis in (1, 0))
        if len(rows) == 0:
            return labels
        tall, broad = (slice(max(line[0] - BORDER, 0), line[-1] + BORDER + 1) for line in (rows, columns))
        box = padded_box(tall, broad, SIDE, bodies.view.camera)
        offset, part = self.votes(bodies, box)
        found = gathered(np.indices(part.shape) + offset[::-1], part & ~on_far_half(bodies.points[box]))
        pixels, shared = (
            np.bincount(found[mask], minlength=found.max() + 1) for mask in (found > 0, bodies.parts[box])
        )
        labels[box] = np.where((shared >= ON_BODIES * pixels)[found], found, 0)
        return labels

    def votes(self, bodies: Bodies, box: Box) -> tuple[np.ndarray, np.ndarray]:
        """(2, h, w) [px] across and down; (h, w) bool: pixels that show a part.

        Each is the median by images that begin at several pixels, as of `perception.restoration.restorer.Restorer`.
        """
        evidence, boxes = evidence_of(bodies), shifted_boxes(box, SIDE, bodies.view.camera)
        votes = np.median([self._votes(evidence, wide)[(slice(None), *inside)] for wide, inside in boxes], axis=0)
        return votes[:2], votes[2] > 0

    def _votes(self, evidence: Evidence, box: Box) -> np.ndarray:
        """(3, h, w) offsets [px] across and down, and logits of showing a part; rounded."""
        cut = cropped_evidence(evidence, box)
        batch = [torch.from_numpy(cut[name])[None] for name in ("measured", "restored", "returned", "up")]
        with torch.inference_mode():
            votes = self.net(*batch)
        offset = np.rint(votes.offset[0].numpy().astype(float) / OFFSET_STEP) * OFFSET_STEP
        return np.concatenate([offset, np.rint(votes.part.numpy() / LOGIT_STEP)])
