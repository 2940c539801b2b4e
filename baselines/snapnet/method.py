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

from baselines.snapnet.candidate_rotations import CandidateSet, coarse_candidates, near_candidates
from baselines.snapnet.config import Cells, PositionConfig, RotationConfig, Source
from baselines.snapnet.convolutions import correlate
from baselines.snapnet.position import COARSEST, PositionNet, position_of
from baselines.snapnet.query_volumes import ImageCache, QueryVolumes
from baselines.snapnet.rotation import RotationNet, rotation_of
from kit1000.dataset.reader import Dataset
from kit1000.perception.completion.kits import KitCompleter
from kit1000.perception.completion.parts import PartCompleter
from kit1000.perception.networks.inference import ready
from kit1000.pose import Pose
from kit1000.predictor import PredictedMotion
from kit1000.queries.motions import apply_error
from kit1000.rng import stream
from kit1000.values import Query, TrueGeometry

STARTS = 5  # without a guess; in 30 validation queries with true volumes the right one was among the first three
YAWS = 12
RISE = 0.038  # [m] of the middle of the window above that of the observed kits; the mean of seated pivots in val
REACH = (0.11, 0.11, 0.042)  # [m] of the window to every side: the largest in val is 0.096 level and 0.029 in height
MEAN_SHARE = {"truth": 0.0, "depth": 0.5}
"""Share of a cell's mean over the yaws that is taken off, by source. In 54 queries of `val`, from one image, the right
start is then among the best five in 52, without it in 47; with true volumes the mean position error grows from 1.3 to
3.5 mm."""
APART = 8  # cells along level axes, and one yaw, within which a better start leaves no other


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
    ) -> None:
        """Networks as they are, or read from the stems of their weights and put on a GPU where there is one.

        Args:
            dataset: of the queries.
            source: of the volumes.
            position: network.
            rotation: network.
            peak: the best candidate rotation, as in the paper, or the mean of those around it, weighted by probability.
            passes: how often the networks run; each further pass starts from the prediction before.
            completion: stem of the weights of the network that completes parts of depth images; None fills columns.
            kit_completion: of the network that completes kits; None leaves free what no pixel shows.
        """
        self.dataset = dataset
        self.source: Source = source
        self.peak: Literal["candidate", "mean"] = peak
        self.passes = passes
        self.completer: PartCompleter | None = None if completion is None else PartCompleter(completion)
        self.kit_completer = None if kit_completion is None else KitCompleter(kit_completion)
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


def likely_starts(net: PositionNet, volumes: QueryVolumes, count: int) -> list[Pose]:
    """The motions of an upright part, goal_from_now, that the position network scores best, the best first.

    Args:
        net: trained with a guess.
        volumes: of a query without a guess; InputError where no kit is observed.
        count: motions.
    """
    config, pivot = net.config, volumes.query.pivot
    middle = volumes.initial_guess().apply(pivot) + (0, 0, RISE)
    work, device = Pose.from_translation(middle), next(net.parameters()).device
    cells, window = wide_window(config)
    yaws = [Pose.from_rotvec((0, 0, 2 * np.pi * k / YAWS)) for k in range(YAWS)]
    there = [Pose(yaw.wxyz, middle - yaw.apply(pivot)) for yaw in yaws]
    parts = np.stack([volumes.part_volume(guess, work, config.part_cells, config.voxel) for guess in there])
    kit = volumes.kit_volume(work, cells, config.voxel)[None]
    features = net.part(torch.as_tensor(parts, device=device)), net.kit(torch.as_tensor(kit, device=device))
    scores = correlate(*features, window).float().cpu().numpy()
    best = best_cells(scores - MEAN_SHARE[volumes.source] * scores.mean(0), count)
    offsets = (best[:, 1:] - np.array(window) // 2) * (2 * config.voxel)
    return [Pose(there[k].wxyz, there[k].xyz + offset) for k, offset in zip(best[:, 0], offsets, strict=True)]


def wide_window(config: PositionConfig) -> tuple[Cells, Cells]:
    """Voxels of the kits' volume and cells of the scores, for a window of REACH to every side."""
    step = 2 * COARSEST  # the middles of both volumes are then a whole number of cells from their first voxels
    reach = (round(2 * side / config.voxel / step) * step for side in REACH)
    x, y, z = (part + more for part, more in zip(config.part_cells, reach, strict=True))
    a, b, c = ((kit - part) // 2 + 1 for kit, part in zip((x, y, z), config.part_cells, strict=True))
    return (x, y, z), (a, b, c)


def best_cells(scores: np.ndarray, count: int) -> np.ndarray:
    """The best cells (count, 4), yaw and position, of scores (YAWS, wx, wy, wz), no two in one place; best first."""
    left, found = scores.copy(), []
    for _ in range(count):
        k, a, b, c = (int(i) for i in np.unravel_index(int(left.argmax()), left.shape))
        found.append((k, a, b, c))
        for yaw in (k - 1, k, k + 1):
            left[yaw % YAWS, max(a - APART, 0) : a + APART + 1, max(b - APART, 0) : b + APART + 1] = -np.inf
    return np.array(found)
