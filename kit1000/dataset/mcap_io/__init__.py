"""Reading and writing recordings: shards of scenes in MCAP, observations in one file and ground truth in another.

A file is written atomically and opens in Foxglove and Lichtblick. Each image of a scene is a chunk of its own: readers
decompress only the requested ones, and raise InputError for any damage, as every chunk has a checksum.
"""

from kit1000.dataset.mcap_io.observations import ObservationFile, ObservationWriter
from kit1000.dataset.mcap_io.truths import TruthFile, TruthWriter

__all__ = ["ObservationFile", "ObservationWriter", "TruthFile", "TruthWriter"]
