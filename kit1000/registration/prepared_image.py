"""The depth image of a query, calibrated and restored: what registration reads of it.

All is done when the image is prepared, except that networks restore and complete the part when it is read. The images
hold in the world of the recorded image: calibration corrects the pose
of the camera and the depths, so the pivot and the guess of a query are valid beside them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from kit1000.perception.calibration import CameraEstimate, camera_estimate_by
from kit1000.perception.image_kinds import ImageKind
from kit1000.perception.observed.parts import ObservedPart
from kit1000.perception.restoration import restored_edges, unbent_image
from kit1000.perception.sensor_facts import SensorFacts
from kit1000.registration.kit_volume import KitCavities, SeenKits
from kit1000.registration.part_volume import PartShape, seen_part
from kit1000.registration.search import LARGEST
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, LabelledDepth, Query

if TYPE_CHECKING:
    from kit1000.perception.completion.parts import PartCompleter
    from kit1000.perception.placement.network import Placer
    from kit1000.perception.restoration.restorer import HoleFiller, Restorer


@dataclass(frozen=True)
class Networks:
    """The networks that prepare images of one kind; None: rules do the same, or nothing does."""

    completer: PartCompleter | None = None
    """Completes parts; None fills columns."""
    restorer: Restorer | None = None
    """Restores images of stereo cameras."""
    filler: HoleFiller | None = None
    """Fills holes of kits in images of scanners; None leaves them unknown."""
    placer: Placer | None = None
    """Places fits in images that `restorer` restored."""


@dataclass(frozen=True, eq=False)
class RestoredImage:
    """An image as one of its parts is registered in it."""

    restored: LabelledDepth
    measured: LabelledDepth
    """The same image calibrated, before restoration."""
    gain: float
    """[px m] disparity times depth; 0 of an exact image."""
    placer: Placer | None = None
    """The network that places fits in it."""


class PreparedImage:
    """A calibrated and restored image, with its kits and parts."""

    def __init__(
        self,
        query: Query,
        sensor: SensorFacts,
        networks: Networks = Networks(),
        others: Sequence[LabelledDepth] = (),
        filled_only: bool = False,
    ) -> None:
        """Calibrate and restore the image of a query.

        Args:
            query: about one of its parts; its guess bounds the search in the kits.
            sensor: that took the image.
            networks: that restore and complete it.
            others: images of further cameras, with the labels of the query's image.
            filled_only: whether the filled parts are taken for the true ones.
        """
        self.query, self.recorded, self.others = query, query.image, tuple(others)
        self._networks, self._filled_only, self._restores = networks, filled_only, sensor.kind.restores
        self.kind: ImageKind = sensor.kind if networks.restorer is None else sensor.kind.best
        self.gain = sensor.gain(query.image.view.camera)
        self.measured, self.camera = _calibrated(query.image, sensor)
        self._restoration = None
        if networks.restorer is not None and sensor.kind.restores:
            self._restoration = networks.restorer.begin(self.measured, sensor)
            self._closed = [self._restoration.with_bodies((ASSEMBLY_LABEL,))]
        else:
            self._closed = _closed(self.measured, sensor, networks.filler)
        self.kits = KitCavities(SeenKits.of((self._closed[0], *self.others), self.kind.noise), query)

    def parts(self) -> Iterator[tuple[PartShape, RestoredImage]]:
        """The part of the query, once for each way to close its holes; none if it is too large.

        A scanner leaves holes in parts: each way to close them is tried, and the best fit decides.
        """
        label, pivot, placer = FIRST_PART_LABEL + self.query.part, self.query.pivot, None
        for closed in self._closed:
            image = closed
            if self._restoration is not None:
                image, placer = self._restoration.with_bodies((label,), closed.view.depth), self._networks.placer
            observed = ObservedPart(image, label, pivot, self.others)
            if observed.half_width <= LARGEST:
                shape = seen_part(observed, self.measured, self._networks.completer, self._restores, self._filled_only)
                yield shape, RestoredImage(image, self.measured, self.gain, placer)


def _calibrated(image: LabelledDepth, sensor: SensorFacts) -> tuple[LabelledDepth, CameraEstimate | None]:
    """An image calibrated by its table, and its camera.

    The camera is None if it is exact, or if the world was found in the image itself.
    """
    if sensor.kind.exact:
        return image, None
    estimate = camera_estimate_by(image.view, image.labels, sensor)
    measured = unbent_image(replace(image, view=estimate.view), sensor)
    return measured, estimate if sensor.simulated_table else None


def _closed(measured: LabelledDepth, sensor: SensorFacts, filler: HoleFiller | None) -> list[LabelledDepth]:
    """A calibrated image restored by rules, once for each way to close the holes of parts."""
    if not sensor.kind.fills_holes:
        return [restored_edges(measured, sensor)]
    filled = measured if filler is None else filler(measured, sensor, (ASSEMBLY_LABEL,))
    return [restored_edges(filled, sensor, columns=columns) for columns in (False, True)]
