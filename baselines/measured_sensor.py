"""Registration for real stereo cameras: the networks that read noise, trained on the sensor as measured.

The d415 of data 1.0.0 is kinder than real cameras; `kit1000.sim.measured_sensors` has the errors of real ones. The
weights started from those of `registration-completed` and were trained further on that sensor: preset `measured`.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from kit1000.registration import METHODS as REGISTRATION

WEIGHTS = Path(__file__).parent / "weights"
COMPLETED = REGISTRATION["registration-completed"]

METHODS = {
    "registration-measured": replace(
        COMPLETED,
        description="registration-completed with networks trained on the noise of real stereo cameras",
        label="Registration, networks of the measured sensor",
        training_data="40,000 and 30,000 sampled parts and views of split train, as seen by the measured sensor",
        weights={
            **COMPLETED.weights,
            "noisy_completion": WEIGHTS / "completion-measured",
            "restoration": WEIGHTS / "restoration-measured",
        },
    )
}
