"""A source of registration whose part is known: what a patch of a plate reads of it."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from kit1000.values import LabelledDepth
from kit1000.voxels import Volume
from tests.samples.registration_images import CAMERA

GAIN = CAMERA.fx * 0.055


@dataclass(frozen=True)
class KnownSource:
    """What a patch reads of a source."""

    image: LabelledDepth
    part: Volume
    middle: np.ndarray
    measured: LabelledDepth | None = None
    gain: float = GAIN

    @property
    def query(self) -> SimpleNamespace:
        return SimpleNamespace(image=self.image, view=self.image.view)

    @property
    def evidence(self) -> SimpleNamespace:
        return SimpleNamespace(filled=self.part)

    @property
    def slimmer(self) -> Volume:
        return self.part

    @property
    def wider(self) -> Volume:
        return self.part
