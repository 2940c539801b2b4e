"""The depth image of a query as its parts share it: calibrated, its kits restored and its cavities found but once."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from kit1000.perception.calibration import CameraEstimate, camera_estimate_by
from kit1000.perception.restoration import restored_edges, unbent_image
from kit1000.perception.sensor_facts import AnySensor, gain_of, key_of, needs_restoring, table_is_simulated
from kit1000.registration.geometry.observed_cavity import Cavity
from kit1000.values import ASSEMBLY_LABEL, LabelledDepth, View

if TYPE_CHECKING:
    from kit1000.perception.restoration.hole_filler import HoleFiller
    from kit1000.perception.restoration.restorer import Restorer


@dataclass(eq=False)
class SharedImage:
    """An image and what was found in it for one part, which the next part need not find again."""

    recorded: LabelledDepth
    sensor: AnySensor
    restorer: Restorer | None = None
    """The network that restores noisy images; None restores by rules."""
    filler: HoleFiller | None = None
    """The network that fills holes of kits in a scanner's images; None leaves them unknown."""
    cavities: dict[float, list[Cavity]] = field(default_factory=dict, init=False)
    """See `Source.cavities`."""
    _kits: View | None = field(default=None, init=False)
    """With restored kits, once any part was asked for."""

    @property
    def gain(self) -> float:
        """[px m] disparity times depth; 0 of an exact image."""
        return gain_of(self.recorded.view.camera, self.sensor)

    @cached_property
    def measured(self) -> LabelledDepth:
        """Calibrated by the table."""
        if self._estimate is None:
            return self.recorded
        return unbent_image(replace(self.recorded, view=self._estimate.view), self.sensor)

    @property
    def camera(self) -> CameraEstimate | None:
        """The camera, with its uncertainty; None where the world is no simulated one, but the image's own frame."""
        return self._estimate if table_is_simulated(self.sensor) else None

    @cached_property
    def _estimate(self) -> CameraEstimate | None:
        """None of an exact image."""
        if self.sensor == "ideal":
            return None
        return camera_estimate_by(self.recorded.view, self.recorded.labels, self.sensor)

    @property
    def guesses(self) -> tuple[bool, ...]:
        """The guesses at what the holes of a part show, each as the `columns` of `restored`."""
        return (False, True) if key_of(self.sensor) == "photoneo" else (False,)

    def restored(self, label: int, columns: bool = False) -> LabelledDepth:
        """Calibrated, the edges of the kits and of the part of a label where they are.

        columns: whether holes of parts that no network restores are closed along columns too.
        """
        if self.restorer is None or not needs_restoring(self.sensor):
            return self._with_columns if columns else self._by_rules
        if self._kits is None:
            image = self.restorer(self.measured, self.sensor, (ASSEMBLY_LABEL, label))
            self._kits = image.view
            return image
        image = self.restorer(self.measured, self.sensor, (label,))
        depth = np.where(image.labels == ASSEMBLY_LABEL, self._kits.depth, image.view.depth)
        return replace(image, view=replace(image.view, depth=depth))

    @cached_property
    def _by_rules(self) -> LabelledDepth:
        return restored_edges(self._filled, self.sensor)

    @cached_property
    def _with_columns(self) -> LabelledDepth:
        return restored_edges(self._filled, self.sensor, columns=True)

    @cached_property
    def _filled(self) -> LabelledDepth:
        """Calibrated, holes of kits in a scanner's image filled where a network is sure."""
        if self.filler is None or key_of(self.sensor) != "photoneo":
            return self.measured
        return self.filler(self.measured, self.sensor, (ASSEMBLY_LABEL,))
