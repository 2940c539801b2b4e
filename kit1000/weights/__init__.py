"""The trained networks that perception and registration load: NAME.safetensors with NAME.json each.

Those in `measured` read the images of real stereo cameras: they learned from the sensor as measured
(`kit1000.sim.measured_sensors`), the others from the d415 of data 1.0.0, which is kinder.
"""

from pathlib import Path

WEIGHTS = Path(__file__).parent
"""Their folder."""
MEASURED = WEIGHTS / "measured"
"""The folder of those for the noise of real cameras, under the names of the networks that they replace."""
