"""What the relief of a plate is expected to be, hidden cells too, and how far a part's own relief differs from it."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_erosion, binary_fill_holes

from baselines.registration.cavity import VOXEL, Cavity
from baselines.registration.relief import grown, lower_envelope
from kit1000.pose import Pose
from kit1000.voxels import Volume

HIDDEN = 2e-3  # [m] a cell free so far down is of the cavity
HALF_KNOWN = 0.5  # trust in a floor that is deep but was not seen
ISLAND = 0.2  # trust in an island of a cavity that was not seen whole
STEP = 4e-3  # [m] a difference in height that counts in full


def expected(cavity: Cavity) -> tuple[np.ndarray, np.ndarray]:
    """(n, n) [m] and (n, n) 0..1: the relief of a plate from its face down, and how far it is to be trusted.

    Where nobody saw the floor but saw that it is deep, the floor is taken to be there, and half trusted. Around the
    cavity the plate is whole. An island in a cavity of which little was seen may be owed to a hollow that the part
    does not show.
    """
    unseen = np.isnan(cavity.relief) & cavity.region
    deep = cavity.free < -HIDDEN
    relief = np.where(unseen, np.where(deep, -cavity.depth, 0.0), cavity.relief)
    relief = np.where(cavity.region, np.minimum(relief, 0), 0)
    trust = np.where(unseen, np.where(deep, HALF_KNOWN, 0.0), 1.0)
    if unseen.any():
        trust[np.asarray(binary_fill_holes(cavity.region), bool) & ~cavity.region] = ISLAND
    return relief, trust


def outline_misfit(part: Volume, cavity: Cavity, plate_from_now: Pose, clearance: float) -> float:
    """[m] by how much, on average along its outline, the cavity is not the one that the part asks for.

    Each cell counts by the difference of the heights, in full from STEP on: the volume in dispute over the wall's face.
    """
    relief, trust = expected(cavity)
    envelope = lower_envelope(part, plate_from_now, VOXEL, len(relief))
    sunk = np.minimum(grown(envelope, VOXEL, clearance), 0)
    outline = cavity.region & ~np.asarray(binary_erosion(cavity.region), bool)
    differs = trust * np.minimum(np.abs(relief - sunk), STEP) / STEP
    return float(differs.sum() / outline.sum()) * VOXEL
