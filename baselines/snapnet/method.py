"""SnapNet as a method: the position network, then the rotation network at the predicted position."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import torch

from baselines.loading import ready
from baselines.snapnet.candidates import CandidateSet, candidates
from baselines.snapnet.config import PositionConfig, RotationConfig, Source
from baselines.snapnet.position import PositionNet, position_of
from baselines.snapnet.rotation import RotationNet, rotation_of
from baselines.snapnet.volumes import QueryVolumes
from kit1000.dataset.reader import Dataset
from kit1000.motions import apply_error
from kit1000.pose import Pose
from kit1000.predictor import PredictedMotion
from kit1000.rng import stream
from kit1000.values import Query, TrueGeometry

CANDIDATES: dict[str, CandidateSet] = {"snap-tilt": "tilt", "place": "place", "place-paper": "place-paper"}
"""By track; in all others ball, for a guess with an error about any axis."""


class SnapNet:
    """Corrects a guess by two networks, as in the paper: one reads volumes, the other points sampled from volumes."""

    def __init__(
        self,
        dataset: Dataset,
        source: Source,
        position: PositionNet | Path,
        rotation: RotationNet | Path,
        peak: Literal["candidate", "mean"] = "candidate",
        passes: int = 1,
    ) -> None:
        """Networks as they are, or read from the stems of their weights and put on a GPU where there is one.

        Args:
            dataset: of the queries.
            source: of the volumes.
            position: network.
            rotation: network.
            peak: the best candidate rotation, as in the paper, or the mean of those around it, weighted by probability.
            passes: how often the networks run; each further pass starts from the prediction before.
        """
        self.dataset = dataset
        self.source: Source = source
        self.peak: Literal["candidate", "mean"] = peak
        self.passes = passes
        self.position: PositionNet = ready(position, PositionConfig, PositionNet)
        self.rotation: RotationNet = ready(rotation, RotationConfig, RotationNet)

    @property
    def uses_true_geometry(self) -> bool:
        """Whether it needs the true geometry."""
        return self.source == "truth"

    @torch.inference_mode()
    def __call__(self, query: Query, geometry: TrueGeometry | None = None) -> PredictedMotion:
        """The guess after all passes."""
        volumes = QueryVolumes(query, self.source, geometry)
        predicted = PredictedMotion(volumes.initial_guess(), 0.0)
        for _ in range(self.passes):
            predicted = self._corrected(volumes, predicted.goal_from_now)
        return predicted

    def _corrected(self, volumes: QueryVolumes, guess: Pose) -> PredictedMotion:
        """A guess, moved by the predicted offset and rotated by the predicted rotation; one pass."""
        query = volumes.query
        work = Pose.from_translation(guess.apply(query.pivot))
        offset, position_confidence = self._offset(volumes, guess, work)
        work = work @ Pose.from_translation(offset)
        rng = stream(0, "snapnet", query.id)
        rotvec, rotation_confidence = self._rotvec(volumes, guess, work, CANDIDATES.get(query.track, "ball"), rng)
        return PredictedMotion(
            apply_error(guess, query.pivot, offset, rotvec), position_confidence * rotation_confidence
        )

    def _offset(self, volumes: QueryVolumes, guess: Pose, work: Pose) -> tuple[np.ndarray, float]:
        """(3,) [m] along the axes of the world, and the probability of the 8 best cells."""
        config = self.position.config
        inputs = volumes.position_inputs(guess, work, config)
        scores = self.position(*(_batch(inputs[name], self.position) for name in ("part", "kit"))).float()
        probability = scores.flatten(1).softmax(1).topk(8).values.sum()
        return position_of(scores, config)[0].double().cpu().numpy(), float(probability.clamp(max=1))

    def _rotvec(
        self, volumes: QueryVolumes, guess: Pose, work: Pose, name: CandidateSet, rng: np.random.Generator
    ) -> tuple[np.ndarray, float]:
        """(3,) [rad] rotation vector along the axes of the world, and the probability of the best candidate."""
        arrays = volumes.rotation_inputs(guess, work, self.rotation.config, rng)
        inputs = {key: _batch(values, self.rotation) for key, values in arrays.items()}
        rotations = _batch(candidates(name).wxyz, self.rotation)
        logits = self.rotation(inputs["part_points"], inputs["kit_points"], rotations, inputs.get("kit_volume")).float()
        wxyz = rotation_of(logits, rotations, self.peak)[0].double().cpu().numpy()
        return Pose(wxyz, np.zeros(3)).rotvec(), float(logits.softmax(1).amax())


def _batch(values: np.ndarray, net: torch.nn.Module) -> torch.Tensor:
    """A batch of one example, on the device of a network."""
    return torch.tensor(values, dtype=torch.float32, device=next(net.parameters()).device)[None]
