"""The choice among refined fits, and how confident it is."""
