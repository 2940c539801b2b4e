"""KitNet as a method: the cavities of all plates, the rotation into each, and the cavity that the part fits best."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch

from baselines.heights.maps import cell_centres, envelopes
from baselines.heights.scene_heights import RecordedHeights, SceneHeights
from baselines.kitnet.config import KitNetConfig
from baselines.kitnet.examples import points_of, rotation_of
from baselines.kitnet.network import KitNet
from baselines.kitnet.views import CAVITY, CELL, CavityView, cavity_image, cavity_view, part_image
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.perception.networks.inference import ready
from kit1000.perception.observed.kits import ObservedKits
from kit1000.perception.sensor_facts import simulated_sensor
from kit1000.pose import Pose
from kit1000.predictor import PredictedMotion
from kit1000.values import Query, TrueGeometry

STARTS = 12  # yaws of the part around the circle from which it begins without a guess; the best overlap wins
PASSES = 2  # how often the network rotates the part and looks again: the controller of the method


@dataclass(frozen=True, eq=False)
class Seat:
    """A part, rotated for a cavity and centred over it."""

    rotation: Pose
    """Rotation of the part in the world."""
    target: np.ndarray
    """(3,) [m] of the pivot, world."""
    overlap: float
    """Area of the intersection of part and cavity, seen along the plate's normal, over that of their union."""


class KitNetMethod:
    """Rotates the part into a cavity: with a guess the nearest one, else the one whose outline it then covers best."""

    def __init__(
        self,
        dataset: Dataset,
        network: KitNet | Path,
        position: Literal["centroid", "none"] = "centroid",
    ) -> None:
        """A network as it is, or read from the stem of its weights and put on a GPU where there is one.

        Args:
            dataset: of the queries.
            network: trained with a guess for tracks with one, without for the others.
            position: centroid: the centroid of the part over that of the cavity, its lowest point on the floor; none:
                the part rotates about its pivot and stays, for a method that predicts rotations alone.
        """
        self.network: KitNet = ready(network, KitNetConfig, KitNet)
        self.position = position
        self._heights = RecordedHeights(dataset)

    @torch.inference_mode()
    def __call__(self, query: Query, geometry: TrueGeometry | None = None) -> PredictedMotion:
        """The motion into the chosen cavity; confidence: the overlap of part and cavity."""
        heights = self._heights.of(query)
        cavities = observed_cavities(query, heights)
        if not cavities:
            if query.guess is None:
                raise InputError(f"{query.id}: its images show no cavity; KitNet needs one")
            return PredictedMotion(query.guess, 0.0)
        points = points_of(heights.parts[query.part], query.guess is not None) - query.pivot
        if query.guess is not None:
            guessed = query.guess.apply(query.pivot)
            cavities = [min(cavities, key=lambda cavity: _distance(cavity, guessed))]
        seats = self._seats(query, points, cavities)
        best = max(seats, key=lambda seat: seat.overlap)
        target = best.target if self.position == "centroid" else query.pivot
        motion = Pose(best.rotation.wxyz, target - best.rotation.rotate(query.pivot))
        return PredictedMotion(motion, float(np.clip(best.overlap, 0, 1)))

    def _seats(self, query: Query, points: np.ndarray, cavities: list[CavityView]) -> list[Seat]:
        """The part in each cavity, rotated as the network says."""
        starts = STARTS if query.guess is None else 1
        yaws = [Pose.from_rotvec((0.0, 0.0, 2 * np.pi * k / starts)) for k in range(starts)]
        rotated = [(cavity, yaw @ _first_rotation(query, cavity)) for cavity in cavities for yaw in yaws]
        for _ in range(PASSES):
            rotated = self._rotated_further(points, rotated)
        return [seat(cavity, rotation, points, query.pivot) for cavity, rotation in rotated]

    def _rotated_further(
        self, points: np.ndarray, rotated: list[tuple[CavityView, Pose]]
    ) -> list[tuple[CavityView, Pose]]:
        """The rotations of the part for each cavity, after the network's own."""
        config, still = self.network.config, np.zeros(2)
        size = config.pixels, config.pixel
        parts = np.stack([part_image(rotation.rotate(points), still, *size) for _, rotation in rotated])
        images = np.stack([cavity_image(cavity, 0.0, still, *size) for cavity, _ in rotated])
        device = next(self.network.parameters()).device
        quaternions = self.network(*(torch.as_tensor(maps, device=device) for maps in (parts, images)))
        wxyz = quaternions.double().cpu().numpy()
        return [(cavity, Pose(q, np.zeros(3)) @ rotation) for (cavity, rotation), q in zip(rotated, wxyz, strict=True)]


def _first_rotation(query: Query, cavity: CavityView) -> Pose:
    """The first rotation of the part in its view: by the guess, seen along the plate's normal, or none."""
    if query.guess is None:
        return Pose.identity()
    return rotation_of(cavity.world_from_view).inverse() @ rotation_of(query.guess)


def observed_cavities(query: Query, heights: SceneHeights) -> list[CavityView]:
    """The cavities of the plates that the query's image shows."""
    plates = ObservedKits(query.image, simulated_sensor(query.sensor).kind.noise, query.scene_id).plates
    views = (cavity_view(heights.kits, plate) for plate in plates)
    return [view for view in views if view is not None]


def seat(cavity: CavityView, view_from_part: Pose, points: np.ndarray, pivot: np.ndarray) -> Seat:
    """A part over a cavity, centroid over centroid, its lowest point on the floor.

    Args:
        cavity: the cavity.
        view_from_part: rotation of the part in its view.
        points: (n, 3) [m] of the part as it lies, along the axes of the world, about its pivot.
        pivot: (3,) [m] of the part.
    """
    rotation = rotation_of(cavity.world_from_view) @ view_from_part
    if not len(points):
        return Seat(rotation, pivot, 0.0)
    rotated = view_from_part.rotate(points)
    low, high = rotated.min(0), rotated.max(0)
    middle = (low + high) / 2
    _, _, seen = envelopes(rotated - middle, CAVITY, CELL)
    centres = cell_centres(CAVITY, CELL)
    centroid = centres[seen].mean(0) if seen.any() else np.zeros(2)
    _, _, there = envelopes(rotated - middle + (*(cavity.centroid - centroid), 0.0), CAVITY, CELL)
    hollow = cavity.depths > 0
    overlap = (there & hollow).sum() / max((there | hollow).sum(), 1)
    target = (*(cavity.centroid - centroid - middle[:2]), -cavity.floor - low[2])
    return Seat(rotation, cavity.world_from_view.apply(target), float(overlap))


def _distance(cavity: CavityView, point: np.ndarray) -> float:
    return float(np.linalg.norm(cavity.world_from_view.xyz - point))
