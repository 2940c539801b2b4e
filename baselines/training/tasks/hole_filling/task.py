"""The training task of hole filling: fresh views to learn from, images of the validation split to measure."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from baselines.training.tasks.hole_filling.views import HoleViews, example_of
from baselines.training.tasks.restoration.crop_task import Recorded
from baselines.training.tasks.restoration.task import Batch, MixtureTask, mean_where
from kit1000.dataset.reader import Dataset
from kit1000.perception.restoration import calibrated_image
from kit1000.perception.restoration.restorer import HOLES, RestorationConfig, RestorationNet
from kit1000.perception.sensor_facts import simulated_sensor

SENSOR = "photoneo"
FAR = 0.5  # [px] of disparity: a filled pixel that far from the truth shows another surface


@dataclass
class HoleFillingTask(MixtureTask[HoleViews]):
    """Fill the holes of a crop of one image, calibrated by the table."""

    def recorded(self, scene_id: str) -> Recorded:
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


def hole_filling_task(dataset: Dataset, preset: str) -> tuple[HoleFillingTask, RestorationConfig]:
    """The task with new weights, and the config of its network."""
    config = HOLES[preset]
    model = RestorationNet(config).to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
    scenes = dataset.split("train").scene_ids
    views = HoleViews(dataset=dataset, scenes=scenes, seed=config.views_seed, count=config.views)
    return HoleFillingTask(views, dataset, "val", model), config
