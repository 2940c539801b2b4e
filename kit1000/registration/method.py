"""The method from end to end: a source of volumes, registration in it, and the confidence in the best fit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.perception.heights.labelled_views import LabelledViews
from kit1000.perception.observed.parts import ObservedPart
from kit1000.perception.restoration import restored_query
from kit1000.perception.sensor_facts import needs_restoring, sensor_of
from kit1000.pose import Pose
from kit1000.predictor import PredictedMotion
from kit1000.queries.pivots import part_pivots
from kit1000.registration.choice.assignment import assigned
from kit1000.registration.choice.confidence import confidence
from kit1000.registration.choice.fits import Fit, lead, least_misfit, ranked
from kit1000.registration.choice.from_evidence import register_certain
from kit1000.registration.choice.from_filled_part import register_columns
from kit1000.registration.choice.several_images import agreed
from kit1000.registration.inputs.other_places import from_elsewhere
from kit1000.registration.inputs.shared_image import SharedImage
from kit1000.registration.inputs.volume_sources import DepthSource, TrueSource
from kit1000.registration.search.effort import affordable
from kit1000.values import FIRST_PART_LABEL, Query, TrueGeometry

if TYPE_CHECKING:
    from kit1000.perception.completion.parts.completed import PartCompleter
    from kit1000.perception.placement.placer import Placer
    from kit1000.perception.restoration.hole_filler import HoleFiller
    from kit1000.perception.restoration.restorer import Restorer

SOURCES = ("depth", "columns", "truth")
UNKNOWN = (0.25e-3, 0.5e-3, 1e-3, 2.5e-3)  # [m] clearances that are tried where the dataset states none
LARGEST = 0.1  # [m] of a clearance that is stated: a larger one was written in mm


@dataclass(frozen=True, eq=False)
class Registration:
    """Predicts by registration: compares the cavity that the part would cut with those in the plates."""

    dataset: Dataset
    source: str = "depth"
    """depth: the query's image and masks, by what they make certain; columns: the same, with the part filled down to
    the table; truth: the true geometry."""
    clearances: tuple[float, ...] = ()
    """[m] to try, of which the best fit counts; by default the one that the dataset states, or UNKNOWN."""
    completion: Path | None = None
    """Stem of the weights of a network that completes the part; None fills columns."""
    noisy_completion: Path | None = None
    """The same of one that learned from noisy images alone, which it reads; None: `completion` reads them too."""
    restoration: Path | None = None
    """Stem of the weights of a network that restores noisy images; None restores by rules."""
    hole_filling: Path | None = None
    """Stem of the weights of a network that fills holes of kits in a scanner's images; None: they stay unknown."""
    placement: Path | None = None
    """Stem of the weights of a network that places fits in images that a network restored; None: it is not asked."""
    cameras: Literal["primary", "three"] = "primary"
    """three: further images beside the query's own, which source `depth` reads."""

    def __post_init__(self) -> None:
        if self.source not in SOURCES:
            raise InputError(f"source {self.source!r}: expected one of {', '.join(SOURCES)}")
        if self.cameras == "three" and self.source != "depth":
            raise InputError(f"cameras 'three': source depth alone reads them, got source {self.source!r}")

    @cached_property
    def views(self) -> LabelledViews:
        """The images of the three cameras."""
        return LabelledViews(self.dataset)

    @cached_property
    def restorer(self) -> Restorer | None:
        """The network that restores images."""
        if self.restoration is None:
            return None
        from kit1000.perception.restoration.restorer import Restorer

        return Restorer(self.restoration)

    @cached_property
    def filler(self) -> HoleFiller | None:
        """The network that fills holes."""
        if self.hole_filling is None:
            return None
        from kit1000.perception.restoration.hole_filler import HoleFiller

        return HoleFiller(self.hole_filling)

    def placer(self, sensor: str) -> Placer | None:
        """The network that places fits in the images of a sensor."""
        return _placer(self.placement) if self.placement is not None and self._restores(sensor) else None

    def completer(self, sensor: str) -> PartCompleter | None:
        """The network that completes parts in the images of a sensor."""
        stem = self.noisy_completion if needs_restoring(sensor) else None
        return None if self.completion is None else _completer(stem or self.completion)

    @property
    def uses_true_geometry(self) -> bool:
        """Whether it needs the true geometry."""
        return self.source == "truth"

    def __call__(self, query: Query, geometry: TrueGeometry | None = None) -> PredictedMotion:
        """The best fit; where nothing fits, the guess or no motion, with confidence 0."""
        return self._best(self.fits(query, geometry), query)

    def motions(self, query: Query, geometry: TrueGeometry | None = None) -> list[PredictedMotion]:
        """All fits, the best first, each with its confidence."""
        fits = self.fits(query, geometry)
        return [self._motion(fit, fits, query) for fit in fits]

    def _motion(self, fit: Fit, fits: list[Fit], query: Query) -> PredictedMotion:
        """One of the fits, with its confidence."""
        ahead = lead(fit, fits, query.pivot)
        return PredictedMotion(fit.goal_from_now, confidence(fit.doubt, ahead, self.source, self._kind(query)))

    def _kind(self, query: Query) -> str:
        """The kind of an image: its sensor, or restored where a network restores it."""
        return "restored" if self._restores(query.sensor) else query.sensor

    def _restores(self, sensor: str) -> bool:
        """Whether a network restores the images of a sensor."""
        return self.restorer is not None and needs_restoring(sensor)

    def together(self, queries: Sequence[Query]) -> PredictedMotion:
        """The best fit by several images of one part, which cameras took in one world."""
        return self._best(self._fits_together(queries), queries[0])

    def _best(self, fits: list[Fit], query: Query) -> PredictedMotion:
        """The first of the fits; the guess or no motion where there is none."""
        if not fits:
            return PredictedMotion(Pose.identity() if query.guess is None else query.guess, 0.0)
        return self._motion(fits[0], fits, query)

    def fits(self, query: Query, geometry: TrueGeometry | None = None) -> list[Fit]:
        """All fits, the best first; by all images of the scene, where dataset.json states several."""
        return self._fits_together([query, *from_elsewhere(self.dataset, query)], geometry)

    def _fits_together(self, queries: Sequence[Query], geometry: TrueGeometry | None = None) -> list[Fit]:
        """All fits by the images of some queries about one part, the best first."""
        return agreed([self.fits_in_image(query, geometry) for query in queries], queries[0].pivot)

    def fits_in_image(self, query: Query, geometry: TrueGeometry | None = None) -> list[Fit]:
        """All fits by the query's own image, the best first.

        Where no clearance is stated, those from depth are at the one that fits best.
        """
        if self.source == "depth":
            image = self.image_of(query)
            if not self.clearances and len(self.all_clearances) > 1:
                return self._fits_at_best_clearance(query, image)
            fits = self.certain_fits(query, image)
            if query.guess is not None or self.clearances:
                return fits
            others = (self.certain_fits(other, image, thorough=False) for other in _other_parts(query))
            return assigned(fits, others, self._kind(query))
        if self.source == "columns":
            query = restored_query(query)
        filled = DepthSource(query) if self.source == "columns" else _true_source(query, geometry)
        return ranked(chain.from_iterable(register_columns(filled, query, c) for c in self.all_clearances))

    @cached_property
    def all_clearances(self) -> tuple[float, ...]:
        """[m] to try."""
        return self.clearances or stated_clearances(self.dataset)

    def certain_fits(self, query: Query, image: SharedImage, thorough: bool = True) -> list[Fit]:
        """All fits by what the image makes certain. thorough: further candidates are refined while none fits well.

        Of several guesses at what holes of the part show that counts whose best fit has the least misfit: a wrong
        shape fits no cavity.
        """
        further = thorough and len(self.all_clearances) == 1  # at a wrong clearance every fit is doubtful
        sources = self.sources(query, image)
        return min((_fits(source, self.all_clearances, further) for source in sources), key=least_misfit)

    def _fits_at_best_clearance(self, query: Query, image: SharedImage) -> list[Fit]:
        """The fits at the clearance whose best fit has the least misfit; at that one further candidates are refined."""
        first, *others = self.sources(query, image)
        quick = {c: register_certain(first, first.query, c, further=False) for c in self.all_clearances}
        best = min(quick, key=lambda clearance: least_misfit(quick[clearance]))
        fits = min((_fits(source, (best,)) for source in (first, *others)), key=least_misfit)
        if query.guess is not None:
            return fits
        rest = (self.sources(other, image)[0] for other in _other_parts(query))
        return assigned(fits, (_fits(source, (best,), further=False) for source in rest), self._kind(query))

    def image_of(self, query: Query) -> SharedImage:
        """The image of a query, for all parts of its scene."""
        sensor = sensor_of(self.dataset.summary, query.sensor, query.scene_id)
        return SharedImage(query.image, sensor, self.restorer, self.filler)

    def sources(self, query: Query, image: SharedImage) -> list[DepthSource]:
        """What registration reads of a query, by each guess at what holes of the part show."""
        return [self._source(query, image, columns) for columns in image.guesses]

    def _source(self, query: Query, image: SharedImage, columns: bool) -> DepthSource:
        """What registration reads of a query, calibrated and restored."""
        kind, label = self._kind(query), FIRST_PART_LABEL + query.part
        query = replace(query, read_image=lambda: image.restored(label, columns))
        return DepthSource(
            query,
            self.completer(query.sensor),
            measured=image.measured if needs_restoring(query.sensor) else None,
            others=() if self.cameras == "primary" else self.views.of(query),
            restored=kind == "restored",
            gain=image.gain,
            placer=self.placer(query.sensor),
            camera=image.camera,
            cavities=image.cavities,
        )


