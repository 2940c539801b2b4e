"""How a part in the hand lies on a plate: over a cavity or beside one, as far as the image shows.

A plate is seen from above, in a grid along it: its face, and inside the outline of that, its cavity. What is seen of
the part is laid over it. Of true shapes contact is computed in closed form.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_erosion
from scipy.spatial import ConvexHull, QhullError

from kit1000.editor.seen_plates import Plate
from kit1000.kits.seating import InsertedPart, contact_offset
from kit1000.mesh import Mesh
from kit1000.pose import Pose, quaternion_between

CELL = 1.5e-3  # [m] of the grid
SIDE = 128  # cells: 192 mm, the widest plate with a part beside it
EXACT, NOISY = 2e-3, 4e-3  # [m] of the points of a face from its plane, by whether the sensor has noise
TOUCHES = 1e-3  # [m] of contact, below which a part stands
ALL = 0.03  # share beside the cavity that is none: cells at its rim
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class PlateGrid:
    """A plate seen from above."""

    plate_from_world: Pose
    """z along the normal, the origin in the middle."""
    cavity: np.ndarray
    """(SIDE, SIDE) bool: inside the outline of its face, and not its face."""


class Cavities:
    """Where the plates have cavities, as seen; their grids are kept."""

    def __init__(self, kits: Mesh, noisy: bool) -> None:
        """kits: [m] world, as seen. noisy: whether the sensor has noise."""
        self._points = np.concatenate([kits.vertices, kits.triangles.mean(1)])
        self._reach = NOISY if noisy else EXACT
        self._grids: dict[Plate, PlateGrid] = {}

    def share_beside(self, points: np.ndarray, motion: Pose, plate: Plate) -> float:
        """Share of a part that is not over a cavity of a plate, 0 to 1.

        Args:
            points: (n, 3) [m] what is seen of the part, at its recorded pose.
            motion: goal_from_now.
            plate: which one.
        """
        grid = self._grid(plate)
        under = np.zeros((SIDE, SIDE), bool)
        under[_cells(grid.plate_from_world.apply(motion.apply(points)))] = True
        return float(1 - (under & grid.cavity).sum() / max(under.sum(), 1))

    def text(self, points: np.ndarray, motion: Pose, plate: Plate) -> str:
        """The same for the page."""
        share = self.share_beside(points, motion, plate)
        if share < ALL:
            return "As seen, all of it is over a cavity."
        return f"As seen, {100 * share:.0f} % of it is not over a cavity."

    def _grid(self, plate: Plate) -> PlateGrid:
        if plate not in self._grids:
            world_from_plate = Pose(quaternion_between(UP, plate.normal), plate.point)
            plate_from_world = world_from_plate.inverse()
            points = plate_from_world.apply(self._points)
            near = np.square(points[:, :2]).sum(1) < plate.radius**2
            face = np.zeros((SIDE, SIDE), bool)
            face[_cells(points[near & (np.abs(points[:, 2]) < self._reach)])] = True
            inner = np.asarray(binary_erosion(face), bool)  # a cell at the rim of the cavity counts as cavity
            self._grids[plate] = PlateGrid(plate_from_world, _outlined(inner) & ~inner)
        return self._grids[plate]


class TrueContacts:
    """Measures contact of true shapes, in closed form."""

    def __init__(self, kits: Mesh, parts: Mapping[int, Mesh]) -> None:
        """kits: [m] world. parts: [m] at their recorded poses, by index."""
        self._fixed, self._parts = kits, parts

    def text(self, part: int, motion: Pose, plate: Plate) -> str:
        """How a part meets the kits after a motion, as a text for the page."""
        axis = motion.inverse().rotate(plate.normal)
        offset = float(contact_offset(InsertedPart(self._parts[part], axis), self._fixed, motion))
        if not np.isfinite(offset):
            return "By the shapes nothing of the kits is below it."
        if offset > TOUCHES:
            return f"By the shapes it is {offset * 1e3:.0f} mm into the kit."
        if offset < -TOUCHES:
            return f"By the shapes it is {-offset * 1e3:.0f} mm above the kit."
        return "By the shapes it stands on the kit."


def _cells(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the cells of points (n, 3) [m]; of those in the grid."""
    cells = np.floor(points[:, :2] / CELL).astype(int) + SIDE // 2
    cells = cells[((cells >= 0) & (cells < SIDE)).all(1)]
    return cells[:, 0], cells[:, 1]


def _outlined(face: np.ndarray) -> np.ndarray:
    """(SIDE, SIDE) bool: the cells in the convex outline of some."""
    corners = np.argwhere(face)
    try:
        sides = ConvexHull(corners).equations
    except (QhullError, ValueError):  # fewer than three, or in a line
        return face
    grid = np.stack(np.meshgrid(np.arange(SIDE), np.arange(SIDE), indexing="ij"), axis=-1)
    distances = (grid[:, :, None] * sides[:, :2]).sum(-1) + sides[:, 2]
    return np.asarray((distances <= 1e-9).all(-1))
