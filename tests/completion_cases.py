"""A completer that knows the part, for tests of what is made of its answer."""

from __future__ import annotations

import numpy as np

from baselines.completion.completed import FillLogits, PartCompleter
from baselines.completion.frame import FramedPart
from baselines.completion.occupancy import filled_share
from kit1000.mesh import Mesh
from kit1000.pose import Pose


class Oracle(PartCompleter):
    """Knows the part that stands at the origin."""

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh

    def __call__(self, part: FramedPart) -> FillLogits:
        """The true share of each cell, as a logit."""
        share = filled_share(self.mesh, Pose.identity(), part.grid)
        return FillLogits(part.grid, (20 * (share - 0.5)).astype(np.float32))
