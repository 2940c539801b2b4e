"""The expected relief of a plate, hidden cells included, and how far a part's own relief differs from it."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_erosion, binary_fill_holes

from kit1000.pose import Pose
from kit1000.registration.geometry.height_images import dilated, lower_envelope
from kit1000.registration.geometry.observed_cavity import VOXEL, Cavity
from kit1000.voxels import Volume

HIDDEN = 2e-3  # [m] a cell that is free down to here belongs to the cavity
HIDDEN_FLOOR_TRUST = 0.5  # in a floor that is deep but hidden
ISLAND_TRUST = 0.2  # in an island of a cavity that is partly hidden
STEP = 4e-3  # [m] a difference in height that counts in full


def expected_relief(cavity: Cavity) -> tuple[np.ndarray, np.ndarray]:
    """(n, n) [m] and (n, n) 0..1: the relief of a plate from its face down, and the trust in each cell.

    Where the floor is hidden but known to be deep, it is set to the cavity's depth with half the trust. Around the
    cavity the plate is whole. An island in a partly hidden cavity may belong to a hollow that the part's image hides.
    """
    hidden = np.isnan(cavity.relief) & cavity.region
    deep = cavity.free < -HIDDEN
    relief = np.where(hidden, np.where(deep, -cavity.depth, 0.0), cavity.relief)
    relief = np.where(cavity.region, np.minimum(relief, 0), 0)
    trust = np.where(hidden, np.where(deep, HIDDEN_FLOOR_TRUST, 0.0), 1.0)
    if hidden.any():
        trust[np.asarray(binary_fill_holes(cavity.region), bool) & ~cavity.region] = ISLAND_TRUST
    return relief, trust


def outline_misfit(part: Volume, cavity: Cavity, plate_from_now: Pose, clearance: float) -> float:
    """[m] mean distance along the outline between the cavity and the one that the part would cut.

    Each cell counts by the difference in height, in full from STEP on; the sum is divided by the outline's cells.
    """
    relief, trust = expected_relief(cavity)
    envelope = lower_envelope(part, plate_from_now, VOXEL, len(relief))
    cut = np.minimum(dilated(envelope, VOXEL, clearance), 0)
    outline = cavity.region & ~np.asarray(binary_erosion(cavity.region), bool)
    differs = trust * np.minimum(np.abs(relief - cut), STEP) / STEP
    return float(differs.sum() / outline.sum()) * VOXEL
