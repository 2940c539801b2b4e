"""The training task of placement: fits of the train split, moved, seen from a little aside, and mirrored.

B batch, n cells of a side with a border, m of a patch. Moves are yaw times LEVER, then shifts along x and y [mm].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from joblib import Memory
from torch import Tensor

from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.metrics import Targets, pose_errors
from kit1000.metrics.pose_errors import nearest_goal_motions
from kit1000.perception.networks.unet import UNetConfig
from kit1000.perception.placement import CELL, CELLS, Channel
from kit1000.perception.placement.network import LEVER, MIRRORED, PlacementNet
from kit1000.pose import Pose
from kit1000.queries.guesses import draw_ball_error
from kit1000.queries.motions import apply_error
from kit1000.registration.image_refine import PlatePatch, plate_patch
from kit1000.registration.method import FitSearch, PartRegistration
from kit1000.registration.predictor import Registration
from kit1000.rng import stream
from kit1000.values import Query, Truth
from kit1000.weights import WEIGHTS

SHIFT = 0.7  # [mm] standard deviation along each axis, by which a fit is moved
YAW = 0.03  # [rad] the same of its rotation
ASIDE = 0.12  # [rad] of the direction from which the plate is seen
TRACK = "snap-d415"
NEARER = 0.4  # share of the error of a user's guess from which fits for training start: few then end in another slot
BORDER = 8  # cells about a patch, which changes move into it
LARGEST_SHIFT, LARGEST_ROTATION = 7e-3, 0.25  # [m] across, [rad] of a twist: a fit farther off is in another slot
TRIES = 1000  # queries drawn in a row without a fit before the split counts as empty
IN_PLATE = slice(2, 5)
"""Yaw and shift of a twist; height and tilt are left as they are."""
MM = np.array([LEVER, 1e3, 1e3], np.float32)
"""Factors of yaw [rad] and shift [m] in the units of the network."""
SOFT = 0.2  # [mm] below which an error counts by its square
Batch = dict[str, Tensor]
Example = dict[str, np.ndarray]


class Changes(NamedTuple):
    """What changes examples."""

    shift: Tensor
    """(B, 2) [mm] of the fit."""
    yaw: Tensor
    """(B,) [rad] of the fit."""
    aside: Tensor
    """(B,) [rad] of the direction of view."""
    mirrored: Tensor
    """(B,) bool"""


def drawn_changes(rng: np.random.Generator) -> dict[str, np.ndarray]:
    """The changes of an example, by the names of `Changes`."""
    return {
        "shift": (SHIFT * rng.standard_normal(2)).astype(np.float32),
        "yaw": np.array(YAW * rng.standard_normal(), np.float32),
        "aside": np.array(ASIDE * rng.standard_normal(), np.float32),
        "mirrored": np.array(rng.random() < 0.5),
    }


def no_changes() -> dict[str, np.ndarray]:
    """The changes of a validation example."""
    return {name: np.zeros_like(value) for name, value in drawn_changes(np.random.default_rng(0)).items()}


def changed(patch: Tensor, move: Tensor, changes: Changes) -> tuple[Tensor, Tensor]:
    """Patches (B, Channel, m, m) and moves (B, 3) in their frames, of patches (B, Channel, n, n) and their moves."""
    signs = torch.where(changes.mirrored[:, None], move.new_tensor(MIRRORED), 1.0)
    patch = torch.where(changes.mirrored[:, None, None, None], patch.flip(3), patch)
    seen, fitted = patch[:, : Channel.CAVITY], patch[:, Channel.CAVITY :]
    back = -_rotated(changes.shift, -changes.yaw)
    there = [
        _sampled(seen, changes.aside, torch.zeros_like(back)),
        _sampled(fitted, changes.aside - changes.yaw, back),
    ]
    left = signs * move - torch.cat([LEVER * changes.yaw[:, None], changes.shift], 1)
    return torch.cat(there, 1), torch.cat([left[:, :1], _rotated(left[:, 1:], -changes.aside)], 1)


def _rotated(vectors: Tensor, angle: Tensor) -> Tensor:
    """Vectors (B, 2), rotated by angles (B,) [rad]."""
    cosine, sine = torch.cos(angle), torch.sin(angle)
    x, y = vectors.unbind(1)
    return torch.stack([cosine * x - sine * y, sine * x + cosine * y], 1)


def _sampled(patch: Tensor, angle: Tensor, shift: Tensor) -> Tensor:
    """(B, C, m, m): at each place p of the smaller patch what (B, C, n, n) has at p, rotated by an angle, and shifted.

    angle: (B,) [rad]. shift: (B, 2) [mm].
    """
    half = (patch.shape[-1] - 1) / 2
    share = (CELLS - 1) / 2 / half
    cosine, sine = share * torch.cos(angle), share * torch.sin(angle)
    x, y = (shift * 1e-3 / CELL / half).unbind(1)
    # grid_sample's first coordinate is the last axis
    rows = torch.stack([torch.stack([cosine, sine, y], 1), torch.stack([-sine, cosine, x], 1)], 1)
    grid = F.affine_grid(rows, [len(patch), 1, CELLS, CELLS], align_corners=True)
    return F.grid_sample(patch, grid, align_corners=True)


@dataclass(frozen=True, eq=False)
class PlacedFit:
    """A fit and the truth about it."""

    channels: np.ndarray
    """(Channel, n, n) float16, n is CELLS and a BORDER on all sides."""
    twist: np.ndarray
    """(6,) float32 to the truth, as of `PlatePatch.twist_to`."""


@dataclass(frozen=True, eq=False)
class PlacedFits:
    """The fits of the queries of a split."""

    registration: Registration
    split: str
    folder: Path
    _kept: dict[str, PlacedFit | None] = field(default_factory=dict, repr=False)

    @property
    def dataset(self) -> Dataset:
        """The dataset of the queries."""
        return self.registration.dataset

    @cached_property
    def queries(self) -> dict[str, Query]:
        """The queries of TRACK, by id; for training with nearer guesses."""
        split = self.dataset.split(self.split, truth=True)
        own = [query for query in split.queries() if query.track == TRACK]
        return {query.id: self._nearer(query) if self.split == "train" else query for query in own}

    def draw(self, rng: np.random.Generator) -> PlacedFit:
        """The fit of a query, every query that has one with the same probability."""
        names = list(self.queries)
        for _ in range(TRIES if names else 0):
            fit = self.of(names[int(rng.integers(len(names)))])
            if fit is not None:
                return fit
        raise InputError(f"{self.dataset.root}: split {self.split} has no query of {TRACK} with a fit in its slot")

    def of(self, query_id: str) -> PlacedFit | None:
        """The best fit of a query; None if there is none, and where it is in another slot."""
        if query_id not in self._kept:
            memory = Memory(self.folder, compress=True, verbose=0)
            fit = memory.cache(_made, ignore=["fits"])(self, self.dataset.id, query_id)
            self._kept[query_id] = fit  # pyright: ignore[reportArgumentType]
        return self._kept[query_id]

    def _nearer(self, query: Query) -> Query:
        """The query with a guess whose error is the share NEARER of a user's."""
        goal = self._truth_of(query).goal_drawn
        offset, rotvec = draw_ball_error(stream(0, "placement", query.id))
        return replace(query, guess=apply_error(goal, query.pivot, NEARER * offset, NEARER * rotvec))

    def _truth_of(self, query: Query) -> Truth:
        return self.dataset.split(self.split, truth=True).scene(query.scene_id).truth_of(query.id)

    def made(self, query: Query) -> PlacedFit | None:
        """The fit of a query, made anew."""
        scene, (clearance,) = self.registration.scene(query), self.registration.all_clearances
        ((part, image),) = scene.parts()
        assert image is not None
        fits = FitSearch(PartRegistration(scene, part, image, clearance)).all_fits()
        patch = plate_patch(part, image, fits[0].candidate, clearance, CELLS + 2 * BORDER) if fits else None
        return None if patch is None else self._placed(patch, fits[0].goal_from_now, part.middle, self._truth_of(query))

    def _placed(self, patch: PlatePatch, goal_from_now: Pose, middle: np.ndarray, truth: Truth) -> PlacedFit | None:
        targets = Targets.of([truth], lambda part: self.dataset.geometry.part(part).mesh.vertices)
        errors = pose_errors(Pose.stack([goal_from_now]), targets)
        true = nearest_goal_motions(targets, errors)
        twist = patch.twist_to(Pose(true.wxyz[0], true.xyz[0]), goal_from_now, middle)
        if np.abs(twist[3:5]).max() > LARGEST_SHIFT or np.linalg.norm(twist[:3]) > LARGEST_ROTATION:
            return None
        return PlacedFit(patch.channels.astype(np.float16), twist.astype(np.float32))


