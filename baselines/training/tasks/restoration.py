"""The training task of restoration: crops of new views of the train split, measured on the validation split."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Generic, NamedTuple, TypeVar

import numpy as np
import torch
import torch.nn.functional as F
from scipy.ndimage import maximum_filter
from torch import Tensor

from baselines.training.tasks.noisy_images import noisy_view
from baselines.training.validation import RecordedTask, drawn_targets
from kit1000.dataset.reader import Dataset
from kit1000.perception.restoration.disparity import (
    Box,
    above_table,
    cropped_inputs,
    labelled_inputs,
    unlabelled_inputs,
)
from kit1000.perception.restoration.restorer import Mixture, RestorationConfig, RestorationNet
from kit1000.perception.restoration.rules import JUMP, calibrated_image, closed_gaps
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
VALIDATION_SCENES = 30  # spread evenly over the validation split
VIEWS = {"pretraining": (1500, 2029), "small": (3000, 2035), "measured": (30_000, 2048)}
"""Number and seed of the views by preset, each from the weights of the one before."""
UNMASKED_VIEWS = {"small": (1500, 2029), "measured": (30_000, 2049)}
"""The same without masks."""
REACH = 7  # [px] from a jump of the truth, where a pixel counts as beside an edge
FAR = 1.0  # [px] of disparity: a pixel that far from the truth shows another surface
Batch = dict[str, Tensor]


@dataclass(frozen=True, kw_only=True)
class ViewCrops(ABC):
    """Crops of the first views of a seed; those of a view are made when one is first asked for, and kept (1.5 MB)."""

    STREAM: ClassVar[str]
    """Name of the random numbers."""
    dataset: Dataset
    """Dataset of the scenes that are shown, all of the train split."""
    seed: int
    count: int
    """Number of views."""
    _kept: dict[int, list[Example]] = field(default_factory=dict, repr=False, compare=False)

    def draw(self, rng: np.random.Generator) -> Example:
        """One of the crops of all views."""
        view, crop = divmod(int(rng.integers(self.count * CROPS)), CROPS)
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
        image, depth = fresh_image(self.dataset, rng)
        return crops_of(example_of(image, depth, self.labelled), image.labels, KITS_SHARE[self.labelled], rng)


def crops_of(whole: Example, labels: np.ndarray, kits_share: float, rng: np.random.Generator) -> list[Example]:
    """CROPS crops of a whole image; that share of them is about a pixel of the kits, the others about one of a part."""
    return [cropped_inputs(whole, box_about(*body_pixel(labels, kits_share, rng))) for _ in range(CROPS)]


def fresh_image(
    dataset: Dataset, rng: np.random.Generator, measured: Sensing = noisy_view
) -> tuple[LabelledDepth, np.ndarray]:
    """A scene of the train split as a calibrated sensor sees it from a new place; (H, W) [m] true depths."""
    split = dataset.split("train", truth=True)
    scene = split.scene(split.scene_ids[int(rng.integers(len(split.scene_ids)))])
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
    return drawn_pixel(there if there.any() else labels > 0, rng)


def drawn_pixel(mask: np.ndarray, rng: np.random.Generator) -> tuple[int, int]:
    """Row and column of a random pixel of a mask (H, W) bool, which has one."""
    rows, columns = np.nonzero(mask)
    at = int(rng.integers(len(rows)))
    return int(rows[at]), int(columns[at])


Views = TypeVar("Views", bound=ViewCrops)


class Recorded(NamedTuple):
    """What a recorded scene gives to a task."""

    view: View
    place: np.ndarray
    """(3,) [m] world: shown in the middle of the crop."""
    whole: Example
    """Example of the whole image."""


@dataclass
class CropTask(RecordedTask[str], Generic[Views]):
    """Its examples; a task adds its network, loss and measures."""

    training: Views
    dataset: Dataset
    split: str

    @abstractmethod
    def whole(self, scene_id: str) -> Recorded:
        """A scene as the d415 recorded it."""

    def example(self, rng: np.random.Generator) -> Example:
        """One of the crops of fresh views."""
        return self.training.draw(rng)

    def validation_keys(self) -> Sequence[str]:
        """Ids of VALIDATION_SCENES scenes."""
        targets = drawn_targets(self.dataset, self.split, VALIDATION_SCENES)
        return list(dict.fromkeys(query.scene_id for query, _ in targets))

    def recorded(self, key: str) -> Example:
        """A crop of a scene."""
        view, place, whole = self.whole(key)
        column, row = np.rint(view.camera.project(view.world_from_camera.inverse().apply(place))).astype(int).tolist()
        return cropped_inputs(whole, box_about(row, column))


@dataclass
class MixtureTask(CropTask[Views]):
    """Tell the mixture of each pixel of a crop that counts."""

    model: RestorationNet

    def loss(self, batch: Batch) -> Tensor:
        """() mean over the pixels that count of the negative logarithm of the likelihood of the truth."""
        likely, counts = self.mixture(batch).log_likelihood(batch["truth"]), batch["counts"]
        return -(likely * counts).sum() / counts.sum().clamp(min=1)

    def mixture(self, batch: Batch) -> Mixture:
        """What the network tells of a batch."""
        return self.model(*(batch[name] for name in ("disparity", "returned", "labels", "slope", "level")))


@dataclass
class RestorationTask(MixtureTask[SceneViews]):
    """Restore a crop of one image, calibrated by the table."""

    def whole(self, scene_id: str) -> Recorded:
        """About the slot of the drawn target; without masks, about the part."""
        scene = self.dataset.split(self.split, truth=True).scene(scene_id)
        target = next(query for query in scene.queries if query.drawn)
        image, whole = recorded_example(self.dataset, self.split, scene_id, self.training.labelled)
        slot = scene.truth_of(target.id).world_from_kit.xyz
        return Recorded(image.view, slot if self.training.labelled else target.pivot, whole)

    def measure(self, batch: Batch) -> Batch:
        """(B,) `edge_px`: mean absolute error beside edges; `far_edge`: share of pixels there that are off by FAR px;
        `plain_px`: mean absolute error elsewhere; all where it counts."""
        wrong = (self.mixture(batch).likeliest() - batch["truth"]).abs()
        beside = beside_jumps(batch["truth"])
        edge, plain = batch["counts"] & beside, batch["counts"] & ~beside
        return {
            "edge_px": mean_where(wrong, edge),
            "far_edge": mean_where((wrong > FAR).float(), edge),
            "plain_px": mean_where(wrong, plain),
        }


def beside_jumps(truth: Tensor) -> Tensor:
    """(B, H, W) bool: pixels within REACH px, along rows and columns, of a jump of true disparities (B, H, W) [px]."""
    jumps = torch.zeros_like(truth)
    for axis in (1, 2):
        jump = (truth.diff(dim=axis).abs() > JUMP).to(truth.dtype)
        jumps.narrow(axis, 0, jump.shape[axis]).add_(jump)
    return F.max_pool2d(jumps, 2 * REACH + 1, 1, REACH) > 0


def mean_where(values: Tensor, where: Tensor) -> Tensor:
    """(B,) means over bool (B, H, W); 0 where none is."""
    return (values * where).sum((1, 2)) / where.sum((1, 2)).clamp(min=1)


def restoration_task(dataset: Dataset, preset: str, labelled: bool = True) -> RestorationTask:
    """The task with new weights. labelled: whether its network reads masks."""
    count, seed = (VIEWS if labelled else UNMASKED_VIEWS)[preset]
    views = SceneViews(dataset=dataset, count=count, seed=seed, labelled=labelled)
    return RestorationTask(views, dataset, "val", RestorationNet(RestorationConfig(labelled=labelled)))
