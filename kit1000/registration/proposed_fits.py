"""Registration as a source of proposals: all its fits of a part, for a person to choose among."""

from __future__ import annotations

from kit1000.mesh import Mesh
from kit1000.perception.observed.kits import ObservedKits
from kit1000.perception.observed.pixels import noise_of
from kit1000.perception.restoration import calibrated_image
from kit1000.perception.sensor_facts import sensor_of
from kit1000.predictor import PredictedMotion
from kit1000.registration.method import Registration
from kit1000.values import ASSEMBLY_LABEL, Query, TrueGeometry
from kit1000.weights import WEIGHTS


class ProposingRegistration(Registration):
    """Registration that hands out all its fits, each with the share of such fits that are seated."""

    def propose(self, query: Query, geometry: TrueGeometry | None = None) -> list[PredictedMotion]:
        """All fits, the best first."""
        return self.motions(query, geometry)


class CompletingRegistration(ProposingRegistration):
    """The same with networks that complete the part and restore noisy images, as `registration-completed`."""

    def completed_kits(self, query: Query) -> Mesh:
        """What the image of a query hides of the kits, as a network completes it, where the image shows the rest.

        [m] world, as the recorded camera is believed to stand: a noisy image is calibrated to complete it.
        """
        from kit1000.perception.completion.kits.completed import ReliefCompleter
        from kit1000.perception.completion.kits.hidden_surface import hidden_surfaces

        sensor = sensor_of(self.dataset.summary, query.sensor, query.scene_id)
        image = calibrated_image(query.image, sensor)
        restored = image if self.restorer is None else self.restorer(image, sensor, (ASSEMBLY_LABEL,))
        noise = noise_of(query.sensor, restored=True)
        kits = ObservedKits(restored, noise, query.scene_id, completer=ReliefCompleter(WEIGHTS / "kit-completion"))
        recorded_from_calibrated = query.view.world_from_camera @ image.view.world_from_camera.inverse()
        return hidden_surfaces(kits).moved(recorded_from_calibrated)
