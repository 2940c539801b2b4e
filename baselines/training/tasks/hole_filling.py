"""The training task of hole filling: crops of new views by a scanner, measured on images of the validation split."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.training.tasks.noisy_images import scanned_view
from baselines.training.tasks.restoration import (
    Batch,
    Example,
    MixtureTask,
    Recorded,
    ViewCrops,
    crops_of,
    fresh_image,
    mean_where,
)
from kit1000.dataset.reader import Dataset
from kit1000.perception.restoration import calibrated_image
from kit1000.perception.restoration.disparity import above_table
from kit1000.perception.restoration.restorer import UNIT, RestorationConfig, RestorationNet, hole_inputs, holes
from kit1000.perception.sensor_facts import simulated_sensor
from kit1000.values import LabelledDepth

KITS_SHARE = 0.75  # of the crops: about a hole of the kits, not of a part
SENSOR = "photoneo"
VIEWS = {"pretraining": (2500, 2061), "small": (2000, 2062)}  # number and seed of the views; the second run continues
FAR = 0.5  # [px] of disparity: a filled pixel that far from the truth shows another surface


@dataclass(frozen=True, kw_only=True)
class HoleViews(ViewCrops):
    """Crops of measured disparities with holes, and of true ones."""

    STREAM = "hole-filling"

    def crops(self, rng: np.random.Generator) -> list[Example]:
        """About holes of the kits and of parts."""
        image, depth = fresh_image(self.dataset, rng, scanned_view)
        whole = example_of(image, depth)
        return crops_of(whole, np.where(whole["counts"], image.labels, 0), KITS_SHARE, rng)


def example_of(image: LabelledDepth, depth: np.ndarray) -> Example:
    """The evidence of a calibrated image, `truth` (H, W) [px] of true depths (H, W) [m], `counts`: holes of bodies."""
    return hole_inputs(image) | {"truth": above_table(depth, image.view, UNIT), "counts": holes(image)}


@dataclass
class HoleFillingTask(MixtureTask[HoleViews]):
    """Fill the holes of a crop of one image, calibrated by the table."""

    def whole(self, scene_id: str) -> Recorded:
        """About the slot of the drawn target."""
        scene = self.dataset.split(self.split, truth=True).scene(scene_id)
        target = next(query for query in scene.queries if query.drawn)
        image = calibrated_image(scene.labelled_depth(SENSOR), simulated_sensor(SENSOR))
        whole = example_of(image, scene.labelled_depth("ideal").view.depth)
        return Recorded(image.view, scene.truth_of(target.id).world_from_kit.xyz, whole)

    def measure(self, batch: Batch) -> Batch:
        """(B,) of holes: `loss`; `hole_px`, the mean absolute error; `far_hole`, the share that is off by FAR px."""
        mixture, counts = self.mixture(batch), batch["counts"]
        wrong = (mixture.likeliest() - batch["truth"]).abs()
        return {
            "loss": mean_where(-mixture.log_likelihood(batch["truth"]), counts),
            "hole_px": mean_where(wrong, counts),
            "far_hole": mean_where((wrong > FAR).float(), counts),
        }


def hole_filling_task(dataset: Dataset, preset: str) -> HoleFillingTask:
    """The task with new weights."""
    count, seed = VIEWS[preset]
    views = HoleViews(dataset=dataset, count=count, seed=seed)
    return HoleFillingTask(views, dataset, "val", RestorationNet(RestorationConfig()))
