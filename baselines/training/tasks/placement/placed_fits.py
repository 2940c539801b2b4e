"""Fits to learn placement from: what registration finds for the queries of a split, and the moves that mend them.

A fit takes seconds, so each is made when first needed and kept in a file: the folder is only a cache.
"""

from __future__ import annotations

import io
import os
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.files import write_bytes
from kit1000.metrics import Targets, pose_errors
from kit1000.metrics.pose_errors import nearest_goal_motions
from kit1000.perception.placement import CELLS
from kit1000.pose import Pose
from kit1000.queries.guesses import draw_ball_error
from kit1000.queries.motions import apply_error
from kit1000.registration.image_refine import PlatePatch, plate_patch
from kit1000.registration.method import FitSearch, PartRegistration
from kit1000.registration.predictor import Registration
from kit1000.rng import stream
from kit1000.values import Query, Truth

TRACK = "snap-d415"
NEARER = 0.4  # share of the error of a user's guess from which fits for training start: few then end in another slot
BORDER = 8  # cells about a patch, which changes move into it
LARGEST_SHIFT, LARGEST_ROTATION = 7e-3, 0.25  # [m] across, [rad] of a twist: a fit farther off is in another slot
TRIES = 1000  # queries drawn in a row without a fit before the split counts as empty
NONE = np.zeros(0, np.float32)


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
        """The best fit of a query; None where there is none, and where it is in another slot."""
        if query_id not in self._kept:
            self._kept[query_id] = self._read(query_id)
        return self._kept[query_id]

    def _read(self, query_id: str) -> PlacedFit | None:
        """The fit from its file, which is written if there is none yet."""
        path = self.folder / f"{self.dataset.id}-{query_id}.npz"
        if path.is_file():
            return _decoded(path.read_bytes())
        fit = self._made(replace(self.queries[query_id]))  # a copy: its image, once read, is kept with it
        os.makedirs(self.folder, exist_ok=True)
        write_bytes(path, _encoded(fit))
        return fit

    def _nearer(self, query: Query) -> Query:
        """The query with a guess whose error is the share NEARER of a user's."""
        goal = self._truth_of(query).goal_drawn
        offset, rotvec = draw_ball_error(stream(0, "placement", query.id))
        return replace(query, guess=apply_error(goal, query.pivot, NEARER * offset, NEARER * rotvec))

    def _truth_of(self, query: Query) -> Truth:
        return self.dataset.split(self.split, truth=True).scene(query.scene_id).truth_of(query.id)

    def _made(self, query: Query) -> PlacedFit | None:
        scene, (clearance,) = self.registration.scene(query), self.registration.all_clearances
        ((part, image),) = scene.parts(query)
        assert image is not None
        fits = FitSearch(PartRegistration(scene, part, image, query, clearance)).all_fits()
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


def _encoded(fit: PlacedFit | None) -> bytes:
    """As a compressed file of numpy, empty where there is no fit."""
    file = io.BytesIO()
    channels, twist = (NONE, NONE) if fit is None else (fit.channels, fit.twist)
    np.savez_compressed(file, channels=channels, twist=twist)
    return file.getvalue()


def _decoded(content: bytes) -> PlacedFit | None:
    with np.load(io.BytesIO(content), allow_pickle=False) as file:
        return PlacedFit(file["channels"], file["twist"]) if len(file["twist"]) else None
