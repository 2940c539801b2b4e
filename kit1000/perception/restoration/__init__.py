"""Restoration of a noisy depth image: calibrated by its table, its shadows closed, its edges at their true pixels.

`rules` does so without learning. A network learned it from views of the scenes of the train split: read `disparity`
(its input) and `restorer` (the network and its use). Another one of its kind fills holes in a scanner's images.
"""

from kit1000.perception.restoration.rules import (
    calibrated_image,
    restored,
    restored_edges,
    restored_query,
    unbent_image,
)

__all__ = ["calibrated_image", "restored", "restored_edges", "restored_query", "unbent_image"]
