"""How a part would meet the kits where the hand holds it, as far as the image shows.

A part is taken as a solid column below its observed surface, a kit as its observed surface. In a grid along a plate,
contact is where the kit rises highest above the part's underside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.editor.plates import Plate
from kit1000.editor.seen import observed
from kit1000.kits.contact import convex_edges
from kit1000.kits.seating import InsertedPart, contact_offset
from kit1000.mesh import Mesh
from kit1000.pose import Pose, quaternion_between

CELL = 1.5e-3  # [m] of the grid
SIDE = 128  # cells: 192 mm, the widest plate with a part beside it
SKIRT_STEP = 1.5e-3  # [m] between points on a part's sides
QUANTILE = 0.95  # of the cells in contact: fewer are the smear of an edge
LEAST_CELLS = 12
TOUCHES = 1e-3  # [m] of contact, below which a part stands
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Contact:
    """How a part meets what is seen of the kits."""

    overlap: float
    """[m] that the part would have to rise along the plate's normal; below 0 it hovers; NaN where nothing is seen."""
    unseen: float
    """Share of the part's underside below which nothing of the kits is seen."""

    def text(self) -> str:
        """For the page."""
        if not np.isfinite(self.overlap):
            return "nothing of the kits is seen below it"
        if self.overlap > TOUCHES:
            return f"{self.overlap * 1e3:.0f} mm into the kit, as seen"
        return f"{-self.overlap * 1e3:.0f} mm above the kit" if self.overlap < -TOUCHES else "stands on the kit"


@dataclass
class Contacts:
    """Measures contact with the seen kits; their height images are kept, one a plate."""

    kits: Mesh

    def __post_init__(self) -> None:
        self._heights: dict[int, tuple[Pose, np.ndarray]] = {}

    def of(self, points: np.ndarray, motion: Pose, plate: Plate) -> Contact:
        """Contact of a part. points: (n, 3) [m] all over it where it lies, see `solid_points`."""
        plate_from_world, kit = self._height_image(plate)
        underside = _binned(plate_from_world.apply(motion.apply(points)), np.minimum, np.inf)
        below = np.isfinite(underside)
        seen = below & np.isfinite(kit)
        if seen.sum() < LEAST_CELLS:
            return Contact(float("nan"), 1.0)
        rise = np.quantile(kit[seen] - underside[seen], QUANTILE)
        return Contact(float(rise), float(1 - seen.sum() / below.sum()))

    def _height_image(self, plate: Plate) -> tuple[Pose, np.ndarray]:
        """plate_from_world, z along the normal, and (SIDE, SIDE) [m] the highest seen point over each cell."""
        if id(plate) not in self._heights:
            world_from_plate = Pose(quaternion_between(UP, plate.normal), plate.point)
            plate_from_world = world_from_plate.inverse()
            self._heights[id(plate)] = (
                plate_from_world,
                _binned(plate_from_world.apply(_refined(self.kits)), np.maximum, -np.inf),
            )
        return self._heights[id(plate)]


@dataclass
class TrueContacts:
    """Measures contact of true shapes, in closed form."""

    kits: Mesh

    def __post_init__(self) -> None:
        self._fixed = convex_edges(self.kits)

    def of(self, part: Mesh, motion: Pose, plate: Plate) -> Contact:
        """Contact of a part, a mesh [m] where it lies."""
        axis = motion.inverse().rotate(plate.normal)
        offset = contact_offset(InsertedPart(convex_edges(part), axis), self._fixed, motion)
        return Contact(float(offset) if np.isfinite(offset) else float("nan"), 0.0)


def solid_points(part: Mesh, floor: float = 0.0) -> np.ndarray:
    """(n, 3) [m] points all over a seen part: the vertices of its surface, shadow and skirt.

    part: as `seen.with_skirt` makes it, down to the floor [m].
    """
    top = observed(part)
    steps = np.arange(floor, float(top[:, 2].max(initial=floor)), SKIRT_STEP)
    columns = np.repeat(top[:, None], len(steps), axis=1)
    columns[..., 2] = np.minimum(steps, columns[..., 2])
    return np.concatenate([part.vertices, columns.reshape(-1, 3)]) if len(steps) else part.vertices


def _refined(mesh: Mesh) -> np.ndarray:
    """(n, 3) [m] vertices and the middles of the faces."""
    return np.concatenate([mesh.vertices, mesh.triangles.mean(1)])


def _binned(points: np.ndarray, chosen: np.ufunc, empty: float) -> np.ndarray:
    """(SIDE, SIDE) [m] the least or greatest height of points (n, 3) over each cell of a grid about the origin."""
    cells = np.floor(points[:, :2] / CELL).astype(int) + SIDE // 2
    inside = ((cells >= 0) & (cells < SIDE)).all(1)
    heights = np.full((SIDE, SIDE), empty)
    chosen.at(heights, tuple(cells[inside].T), points[inside, 2])
    return heights
