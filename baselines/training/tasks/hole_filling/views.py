"""Training examples of hole filling: crops of fresh views of the scenes of the train split, by a scanner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.training.tasks.noisy_images import scanned_view
from baselines.training.tasks.restoration.views import CROPS, Example, ViewCrops, body_pixel, box_about, fresh_image
from kit1000.perception.restoration.disparity import above_table, cropped_inputs
from kit1000.perception.restoration.restorer import UNIT, hole_inputs, holes
from kit1000.values import LabelledDepth

KITS_SHARE = 0.75  # of the crops: about a hole of the kits, not of a part


@dataclass(frozen=True, kw_only=True)
class HoleViews(ViewCrops):
    """Crops of measured disparities with holes, and of true ones."""

    STREAM = "hole-filling"

    def crops(self, rng: np.random.Generator) -> list[Example]:
        """About holes of the kits and of parts."""
        image, depth = fresh_image(self.dataset, self.scenes, rng, scanned_view)
        whole = example_of(image, depth)
        places = [body_pixel(np.where(whole["counts"], image.labels, 0), KITS_SHARE, rng) for _ in range(CROPS)]
        return [cropped_inputs(whole, box_about(*place)) for place in places]


def example_of(image: LabelledDepth, depth: np.ndarray) -> Example:
    """The evidence of a calibrated image, `truth` (H, W) [px] of true depths (H, W) [m], `counts`: holes of bodies."""
    return hole_inputs(image) | {"truth": above_table(depth, image.view, UNIT), "counts": holes(image)}
