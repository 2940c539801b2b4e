"""Recordings: shards of scenes in MCAP, observations in one file and the truth in another, written and read.

A file is written whole or not at all, holds one scene a chunk, and opens in Foxglove and Lichtblick as it is. Readers
take only what is asked for, and answer damage of any kind with an InputError, never with other numbers.
"""

from kit1000.dataset.mcap_io.observations import ObservationFile, ObservationWriter
from kit1000.dataset.mcap_io.truths import TruthFile, TruthWriter

__all__ = ["ObservationFile", "ObservationWriter", "TruthFile", "TruthWriter"]