def _fits(source: DepthSource, clearances: Sequence[float], further: bool = True) -> list[Fit]:
    """The fits of a source at some clearances [m], the best first. further: see `register_certain`."""
    return ranked(chain.from_iterable(register_certain(source, source.query, c, further) for c in clearances))


def stated_clearances(dataset: Dataset) -> tuple[float, ...]:
    """[m] the clearance that a dataset states, or UNKNOWN; raises InputError where it is no length."""
    stated = dataset.summary.get("config", {}).get("clearance")
    if stated is None:
        return UNKNOWN
    if isinstance(stated, bool) or not isinstance(stated, int | float) or not 0 < stated < LARGEST:
        raise InputError(
            f"{dataset.root}: dataset.json: config: clearance: expected metres, such as 0.0025, or none where it is "
            f"not known, got {stated!r}"
        )
    return (stated,)


@lru_cache(maxsize=2)  # for exact and for noisy images
def _completer(stem: Path) -> PartCompleter:
    """The network with the weights of a stem, loaded when an image asks for it."""
    from kit1000.perception.completion.parts.completed import PartCompleter

    return PartCompleter(stem)


@lru_cache(maxsize=1)
def _placer(stem: Path) -> Placer:
    """The network with the weights of a stem, loaded when an image asks for it."""
    from kit1000.perception.placement.placer import Placer

    return Placer(stem)


def _other_parts(query: Query) -> Iterator[Query]:
    """The query about each other part of its image, as far as they are affordable."""
    pivots = part_pivots(query.view, query.image.labels) | {query.part: query.pivot}
    seen = {part: ObservedPart(query.image, FIRST_PART_LABEL + part, pivot) for part, pivot in pivots.items()}
    half_widths = {part: each.half_width for part, each in seen.items()}
    own = half_widths.pop(query.part)
    for part in affordable(half_widths, own):
        yield replace(query, part=part, pivot=pivots[part])


def _true_source(query: Query, geometry: TrueGeometry | None) -> TrueSource:
    if geometry is None:
        raise InputError(f"{query.id}: registration from true volumes needs the true geometry")
    return TrueSource(geometry)
