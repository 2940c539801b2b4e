"""Reading and writing recordings: shards of scenes in MCAP, observations in one file and ground truth in another.

A file is written atomically, has one chunk for each scene, and opens in Foxglove and Lichtblick. Readers read only the
requested messages, and raise InputError for any damage, as every message has a checksum.
"""

from kit1000.dataset.mcap_io.observations import ObservationFile, ObservationWriter
from kit1000.dataset.mcap_io.truths import TruthFile, TruthWriter

__all__ = ["ObservationFile", "ObservationWriter", "TruthFile", "TruthWriter"]
