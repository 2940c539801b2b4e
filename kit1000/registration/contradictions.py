"""Contradictions: how far a pose of a part contradicts the image.

Free space may not be where the part must be, and the part may not be inside kit material. Both read certain bounds
alone, in metres, so that what the image hides of part or kit favours no pose:

- A cavity shrunk by the clearance is what the part must fill. The image may show some of it to be free in the part.
- The observed surface of the part must not lie in observed material of the kit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter

from kit1000.numerics.compiled import compiled
from kit1000.pose import Pose
from kit1000.registration.geometry.cavity import BELOW, CUT, VOXEL, Cavity, cells_at
from kit1000.registration.geometry.height_maps import disc, read_value
from kit1000.registration.part_volume import PartShape
from kit1000.voxels import Volume
from kit1000.voxels.grid import DEFAULT_TRUNCATION

TOLERANCE = 1e-3  # [m] error of voxels and of the coarse search: less contradicts nothing
MOST = 4e-3  # [m] largest contradiction of a point: distances are truncated at 5 mm
INSIDE = 0.7e-3  # [m] above the shrunk cavity's floor: within the part, whose surface is known to half a voxel
HEIGHTS = 5  # heights of the floor that are tried, between the lowest and the highest of a cell
PART_WEIGHT = 2.0  # of part inside kit beside free space inside part


@dataclass(frozen=True, eq=False)
class KitHeights:
    """The lowest and the highest surface that a kit can have, and the cells that its part must fill."""

    low: np.ndarray
    """(n, n) [m] plate frame: material is certain below."""
    must_fill: np.ndarray
    """(k, 3) [m] plate frame: at the lowest height of the part's lower face in each cell that it fills."""
    span: np.ndarray
    """(k,) [m] from there to the highest."""

    @classmethod
    def of(cls, cavity: Cavity, clearance: float) -> KitHeights:
        """The heights of a cavity; an unknown floor lies between the cavity's depth and what is seen to be free."""
        known = ~np.isnan(cavity.certain_heights)
        bottom = np.where(cavity.region, -cavity.depth, -BELOW)
        low = np.where(known, cavity.certain_heights, np.minimum(bottom, cavity.certain_free))
        high = np.where(known, cavity.certain_heights, cavity.certain_free)
        shrunk_low, shrunk_high = (
            np.asarray(maximum_filter(image, footprint=disc(VOXEL, clearance), mode="nearest")) for image in (low, high)
        )
        i, j = np.nonzero(cavity.region & (shrunk_high < -CUT))
        flat = (np.stack([i, j], axis=-1) - (len(low) - 1) / 2) * VOXEL
        points = np.column_stack([flat, shrunk_low[i, j]])
        return cls(low, points, (shrunk_high - shrunk_low)[i, j])


@dataclass(frozen=True)
class Contradictions:
    """Mean contradiction of a pose by the image [m]."""

    free_in_part: float
    """Free space where the part must be; the mean over the points of the shrunk cavity."""
    part_in_kit: float
    """Depth of the part's observed points in material of the kit; the mean over these points."""

    @property
    def cost(self) -> float:
        """[m] both, weighted."""
        return self.free_in_part + PART_WEIGHT * self.part_in_kit


def contradictions(part: PartShape, kit: KitHeights, plate_from_now: Pose) -> Contradictions:
    """The contradictions of a pose of a part in a kit."""
    return Contradictions(
        _free_in_part(part.bounds.possible, kit, plate_from_now), _part_in_kit(part.points, kit.low, plate_from_now)
    )


def _free_in_part(possible: Volume, kit: KitHeights, plate_from_now: Pose) -> float:
    if len(kit.must_fill) == 0:
        return 0.0
    grid_from_plate = possible.grid.world_from_grid.inverse() @ plate_from_now.inverse()
    linear = grid_from_plate.rotation_matrix() / possible.grid.voxel_size
    truncation = DEFAULT_TRUNCATION * possible.grid.voxel_size
    free = np.empty(len(kit.must_fill))
    origin = grid_from_plate.xyz / possible.grid.voxel_size
    _least_free(possible.values, linear, origin, kit.must_fill, kit.span, truncation, free)
    return float(np.clip(free - TOLERANCE, 0, MOST).mean())


def _part_in_kit(seen: np.ndarray, low: np.ndarray, plate_from_now: Pose) -> float:
    if len(seen) == 0:
        return 0.0
    points = plate_from_now.apply(seen)
    i, j = cells_at(points, len(low))
    inside = np.abs(points[:, :2]).max(-1) <= (len(low) - 1) / 2 * VOXEL
    return float(np.where(inside, np.clip(low[i, j] - points[:, 2] - TOLERANCE, 0, MOST), 0.0).mean())


@compiled
def _least_free(values, linear, origin, points, span, truncation, free):
    """Fill `free` (k,) [m]: the least distance from all that is possible, over the heights that a cell may have."""
    for p in range(len(points)):
        free[p] = np.inf
        for s in range(HEIGHTS):
            x, y = points[p, 0], points[p, 1]
            z = points[p, 2] + span[p] * s / (HEIGHTS - 1) + INSIDE
            value = read_value(
                values,
                linear[0, 0] * x + linear[0, 1] * y + linear[0, 2] * z + origin[0],
                linear[1, 0] * x + linear[1, 1] * y + linear[1, 2] * z + origin[1],
                linear[2, 0] * x + linear[2, 1] * y + linear[2, 2] * z + origin[2],
            )
            free[p] = min(free[p], value * truncation)
