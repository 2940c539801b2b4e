"""Training examples of the network of centres: crops of fresh views of the scenes of the train split."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.training.tasks.restoration.views import (
    CROPS,
    FACTS,
    Example,
    ViewCrops,
    body_pixel,
    box_about,
    fresh_image,
)
from kit1000.perception.restoration.disparity import cropped_inputs
from kit1000.perception.restoration.restorer import Restorer
from kit1000.perception.segmentation.instances import find_bodies
from kit1000.perception.segmentation.part_finder import inputs_between
from kit1000.values import FIRST_PART_LABEL, LabelledDepth, View

KITS_SHARE = 0.05  # of the crops: about a pixel of the kits


@dataclass(frozen=True, kw_only=True)
class PartViews(ViewCrops):
    """Crops of heights, with the middles of parts."""

    STREAM = "segmentation"
    restorer: Restorer
    """Restorer of images without masks."""

    def crops(self, rng: np.random.Generator) -> list[Example]:
        """About pixels of parts, and some of the kits."""
        image, _ = fresh_image(self.dataset, self.scenes, rng)
        whole = _example(image.labels, image.view, self.restorer.without_masks(image.view, FACTS))
        return [cropped_inputs(whole, box_about(*body_pixel(image.labels, KITS_SHARE, rng))) for _ in range(CROPS)]


def recorded_example(image: LabelledDepth, restorer: Restorer) -> Example:
    """Inputs and truth of a recorded image, calibrated without masks."""
    bodies = find_bodies(image.view, FACTS, restorer)
    return _example(image.labels, bodies.measured, bodies.view)


def _example(labels: np.ndarray, measured: View, restored: View) -> Example:
    """The evidence, and the truth by masks (H, W): `part` bool, `across` and `down` float32 [px], 0 beside parts."""
    part = labels >= FIRST_PART_LABEL
    truth: Example = {"part": part}
    sizes = np.maximum(np.bincount(labels.ravel()), 1)
    for name, places in (("across", np.arange(labels.shape[1])), ("down", np.arange(labels.shape[0])[:, None])):
        here = np.broadcast_to(places, labels.shape)
        means = np.bincount(labels.ravel(), here.ravel().astype(float)) / sizes
        truth[name] = np.where(part, means[labels] - here, 0.0).astype(np.float32)
    return inputs_between(measured, restored) | truth
