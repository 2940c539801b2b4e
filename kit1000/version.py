"""The version of the software; the data and the metrics have their own."""

__version__ = "1.0.0"
