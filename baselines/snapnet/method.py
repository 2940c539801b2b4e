"""SnapNet as a method: the position network, then the rotation network at the predicted position.

Without a guess both search coarse to fine: the position network names likely starts over all kits, both networks
correct each of them a little, and the start with the highest score of the rotation network is corrected as a guess.
"""

from __future__ import annotations

from operator import attrgetter
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import torch

from baselines.snapnet.candidate_rotations import CandidateSet, candidates, coarse_candidates, near_candidates
from baselines.snapnet.config import PositionConfig, RotationConfig, Source
from baselines.snapnet.position import PositionNet, position_of
from baselines.snapnet.query_volumes import ImageCache, QueryVolumes
from baselines.snapnet.rotation import RotationNet, rotation_of
from baselines.snapnet.search import likely_starts
from kit1000.dataset.reader import Dataset
from kit1000.perception.completion.kits.completed import ReliefCompleter
from kit1000.perception.completion.parts.completed import PartCompleter
from kit1000.perception.networks.loading import ready
from kit1000.pose import Pose
from kit1000.predictor import PredictedMotion
from kit1000.queries.motions import apply_error
from kit1000.rng import stream
from kit1000.values import Query, TrueGeometry

STARTS = 5  # without a guess; in 30 validation queries with true volumes the right one was among the first three


class Correction(NamedTuple):
    """A motion or a rotation that the networks predict."""

    motion: Pose
    """goal_from_now, or the rotation alone."""
    confidence: float
    """Probability of the best cells and of the best candidate."""
    score: float
    """The highest of the rotation network, a logit; it compares starts."""


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
        completion: Path | None = None,
        kit_completion: Path | None = None,
        search: Literal["coarse to fine", "all"] = "coarse to fine",
    ) -> None:
        """Networks as they are, or read from the stems of their weights and put on a GPU where there is one.

        Args:
            dataset: of the queries.
            source: of the volumes.
            position: network.
            rotation: network.
            peak: the best candidate rotation, as in the paper, or the mean of those around it, weighted by probability.
            passes: how often the networks run; each further pass starts from the prediction before.
            search: of the candidates around a guess first some far apart and then those near the best of them, or all,
                as in the paper, which takes three times as long.
            completion: stem of the weights of the network that completes parts of depth images; None fills columns.
            kit_completion: of the network that completes kits; None leaves free what no pixel shows.
        """
        self.dataset = dataset
        self.source: Source = source
        self.peak: Literal["candidate", "mean"] = peak
        self.passes = passes
        self.search: Literal["coarse to fine", "all"] = search
        self.completer: PartCompleter | None = None if completion is None else PartCompleter(completion)
        self.kit_completer = None if kit_completion is None else ReliefCompleter(kit_completion)
        self.position: PositionNet = ready(position, PositionConfig, PositionNet)
        self.rotation: RotationNet = ready(rotation, RotationConfig, RotationNet)

    @property
    def uses_true_geometry(self) -> bool:
        """Whether it needs the true geometry."""
        return self.source == "truth"

    @torch.inference_mode()
    def __call__(self, query: Query, geometry: TrueGeometry | None = None) -> PredictedMotion:
        """The guess, or where there is none the best start, after all passes."""
        cache = ImageCache(attrgetter("image"), self.completer, self.kit_completer)
        volumes = QueryVolumes(query, self.source, geometry, cache)
        motion, share = (query.guess, 1.0) if query.guess is not None else self._best_start(volumes)
        confidence = 0.0
        for _ in range(self.passes):
            motion, confidence, _ = self.corrected(volumes, motion, near=query.guess is None)
        return PredictedMotion(motion, share * confidence)

    def _best_start(self, volumes: QueryVolumes) -> tuple[Pose, float]:
        """The likely start with the highest score after its correction, and its share of them all."""
        starts = likely_starts(self.position, volumes, STARTS)
        found = [self.corrected(volumes, start, near=True) for start in starts]
        scores = np.array([each.score for each in found])
        best = int(scores.argmax())
        return found[best].motion, float(1 / np.exp(scores - scores[best]).sum())

    def corrected(self, volumes: QueryVolumes, guess: Pose, near: bool) -> Correction:
        """A guess, moved by the predicted offset and rotated by the best candidate; one pass.

        near: whether only the candidates near no rotation are scored.
        """
        query = volumes.query
        work = Pose.from_translation(guess.apply(query.pivot))
        offset, position_confidence = self._offset(volumes, guess, work)
        work = work @ Pose.from_translation(offset)
        arrays = volumes.rotation_inputs(guess, work, self.rotation.config, stream(0, "snapnet", query.id))
        inputs = {key: _batch(values, self.rotation) for key, values in arrays.items()}
        name: CandidateSet = "tilt" if query.track == "snap-tilt" else "ball"
        if self.search == "all" and not near:
            found = self._rotation(inputs, candidates(name))
        else:
            middle = Pose.identity() if near else self._rotation(inputs, coarse_candidates(name)).motion
            found = self._rotation(inputs, near_candidates(name, middle))
        motion = apply_error(guess, query.pivot, offset, found.motion.rotvec())
        return Correction(motion, position_confidence * found.confidence, found.score)

    def _offset(self, volumes: QueryVolumes, guess: Pose, work: Pose) -> tuple[np.ndarray, float]:
        """(3,) [m] along the axes of the world, and the probability of the 8 best cells."""
        config = self.position.config
        inputs = volumes.position_inputs(guess, work, config)
        scores = self.position(*(_batch(inputs[name], self.position) for name in ("part", "kit"))).float()
        probability = scores.flatten(1).softmax(1).topk(8).values.sum()
        return position_of(scores, config)[0].double().cpu().numpy(), float(probability.clamp(max=1))

    def _rotation(self, inputs: dict[str, torch.Tensor], among: Pose) -> Correction:
        """The best of some rotations (n,), on the left of the guess's, along the axes of the world."""
        rotations = _batch(among.wxyz, self.rotation)
        logits = self.rotation(inputs["part_points"], inputs["kit_points"], rotations, inputs.get("kit_volume")).float()
        wxyz = rotation_of(logits, rotations, self.peak)[0].double().cpu().numpy()
        return Correction(Pose(wxyz, np.zeros(3)), float(logits.softmax(1).amax()), float(logits.amax()))


def _batch(values: np.ndarray, net: torch.nn.Module) -> torch.Tensor:
    """A batch of one example, on the device of a network."""
    return torch.tensor(values, dtype=torch.float32, device=next(net.parameters()).device)[None]
