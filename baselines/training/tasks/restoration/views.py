"""Training examples of restoration: crops of fresh views of the scenes of the train split."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from scipy.ndimage import maximum_filter

from baselines.training.tasks.noisy_images import noisy_view
from kit1000.dataset.reader import Dataset
from kit1000.perception.restoration.disparity import (
    Box,
    above_table,
    cropped_inputs,
    labelled_inputs,
    unlabelled_inputs,
)
from kit1000.perception.restoration.rules import calibrated_image, closed_gaps
from kit1000.perception.sensor_facts import simulated_sensor
from kit1000.rng import stream
from kit1000.sim.cameras import CAMERA, draw_primary_pose
from kit1000.sim.render import render
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, LabelledDepth, View

SENSOR = "d415"
FACTS = simulated_sensor(SENSOR)
SIDE = 128  # [px] of a crop
CROPS = 8  # of a view
KITS_SHARE = {True: 0.75, False: 0.3}  # of the crops, with masks and without: about a pixel of the kits, not of a part
CROWDED_SHARE = 0.2  # of the views: from cameras as of crowded scenes
AROUND = 12  # [px] about bodies, where without masks the table counts too

Example = dict[str, np.ndarray]
Sensing = Callable[[View, np.random.Generator], View]
"""What a sensor sees of an ideal view."""


@dataclass(frozen=True, kw_only=True)
class ViewCrops(ABC):
    """Crops of the first views of a seed; those of a view are made when one is first asked for, and kept (1.5 MB)."""

    STREAM: ClassVar[str]
    """Name of the random numbers."""
    dataset: Dataset
    scenes: Sequence[str]
    """Ids of those that are shown, all of the train split."""
    seed: int
    count: int
    """Number of views."""
    _kept: dict[int, list[Example]] = field(default_factory=dict, repr=False, compare=False)

    def __len__(self) -> int:
        return self.count * CROPS

    def __getitem__(self, index: int) -> Example:
        if not 0 <= index < len(self):
            raise IndexError(index)
        view, crop = divmod(index, CROPS)
        if view not in self._kept:
            self._kept[view] = self.crops(stream(self.seed, self.STREAM, view))
        return self._kept[view][crop]

    @abstractmethod
    def crops(self, rng: np.random.Generator) -> list[Example]:
        """CROPS crops of a scene as the calibrated d415 sees it from a new place."""


@dataclass(frozen=True, kw_only=True)
class SceneViews(ViewCrops):
    """Crops of measured and true disparities."""

    STREAM = "restoration"
    labelled: bool = True
    """Whether their masks are known."""

    def crops(self, rng: np.random.Generator) -> list[Example]:
        """About pixels of the kits and of parts."""
        image, depth = fresh_image(self.dataset, self.scenes, rng)
        whole = example_of(image, depth, self.labelled)
        places = [body_pixel(image.labels, KITS_SHARE[self.labelled], rng) for _ in range(CROPS)]
        return [cropped_inputs(whole, box_about(*place)) for place in places]


def fresh_image(
    dataset: Dataset, scenes: Sequence[str], rng: np.random.Generator, measured: Sensing = noisy_view
) -> tuple[LabelledDepth, np.ndarray]:
    """One of some scenes of the train split as a calibrated sensor sees it from a new place; (H, W) [m] true depths."""
    scene = dataset.split("train", truth=True).scene(scenes[int(rng.integers(len(scenes)))])
    pose = draw_primary_pose(rng, crowded=bool(rng.random() < CROWDED_SHARE))
    frame = render(CAMERA, pose, scene.bodies(), threads=1)
    labels = np.where(frame.body_ids > 1, frame.body_ids - 2 + ASSEMBLY_LABEL, 0).astype(np.uint8)
    return LabelledDepth(measured(View(CAMERA, pose, frame.depth), rng), labels), frame.depth


def recorded_example(
    dataset: Dataset, split: str, scene_id: str, labelled: bool = True
) -> tuple[LabelledDepth, Example]:
    """The calibrated image of a recorded scene, and all of its evidence and truth."""
    scene = dataset.split(split, truth=True).scene(scene_id)
    image = calibrated_image(scene.labelled_depth(SENSOR), FACTS)
    return image, example_of(image, scene.labelled_depth("ideal").view.depth, labelled)


def example_of(image: LabelledDepth, depth: np.ndarray, labelled: bool = True) -> Example:
    """The evidence of a calibrated image, and its truth.

    Args:
        image: calibrated, with the true masks.
        depth: (H, W) [m] the true depths.
        labelled: whether the masks are part of the evidence.

    Returns:
        The evidence, `truth` (H, W) [px], and `counts` (H, W) bool: the pixels of bodies; without masks also AROUND.
    """
    counts = image.labels > 0
    if not labelled:
        counts = maximum_filter(counts, 2 * AROUND + 1)
    view = image.view
    read = labelled_inputs(image, closed_gaps(image).view, FACTS) if labelled else unlabelled_inputs(view, FACTS)
    return read | {"truth": above_table(depth, view, FACTS), "counts": counts}


def box_about(row: int, column: int) -> Box:
    """A box of SIDE px about a pixel, within the image."""
    top, left = (
        int(np.clip(at - SIDE // 2, 0, size - SIDE)) for at, size in ((row, CAMERA.height), (column, CAMERA.width))
    )
    return slice(top, top + SIDE), slice(left, left + SIDE)


def body_pixel(labels: np.ndarray, kits_share: float, rng: np.random.Generator) -> tuple[int, int]:
    """Row and column of a random pixel of the kits, or of a part."""
    kits = rng.random() < kits_share
    there = labels == ASSEMBLY_LABEL if kits else labels >= FIRST_PART_LABEL
    rows, columns = np.nonzero(there if there.any() else labels > 0)
    at = int(rng.integers(len(rows)))
    return int(rows[at]), int(columns[at])
