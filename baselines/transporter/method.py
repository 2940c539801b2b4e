"""TransporterNet as a method: height maps of three cameras, the best cell, height and tilt there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from baselines.heights.scene_heights import RecordedHeights
from baselines.heights.shell import shell_points
from baselines.transporter.config import TransporterConfig
from baselines.transporter.examples import searched_yaws
from baselines.transporter.inputs import search_inputs, start_of
from baselines.transporter.lattice import rotation_from
from baselines.transporter.network import TransporterNet
from baselines.transporter.search import search
from kit1000.dataset.reader import Dataset
from kit1000.perception.networks.inference import ready
from kit1000.pose import Pose
from kit1000.predictor import PredictedMotion
from kit1000.queries.guesses import MAX_ANGLE, MAX_OFFSET
from kit1000.values import Query, TrueGeometry


class Transporter:
    """Scores positions and yaws of the part by cross-correlation, with a guess only those in its window."""

    def __init__(self, dataset: Dataset, network: TransporterNet | Path) -> None:
        """The networks as they are, or read from the stem of their weights and put on a GPU where there is one."""
        self.network: TransporterNet = ready(network, TransporterConfig, TransporterNet)
        self._heights = RecordedHeights(dataset)

    @torch.inference_mode()
    def __call__(self, query: Query, geometry: TrueGeometry | None = None) -> PredictedMotion:
        """The motion to the best cell; confidence: the probability of that cell and those around it."""
        heights, config = self._heights.of(query), self.network.config
        start = start_of(heights, query.pivot, query.guess)
        shell = shell_points(heights.parts[query.part]) - query.pivot
        inputs = search_inputs(heights.kits, shell, start, config)
        device = next(self.network.parameters()).device
        kits, part = (torch.as_tensor(inputs[name], device=device) for name in ("kits", "part"))
        found = search(self.network, kits, part, searched_yaws(query), inputs["window"], inputs["base"])
        rotation = rotation_from(found.tilt, found.yaw) @ start.work_from_part
        target = start.work_from_world.inverse().apply(found.xyz)
        if query.guess is not None:
            rotation, target = within_window(rotation, target, query.guess, query.pivot)
        return PredictedMotion(motion_to(rotation, query.pivot, target), found.confidence)


def motion_to(rotation: Pose, pivot: np.ndarray, target: np.ndarray) -> Pose:
    """The motion with a rotation that takes a pivot (3,) [m] to a target (3,) [m]."""
    return Pose(rotation.wxyz, target - rotation.rotate(pivot))


def within_window(rotation: Pose, target: np.ndarray, guess: Pose, pivot: np.ndarray) -> tuple[Pose, np.ndarray]:
    """A rotation and a target (3,) [m] of the pivot, moved into the window of a guess: its largest errors.

    A rotation farther off is rotated back towards the guess, about the same axis.
    """
    guessed = guess.apply(pivot)
    start = Pose(guess.wxyz, np.zeros(3))
    rotvec = (rotation @ start.inverse()).rotvec()
    rotvec = rotvec * min(1.0, MAX_ANGLE / max(float(np.linalg.norm(rotvec)), 1e-12))
    return Pose.from_rotvec(rotvec) @ start, np.clip(target, guessed - MAX_OFFSET, guessed + MAX_OFFSET)
