"""The kit of a part: choose the insertion face, cut the cavity, find the goals, build the plate, measure its clearance.

Kit frame: centre of the plate's top face, +z out of the cavity. All lengths are metres unless a name says mm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from manifold3d import CrossSection, Manifold

from kit1000.errors import Redraw
from kit1000.kits.cavity import MIN_SEATED_HEIGHT, MIN_WALL, SAGITTA, Cavity, cut_cavity, insertion_depth
from kit1000.kits.clearance import HEIGHT_COUNT, Clearance, measure_clearance
from kit1000.kits.face import RestingFace, distinct_faces, rank_faces, resting_faces
from kit1000.kits.goals import Design, find_goals
from kit1000.kits.patches import EXACT, MERGED, MERGED_FILE, Detail
from kit1000.kits.printable_mesh import printable_mesh
from kit1000.kits.shadows import PartShadows
from kit1000.mesh import Mesh, solid_from_mesh
from kit1000.numerics.linear_algebra import matmul
from kit1000.numerics.trigonometry import cosine, sine
from kit1000.parts.family import FILE
from kit1000.pose import Pose
from kit1000.values import Kit, Part, Slot

CLEARANCE = 2.5e-3  # [m] the paper's simulation margin
PLATE_PITCH = 0.1  # [m] between neighbouring plates of an assembly
PLATE_GAP = 1e-3  # [m] between neighbouring plates
PLATE_WIDTH = PLATE_PITCH - PLATE_GAP
MIN_FLOOR = 2e-3  # [m] least material under a cavity
MAX_EXCESS_CLEARANCE = 0.1e-3  # [m] of a kept wall above the nominal clearance
PROBABILITY_DECIMALS = 9  # the last bits of an arctangent differ between processors
FILE_HEIGHT_COUNT = 9  # heights at which the clearance of a merged cavity of a file is measured
MIN_RIM = 8e-3  # [m] least wall around the cavity of a plate fitted to its part


@dataclass(frozen=True)
class Plate:
    """The plate that a cavity is cut into."""

    width: tuple[float, float]
    """[m] along x and y."""
    thickness: float
    """[m]"""


UNIT_PLATE = Plate((PLATE_WIDTH, PLATE_WIDTH), 22e-3)  # a cavity of at most 20 mm and MIN_FLOOR below it


@dataclass(frozen=True, eq=False)
class KitDesign:
    """A kit with its cavity, its insertion face and its measured clearance."""

    kit: Kit
    cavity: Cavity
    face: RestingFace
    measured_clearance: Clearance

    @property
    def clearance_in_bounds(self) -> bool:
        """Whether the clearance is nominal everywhere: SAGITTA less at least, MAX_EXCESS_CLEARANCE more at most."""
        nominal, measured = self.kit.slot.clearance, self.measured_clearance
        return nominal - SAGITTA <= measured.smallest and measured.largest <= nominal + MAX_EXCESS_CLEARANCE

    @property
    def report(self) -> dict[str, float | int | bool]:
        """The properties of the kit for tables and reports, lengths in mm."""
        slot = self.kit.slot
        return {
            "clearance_asked_mm": slot.clearance * 1e3,
            "clearance_smallest_mm": self.measured_clearance.smallest * 1e3,
            "clearance_largest_mm": self.measured_clearance.largest * 1e3,
            "depth_mm": slot.depth * 1e3,
            "proud_mm": (self.face.height - slot.depth) * 1e3,
            "walls_removed": self.cavity.removed_wall_count,
            "walls_removed_mm3": self.cavity.removed_wall_volume * 1e9,
            "undercut_lost_mm3": self.cavity.undercut_volume * 1e9,
            "goals": len(slot.goals),
            "free_axis": slot.free_axis is not None,
            "face_probability": round(self.face.probability, PROBABILITY_DECIMALS),
            "kit_faces": len(self.kit.mesh.faces),
        }


def make_kit(part: Part, clearance: float = CLEARANCE, plate: Plate | None = UNIT_PLATE) -> Kit:
    """The kit of a part on the first of its insertion faces, without trials; see `design_kit`."""
    return design_kit(part, clearance, plate).kit


def design_kit(
    part: Part,
    clearance: float = CLEARANCE,
    plate: Plate | None = UNIT_PLATE,
    face: RestingFace | None = None,
    known_faces: Sequence[RestingFace] | None = None,
) -> KitDesign:
    """The kit of a part with a clearance [m], in a given plate or, with None, in one fitted to the part.

    Args:
        part: the part.
        clearance: of the cavity [m].
        plate: the plate.
        face: the insertion face; the first of `insertion_faces` when None.
        known_faces: all resting faces of the part, if the caller has them.

    Raises:
        Redraw: the part has no insertion face or does not fit the plate; the reason is short.
    """
    face = face or insertion_faces(part, clearance, plate is None)[0]
    depth = insertion_depth(face.height)
    standing = _aligned_with_plate(part.mesh, face, depth)  # plane_from_part
    shadows = PartShadows.of(solid_from_mesh(part.mesh).transform(standing.matrix()[:3]), depth)
    kit_from_part = Pose.from_translation(np.array([0, 0, -depth])) @ standing
    goals, free_axis = find_goals(Design(part.mesh, part.symmetry, kit_from_part, shadows, known_faces))
    slot = Slot(part.id, kit_from_part, clearance, depth, goals, free_axis)
    plate = plate or _fitted_plate(part.mesh.moved(kit_from_part), clearance, depth)
    detail = MERGED_FILE if part.family == FILE else MERGED
    cavity, mesh, measured = _cut_plate(shadows, clearance, plate, detail)
    return KitDesign(Kit(part.id, mesh, slot, np.array([*plate.width, plate.thickness])), cavity, face, measured)


def insertion_faces(part: Part, clearance: float = CLEARANCE, fitted_plate: bool = False) -> list[RestingFace]:
    """The stable faces that a part can be inserted on, the first to be tried first; of congruent ones the first alone.

    For a fitted plate any seated height is enough. Raises Redraw with a short reason when there is no such face.
    """
    faces = resting_faces(part.mesh)
    if not faces:
        raise Redraw("no stable resting face")
    tall = faces if fitted_plate else [face for face in faces if face.height >= MIN_SEATED_HEIGHT]
    if not tall:
        raise Redraw(f"no stable face with {MIN_SEATED_HEIGHT * 1e3:g} mm of seated height")
    tall = distinct_faces(part.mesh, tall)
    depths = [insertion_depth(face.height) for face in tall]
    return [tall[i] for i in rank_faces(part.mesh, tall, depths, clearance, part.symmetry)]


def _cut_plate(part: PartShadows, clearance: float, plate: Plate, detail: Detail) -> tuple[Cavity, Mesh, Clearance]:
    """The cavity, the plate and its clearance, in a detail if that keeps the bounds, else the exact ones."""
    made = _cut_in_detail(part, clearance, plate, detail)
    measured = made[-1]
    is_wide_enough = detail is not MERGED_FILE or measured.smallest >= clearance - SAGITTA
    if is_wide_enough and measured.largest <= clearance + MAX_EXCESS_CLEARANCE:
        return made
    return _cut_in_detail(part, clearance, plate, EXACT)


def _cut_in_detail(part: PartShadows, clearance: float, plate: Plate, detail: Detail) -> tuple[Cavity, Mesh, Clearance]:
    cavity = cut_cavity(part, clearance, plate.width, detail)
    if not _fits_plate(cavity, plate):
        raise Redraw("wider than the plate")
    mesh = plate_mesh(cavity, plate)
    return cavity, mesh, measure_clearance(mesh, cavity, FILE_HEIGHT_COUNT if detail is MERGED_FILE else HEIGHT_COUNT)


def _aligned_with_plate(mesh: Mesh, face: RestingFace, depth: float) -> Pose:
    """plane_from_part: the part on its face, lowest point at z = 0, the minimum rectangle around its shadow centred and
    parallel to the plate."""
    points = mesh.moved(face.plane_from_part).vertices
    outline = _rim_outline(points, depth)
    edges = np.roll(outline, -1, axis=0) - outline
    angles = np.unique(np.round(np.arctan2(edges[:, 1], edges[:, 0]) % (np.pi / 2), 9))
    sizes = [np.prod(np.ptp(_rotated(outline, -angle), axis=0)) for angle in angles]
    yaw = -angles[int(np.argmin(np.round(sizes, 12)))]
    if np.diff(np.ptp(_rotated(outline, yaw), axis=0))[0] > 1e-9:
        yaw += np.pi / 2  # long side along x
    aligned = _rotated(outline, yaw)
    centre = (aligned.min(0) + aligned.max(0)) / 2
    rotated = Pose.from_rotvec(np.array([0, 0, yaw])) @ face.plane_from_part
    return Pose.from_translation(np.array([-centre[0], -centre[1], -points[:, 2].min()])) @ rotated


def _rim_outline(points: np.ndarray, depth: float) -> np.ndarray:
    """(n, 2) [m] convex hull, seen from above, of the vertices below the rim."""
    low = points[points[:, 2] <= points[:, 2].min() + depth]
    hull = CrossSection.hull_points(low[:, :2] if len(low) > 2 else points[:, :2])
    return hull.to_polygons()[0]


def _rotated(points: np.ndarray, angle: float) -> np.ndarray:
    c, s = cosine(angle), sine(angle)
    return matmul(points, np.array([[c, s], [-s, c]]))


def _fitted_plate(standing: Mesh, clearance: float, depth: float) -> Plate:
    reach = np.abs(standing.bounds[:, :2]).max(0) + clearance + MIN_RIM
    width = np.ceil(2 * reach * 1e3) / 1e3
    return Plate((float(width[0]), float(width[1])), depth + MIN_FLOOR)


def _fits_plate(cavity: Cavity, plate: Plate) -> bool:
    low_x, low_y, _, high_x, high_y, _ = cavity.solid.bounding_box()
    reach = np.maximum([-low_x, -low_y], [high_x, high_y])
    return bool((reach <= np.array(plate.width) / 2 - MIN_WALL).all())


def plate_mesh(cavity: Cavity, plate: Plate) -> Mesh:
    """The plate with its cavity as a closed mesh on the float32 grid."""
    block = Manifold.cube((*plate.width, plate.thickness), center=True).translate((0, 0, -plate.thickness / 2))
    solid = block - cavity.solid.translate((0, 0, -cavity.depth))
    return printable_mesh(solid, "plate")