def _made(fits: PlacedFits, dataset_id: str, query_id: str) -> PlacedFit | None:
    """The fit of a query; `dataset_id` tells datasets of one folder apart."""
    return fits.made(replace(fits.queries[query_id]))  # a copy: its image, once read, is kept with it


@dataclass
class PlacementTask:
    """Move a fit to its goal."""

    training: PlacedFits
    validation: PlacedFits
    model: PlacementNet

    def example(self, rng: np.random.Generator) -> Example:
        """One of the fits, changed."""
        return _example(self.training.draw(rng), drawn_changes(rng))

    def validation_keys(self) -> Sequence[str]:
        """Ids of the queries whose fit is in the right slot."""
        return [query_id for query_id in self.validation.queries if self.validation.of(query_id) is not None]

    def validation_example(self, key: str) -> Example:
        """The fit as it is."""
        fit = self.validation.of(key)
        assert fit is not None, key
        return _example(fit, no_changes())

    def loss(self, batch: Batch) -> Tensor:
        """() the mean error, squared where it is small."""
        return (self._off(batch).square() + SOFT**2).sqrt().mean()

    def measure(self, batch: Batch) -> Batch:
        """(B,) `across_mm`: how far the placed fit is off in its plate; `yaw_deg`."""
        off = self._off(batch)
        return {
            "across_mm": off[:, 1:].square().sum(1).sqrt(),
            "yaw_deg": torch.rad2deg(off[:, 0].abs() / LEVER),
        }

    def _off(self, batch: Batch) -> Tensor:
        """(B, 3) what is left of moves."""
        changes = Changes(*(batch[name] for name in Changes._fields))
        patch, true = changed(batch["patch"].float(), batch["move"], changes)
        return self.model(patch, changes.mirrored) - true


def _example(fit: PlacedFit, changes: Example) -> Example:
    return {"patch": fit.channels, "move": MM * fit.twist[IN_PLATE], **changes}


def placement_task(dataset: Dataset, preset: str, completion: Path, restoration: Path) -> PlacementTask:
    """The task with new weights. completion, restoration: stems of weights."""
    registration = Registration(
        dataset, completion=WEIGHTS / "completion", noisy_completion=completion, restoration=restoration
    )
    folder = dataset.root.with_name(f"{dataset.root.name}.fits")
    training, validation = (PlacedFits(registration, split, folder) for split in ("train", "val"))
    return PlacementTask(training, validation, PlacementNet(UNetConfig(widths=(32, 48, 64))))
