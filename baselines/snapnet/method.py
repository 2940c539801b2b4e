"""SnapNet as a method: where the part goes, then how it must turn there."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch

from baselines.snapnet.candidates import Kind as Turns
from baselines.snapnet.candidates import candidates
from baselines.snapnet.config import Kind, PositionConfig, RotationConfig
from baselines.snapnet.position import PositionNet, position_of
from baselines.snapnet.rotation import RotationNet, turn_of
from baselines.snapnet.volumes import Looks
from baselines.training.checkpoint import fill, load_weights
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.motions import apply_error
from kit1000.pose import Pose
from kit1000.predictor import PredictedMotion
from kit1000.rng import stream
from kit1000.values import Query, Truth

TURNS: dict[str, Turns] = {"snap-tilt": "tilt", "place": "place", "place-paper": "place-paper"}
"""Candidates by track; everywhere else those around a guess of any kind."""


class SnapNet:
    """Corrects a guess by two networks, as in the paper: one sees volumes, the other points taken from volumes."""

    def __init__(
        self,
        dataset: Dataset,
        kind: Kind,
        position: PositionNet | Path,
        rotation: RotationNet | Path,
        peak: Literal["candidate", "mean"] = "candidate",
        passes: int = 1,
    ) -> None:
        """Networks as they are, or read from the stems of their weights and put on a GPU where there is one.

        Args:
            dataset: that is asked about.
            kind: of the volumes.
            position: where the part goes.
            rotation: how it must turn there.
            peak: the best turn, as in the paper, or the mean of those around it by their probability.
            passes: how often it looks; from the second time on its own answer is the guess.
        """
        self.dataset = dataset
        self.kind: Kind = kind
        self.peak: Literal["candidate", "mean"] = peak
        self.passes = passes
        self.position: PositionNet = _ready(position, PositionConfig, PositionNet)
        self.rotation: RotationNet = _ready(rotation, RotationConfig, RotationNet)

    @property
    def uses_true_geometry(self) -> bool:
        """Whether it needs the truth."""
        return self.kind == "truth"

    @torch.inference_mode()
    def __call__(self, query: Query, truth: Truth | None = None) -> PredictedMotion:
        """The guess once it is corrected as often as asked; the answer of a query is its own."""
        looks = Looks(query, truth, self.kind, self.dataset)
        answer = PredictedMotion(looks.start(), 0.0)
        for _ in range(self.passes):
            answer = self._corrected(looks, answer.goal_from_now)
        return answer

    def _corrected(self, looks: Looks, guess: Pose) -> PredictedMotion:
        """A guess, moved by the best offset and turned by the best candidate."""
        query = looks.query
        work = Pose.from_translation(guess.apply(query.pivot))
        offset, sure = self._offset(looks, guess, work)
        place = work @ Pose.from_translation(offset)
        rng = stream(0, "snapnet", query.id)
        turn, surer = self._turn(looks, guess, place, TURNS.get(query.track, "ball"), rng)
        return PredictedMotion(apply_error(guess, query.pivot, offset, turn), sure * surer)

    def _offset(self, looks: Looks, guess: Pose, work: Pose) -> tuple[np.ndarray, float]:
        """(3,) [m] along the axes of the world, and the probability of the cells around."""
        config = self.position.config
        shown = looks.for_position(guess, work, config)
        scores = self.position(*(_batch(shown[name], self.position) for name in ("part", "kit"))).float()
        likely = scores.flatten(1).softmax(1).topk(8).values.sum()
        return position_of(scores, config)[0].double().cpu().numpy(), float(likely.clamp(max=1))

    def _turn(
        self, looks: Looks, guess: Pose, place: Pose, kind: Turns, rng: np.random.Generator
    ) -> tuple[np.ndarray, float]:
        """(3,) [rad] rotation vector along the axes of the world, and the probability of the candidate."""
        config, turns = self.rotation.config, candidates(kind)
        arrays = looks.for_rotation(guess, place, config, rng) | {"turns": turns.wxyz}
        shown = {name: _batch(values, self.rotation) for name, values in arrays.items()}
        offered = shown["turns"]
        logits = self.rotation(shown["part_points"], shown["kit_points"], offered, shown.get("kit_volume")).float()
        turn = turn_of(logits, offered, self.peak)[0].double().cpu().numpy()
        return Pose(turn, np.zeros(3)).rotvec(), float(logits.softmax(1).amax())


def _ready(net: Any, sizes: type, make: type) -> Any:
    """A network that answers."""
    if not isinstance(net, Path):
        return net.eval()
    return _loaded(net, sizes, make).to("cuda" if torch.cuda.is_available() else "cpu").eval()


def _loaded(stem: Path, sizes: type, make: type) -> Any:
    """A network in the sizes that its weights say, with them in it."""
    tensors, info = load_weights(stem)
    told = info.get("about", {}).get("network", {})
    unknown = set(told) ^ {field.name for field in fields(sizes)}
    if unknown:
        raise InputError(f"{stem}.json: the sizes of a {make.__name__} differ in {', '.join(sorted(unknown))}")
    net = make(sizes(**{name: tuple(value) if isinstance(value, list) else value for name, value in told.items()}))
    fill(net, tensors, stem)
    return net


def _batch(values: np.ndarray, net: torch.nn.Module) -> torch.Tensor:
    """One example on the device of a network."""
    return torch.tensor(values, dtype=torch.float32, device=next(net.parameters()).device)[None]
