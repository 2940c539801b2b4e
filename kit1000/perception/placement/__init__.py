"""Placement of a fit in its plate by a network: the channels of the patches that `network` reads.

A patch shows what an image shows of a plate about a fit, and what it would show of the fit's cavity.
"""

from __future__ import annotations

from enum import IntEnum

CELL = 1e-3  # [m] of a patch
CELLS = 88  # of a side of the patches that the network reads


class Channel(IntEnum):
    """Disparities [px] are beyond those of the plate's face."""

    RESTORED = 0
    """The restored image."""
    IS_RESTORED = 1
    """Share of the pixels about a cell that show the kits, 0 to 1."""
    MEASURED = 2
    """The image as it was measured."""
    IS_MEASURED = 3
    CAVITY = 4
    """The cavity that the part would cut at the fit."""
    WIDER = 5
    """The same of a part that is taken as solid where that is less likely."""
    SLIMMER = 6
    """The same of a part that is taken as solid only where that is likelier."""
    HEIGHTS = 7
    """[m] heights of the cavity, 0 on the face; the only one that is seen from above."""
