"""What methods read of a noisy depth image: calibrated by its table, its shadows closed, its edges where they are.

`rules` does so without learning. A network learned it from views of the scenes of the train split: read `disparity`
(its input), `network` and `restorer` (its use). Another one of its kind fills a scanner's holes: `hole_filler`.
"""

from kit1000.perception.restoration.rules import (
    calibrated_image,
    restored,
    restored_edges,
    restored_query,
    unbent_image,
)

__all__ = ["calibrated_image", "restored", "restored_edges", "restored_query", "unbent_image"]
