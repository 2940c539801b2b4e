"""Registration as a source of proposals: all its fits of a part, for a person to choose among."""

from __future__ import annotations

from typing import Any

from baselines.catalog import WEIGHTS, weight_paths
from baselines.completion import ObservedKits
from baselines.completion.pixels import noise_of
from baselines.registration import METHODS
from baselines.registration.method import Registration
from baselines.restoration import calibrated_image
from kit1000.dataset.reader import Dataset
from kit1000.mesh import Mesh
from kit1000.predictor import PredictedMotion
from kit1000.values import ASSEMBLY_LABEL, Query, TrueGeometry


class ProposingRegistration(Registration):
    """Registration that hands out all its fits, each with the share of such fits that are seated."""

    def propose(self, query: Query, geometry: TrueGeometry | None = None) -> list[PredictedMotion]:
        """All fits, the best first."""
        return self.motions(query, geometry)


class CompletingRegistration(ProposingRegistration):
    """The same with networks that complete the part and restore noisy images, as `registration-completed`."""

    def __init__(self, dataset: Dataset) -> None:
        weights: dict[str, Any] = weight_paths(METHODS["registration-completed"].weights)
        super().__init__(dataset, **weights)

    def completed_kits(self, query: Query) -> Mesh:
        """What the image of a query hides of the kits, as a network completes it, where the image shows the rest.

        [m] world, as the recorded camera is believed to stand: a noisy image is calibrated to complete it.
        """
        from baselines.completion.completed_kits import ReliefCompleter
        from baselines.completion.hidden_surface import hidden_surfaces

        image = calibrated_image(query.image, query.sensor)
        restored = image if self.restorer is None else self.restorer(image, query.sensor, (ASSEMBLY_LABEL,))
        noise = noise_of(query.sensor, restored=True)
        kits = ObservedKits(restored, noise, query.scene_id, completer=ReliefCompleter(WEIGHTS / "kit-completion"))
        recorded_from_calibrated = query.view.world_from_camera @ image.view.world_from_camera.inverse()
        return hidden_surfaces(kits).moved(recorded_from_calibrated)
