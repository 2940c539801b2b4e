"""The predictor: a query in, a motion out. `prepared_image` reads the image, `method` registers the part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.perception.image_kinds import ImageKind
from kit1000.perception.sensor_facts import sensor_of
from kit1000.pose import Pose
from kit1000.predictor import PredictedMotion
from kit1000.registration.method import Scene, TrueScene, fits_in
from kit1000.registration.prepared_image import Networks, PreparedImage
from kit1000.registration.rank import Fit, agreed, confidence, from_elsewhere
from kit1000.values import Query, TrueGeometry

SOURCES = ("depth", "columns", "truth")
USUAL_CLEARANCES = (0.25e-3, 0.5e-3, 1e-3, 2.5e-3)  # [m] that are tried if the dataset states none
LARGEST_CLEARANCE = 0.1  # [m] a larger one was written in mm


@dataclass(frozen=True, eq=False)
class Registration:
    """Predicts by registration: compares the cavity that the part would cut with those in the plates."""

    dataset: Dataset
    source: str = "depth"
    """depth: the query's image and masks, by what they make certain; columns: the same, with the part filled down to
    the table; truth: the true geometry."""
    clearances: tuple[float, ...] = ()
    """[m] to try; the best fit decides. By default the one that the dataset states, else USUAL_CLEARANCES."""
    completion: Path | None = None
    """Stem of the weights of a network that completes the part; None fills columns."""
    noisy_completion: Path | None = None
    """The same of one that learned from noisy images alone, and reads them; None: `completion` reads them too."""
    restoration: Path | None = None
    """Stem of the weights of a network that restores images of stereo cameras; None restores by rules."""
    hole_filling: Path | None = None
    """Stem of the weights of a network that fills holes of kits in images of scanners; None: they stay unknown."""
    placement: Path | None = None
    """Stem of the weights of a network that places fits in images that a network restored; None: none does."""

    def __post_init__(self) -> None:
        if self.source not in SOURCES:
            raise InputError(f"source {self.source!r}: expected one of {', '.join(SOURCES)}")

    @property
    def uses_true_geometry(self) -> bool:
        """Whether it needs the true geometry."""
        return self.source == "truth"

    def __call__(self, query: Query, geometry: TrueGeometry | None = None) -> PredictedMotion:
        """The best fit; if nothing fits, the guess or no motion, with confidence 0."""
        return self._best(self.fits(query, geometry), query)

    def propose(self, query: Query, geometry: TrueGeometry | None = None) -> list[PredictedMotion]:
        """All fits, the best first, each with its confidence."""
        fits = self.fits(query, geometry)
        return [self._motion(fit, fits) for fit in fits]

    def together(self, queries: Sequence[Query]) -> PredictedMotion:
        """The best fit by several images of one part, which cameras took in one world."""
        return self._best(self._agreed_fits(queries), queries[0])

    def fits(self, query: Query, geometry: TrueGeometry | None = None) -> list[Fit]:
        """All fits, the best first; by all images of the scene, if dataset.json states several."""
        return self._agreed_fits([query, *from_elsewhere(self.dataset, query)], geometry)

    def scene(self, query: Query, geometry: TrueGeometry | None = None) -> Scene:
        """What is registered: the query's image, prepared, or the true scene."""
        if self.source == "truth":
            if geometry is None:
                raise InputError(f"{query.id}: registration from true volumes needs the true geometry")
            return TrueScene(query, geometry)
        sensor = sensor_of(self.dataset.summary, query.sensor, query.scene_id)
        return PreparedImage(query, sensor, self.networks(sensor.kind), filled_only=self.source == "columns")

    def networks(self, kind: ImageKind) -> Networks:
        """The networks for images of a kind, loaded at the first such image."""
        completion = self.noisy_completion if kind.restores and self.noisy_completion else self.completion
        restoration = self.restoration if kind.restores else None
        return Networks(
            completer=_network("completer", completion),
            restorer=_network("restorer", restoration),
            filler=_network("filler", self.hole_filling if kind.fills_holes else None),
            placer=_network("placer", self.placement if restoration else None),
        )

    @cached_property
    def all_clearances(self) -> tuple[float, ...]:
        """[m] to try."""
        return self.clearances or stated_clearances(self.dataset)

    def _agreed_fits(self, queries: Sequence[Query], geometry: TrueGeometry | None = None) -> list[Fit]:
        """All fits by the images of some queries about one part, the best first."""
        images = [fits_in(self.scene(query, geometry), self.all_clearances) for query in queries]
        return agreed(images, queries[0].pivot)

    def _best(self, fits: list[Fit], query: Query) -> PredictedMotion:
        """The first of the fits; without fits the guess or no motion."""
        if not fits:
            return PredictedMotion(Pose.identity() if query.guess is None else query.guess, 0.0)
        return self._motion(fits[0], fits)

    def _motion(self, fit: Fit, fits: list[Fit]) -> PredictedMotion:
        """One of the fits, with its confidence."""
        return PredictedMotion(fit.goal_from_now, confidence(fit, fits))


@lru_cache(maxsize=8)
def _network(use: str, stem: Path | None) -> Any:
    """The network for a field of `Networks`, with the weights of a stem; None without one. It alone loads torch."""
    if stem is None:
        return None
    from kit1000.perception.completion.parts import PartCompleter
    from kit1000.perception.placement.network import Placer
    from kit1000.perception.restoration.restorer import HoleFiller, Restorer

    return {"completer": PartCompleter, "restorer": Restorer, "filler": HoleFiller, "placer": Placer}[use](stem)


def stated_clearances(dataset: Dataset) -> tuple[float, ...]:
    """[m] the clearance that a dataset states, or USUAL_CLEARANCES; raises InputError if it states no length."""
    stated = dataset.summary.get("config", {}).get("clearance")
    if stated is None:
        return USUAL_CLEARANCES
    if isinstance(stated, bool) or not isinstance(stated, int | float) or not 0 < stated < LARGEST_CLEARANCE:
        raise InputError(
            f"{dataset.root}: dataset.json: config: clearance: expected metres, such as 0.0025, or none if it is not "
            f"known, got {stated!r}"
        )
    return (stated,)
