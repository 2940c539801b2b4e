"""The goals of a slot: every pose of the part whose shadow S(z) equals that of the design pose at all heights below the
rim. (The shadow is the projection along the insertion axis of all of the part below a height, see `shadows`.)

Declared symmetries are goals by construction. A numeric search adds goals that follow from the seated part alone: yaws
that leave the shadow unchanged, other faces down with the same shadow, and a free axis if every shadow is round.
Two shadows are equal when neither exceeds the other grown by SHADOW_TOLERANCE. Kit frame; all lengths are metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from manifold3d import CrossSection, JoinType, Manifold

from kit1000.kits.face import RestingFace, resting_faces
from kit1000.kits.height_fields import polar_relief
from kit1000.kits.seating import SEATED_LIMIT, rotation_limit
from kit1000.kits.shadows import AREA_TOLERANCE, PartShadows, Shadow, shadow_below
from kit1000.mesh import Mesh, solid_from_mesh
from kit1000.numerics.linear_algebra import length, matmul
from kit1000.numerics.trigonometry import cosine
from kit1000.pose import Pose, quaternion_angle
from kit1000.symmetry import Symmetry
from kit1000.values import FreeAxis, Slot

SHADOW_TOLERANCE = 0.05e-3  # [m] shadows whose outlines differ by less are equal
AREA_SLACK = 1e-3  # share by which areas of equal grown shadows may differ: arcs are polygons, and yaws turn them
ROTATION_ORDERS = tuple(range(36, 1, -1))  # n of the yaws of 360 degrees / n that are tested
MAX_RELIEF_DIFFERENCE = 0.15  # share by which the reliefs of a candidate may differ on the coarse grid
ALIGN_RANGE = np.radians(4.5)  # [rad] of the fine search for a yaw; the coarse grid has steps of 3 degrees
NEAR_GOAL_ANGLE = np.radians(1)  # up to which a pose counts as a goal
NEAR_GOAL_SHIFT = 5e-3  # [m] a pose nearer to a goal than this and than `rotation_limit` is no other pose
SHIFT_PER_CLEARANCE = 2.0  # the same shift for each metre of clearance
COMPARED = 8  # shadows of a design, spread over its depth
SAME_GOAL_ANGLE, SAME_GOAL_SHIFT = np.radians(1.0), 0.2e-3  # goals closer than both are one goal


@dataclass(frozen=True, eq=False)
class Design:
    """The input of the search: the part, its design pose and its shadows there."""

    mesh: Mesh
    symmetry: Symmetry
    kit_from_part: Pose
    shadows: PartShadows
    known_faces: Sequence[RestingFace] | None = None  # all resting faces of the part, if the caller has them

    @cached_property
    def faces(self) -> Sequence[RestingFace]:
        """All resting faces of the part, however improbable."""
        return self.known_faces or resting_faces(self.mesh, min_probability=0.0)

    @cached_property
    def relief(self) -> tuple[np.ndarray, np.ndarray]:
        """Relief of the part in its design pose and area weights of its rings, see `polar_relief`."""
        relief, _, weights = polar_relief(self.mesh.moved(self.kit_from_part), self.shadows.depth)
        return relief, weights

    @cached_property
    def solid(self) -> Manifold:
        """The part as an exact solid, in its own frame."""
        return solid_from_mesh(self.mesh)

    @cached_property
    def centre(self) -> np.ndarray:
        """(2,) [m] centroid of the rim shadow."""
        return area_centroid(self.shadows.rim)

    @cached_property
    def rim_areas(self) -> tuple[float, float]:
        """[m^2] of the rim shadow, and of the same grown by SHADOW_TOLERANCE."""
        return self.shadows.rim.area(), _grown(self.shadows.rim).area()

    def standing(self, kit_from_part: Pose) -> Manifold:
        """The solid of the part in a pose, shifted so that the cavity's floor is at z = 0."""
        return self.solid.transform(kit_from_part.matrix()[:3]).translate((0, 0, self.shadows.depth))


def find_goals(design: Design) -> tuple[Pose, FreeAxis | None]:
    """All goals of a design, the design pose first, and the free axis if there is one."""
    axis = _free_axis(design)
    order = 1 if axis is not None and abs(axis.direction[2]) > 0.5 else _rotation_order(design)
    turned = design.kit_from_part @ Pose(design.symmetry.rotations, np.zeros(3))
    declared = list(Pose(turned.wxyz, design.kit_from_part.xyz))
    flips = _flipped_poses(design, known=declared)
    candidates, goals = _rotated_copies(design, Pose.stack([*declared, *flips]), order), []
    while len(candidates):
        goals.append(candidates[0])
        candidates = candidates[~_are_near(candidates, goals[-1], axis, SAME_GOAL_ANGLE, SAME_GOAL_SHIFT)]
    return Pose.stack(goals), axis


def has_design_shadow(design: PartShadows, standing: Manifold) -> bool:
    """Whether a solid on the cavity's floor, z = 0, has the shadows of the design pose, at every height."""
    for z, section in _compared(design):
        other = shadow_below(standing, z)
        if not (_within_tolerance(section, other) and _within_tolerance(other, section)):
            return False
    return True


def _compared(part: PartShadows) -> list[Shadow]:
    """The shadows to compare, at most COMPARED, the rim's first: it differs most often."""
    picks = np.unique(np.linspace(0, len(part.shadows) - 1, COMPARED).round().astype(int))
    return [part.shadows[i] for i in picks[::-1]]


def _has_rotated_shadow(design: Design, angle: float) -> bool:
    """`has_design_shadow` of the design pose rotated by an angle [rad] about the vertical through the centre.

    Its shadows are the rotated ones of the design, so that none is computed anew.
    """
    for _, section in _compared(design.shadows):
        other = _rotated(section, design.centre, angle)
        if not (_within_tolerance(section, other) and _within_tolerance(other, section)):
            return False
    return True


def _rotated(shadow: CrossSection, centre: np.ndarray, angle: float) -> CrossSection:
    return shadow.translate(-centre).rotate(np.degrees(angle)).translate(centre)


def _within_tolerance(inner: CrossSection, outer: CrossSection) -> bool:
    return (inner - _grown(outer)).area() < AREA_TOLERANCE


def _grown(shadow: CrossSection) -> CrossSection:
    return shadow.offset(SHADOW_TOLERANCE, JoinType.Round, circular_segments=16)


def area_centroid(shadow: CrossSection) -> np.ndarray:
    """(2,) [m] centroid of a shadow."""
    moment, area = np.zeros(2), 0.0
    for loop in shadow.to_polygons():
        a, b = loop, np.roll(loop, -1, axis=0)
        cross = a[:, 0] * b[:, 1] - b[:, 0] * a[:, 1]
        moment += ((a + b) * cross[:, None]).sum(0) / 6
        area += cross.sum() / 2
    return moment / area


def _free_axis(design: Design) -> FreeAxis | None:
    """The declared free axis, else a vertical one if every contour of every shadow is a circle about one centre."""
    if design.symmetry.axis is not None:
        direction = design.kit_from_part.rotate(design.symmetry.axis)
        return FreeAxis(design.kit_from_part.xyz, direction / length(direction))
    centre = design.centre
    for _, section in design.shadows.shadows:
        for loop in section.to_polygons():
            if not _is_circle(loop, centre):
                return None
    return FreeAxis(np.array([*centre, 0.0]), np.array([0.0, 0.0, 1.0]))


def _is_circle(loop: np.ndarray, centre: np.ndarray) -> bool:
    a, b = loop - centre, np.roll(loop, -1, axis=0) - centre
    along = b - a
    share = np.clip(-np.einsum("ij,ij->i", a, along) / np.einsum("ij,ij->i", along, along), 0, 1)
    nearest = np.linalg.norm(a + share[:, None] * along, axis=1).min()
    return bool(np.linalg.norm(a, axis=1).max() - nearest <= SHADOW_TOLERANCE)


def _rotation_order(design: Design) -> int:
    """The largest n such that a rotation by 360/n degrees about the shadow's centroid leaves every shadow unchanged."""
    relief, weights = design.relief
    for order in ROTATION_ORDERS:
        if _relief_difference(relief, _shifted(relief, relief.shape[1] / order), weights) > MAX_RELIEF_DIFFERENCE:
            continue
        if _has_rotated_shadow(design, 2 * np.pi / order):
            return order
    return 1


def _shifted(relief: np.ndarray, columns: float) -> np.ndarray:
    """The relief rotated by a number of columns, not necessarily whole (linear interpolation)."""
    whole, part = int(np.floor(columns)), columns % 1
    return (1 - part) * np.roll(relief, whole, 1) + part * np.roll(relief, whole + 1, 1)


def _relief_difference(a: np.ndarray, b: np.ndarray, weights: np.ndarray) -> float:
    return float(matmul(weights, np.abs(a - b).sum(1)) / (matmul(weights, (a + b).sum(1)) / 2))


def _rotated_copies(design: Design, poses: Pose, order: int) -> Pose:
    """Each pose of a batch rotated by multiples of 360/order degrees about the vertical through the rim's centroid."""
    centre = np.array([*design.centre, 0.0])
    turns = np.array([[0, 0, 2 * np.pi * k / order] for k in range(1, order)]).reshape(-1, 3)
    about = Pose.from_translation(centre) @ Pose.from_rotvec(turns) @ Pose.from_translation(-centre)
    turned = about @ poses[:, None]
    wxyz = np.concatenate([poses.wxyz[:, None], turned.wxyz], axis=1)
    xyz = np.concatenate([poses.xyz[:, None], turned.xyz], axis=1)
    return Pose(wxyz.reshape(-1, 4), xyz.reshape(-1, 3))


def _flipped_poses(design: Design, known: list[Pose]) -> list[Pose]:
    """Poses with another face down and the same shadow; one a face, its other yaws follow from the rotation order."""
    relief, weights = design.relief
    found = []
    for face in design.faces:
        is_down = any(pose.rotate(face.normal)[2] < -cosine(SAME_GOAL_ANGLE) for pose in known)
        if is_down or face.height < design.shadows.depth:
            continue
        other, _, _ = polar_relief(design.mesh.moved(face.plane_from_part), design.shadows.depth)
        yaw, difference = best_yaw(relief, other, weights)
        if difference > MAX_RELIEF_DIFFERENCE:
            continue
        if not _has_rim_area(design, face.plane_from_part):
            continue
        pose = _aligned(design, face.plane_from_part, yaw)
        if has_design_shadow(design.shadows, design.standing(pose)):
            found.append(pose)
    return found


def _has_rim_area(design: Design, plane_from_part: Pose) -> bool:
    """Whether the rim shadow of a resting part has about the area of the design's: equal shadows do, at any yaw."""
    low = plane_from_part.apply(design.mesh.vertices)[:, 2].min()
    seated = Pose.from_translation(np.array([0, 0, -design.shadows.depth - low])) @ plane_from_part
    shadow = shadow_below(design.standing(seated), design.shadows.depth)
    area, grown = design.rim_areas
    most = (1 + AREA_SLACK) * grown + AREA_TOLERANCE
    return shadow.area() < most and area < (1 + AREA_SLACK) * _grown(shadow).area() + AREA_TOLERANCE


def best_yaw(relief: np.ndarray, other: np.ndarray, weights: np.ndarray) -> tuple[float, float]:
    """The yaw [rad] of `other` that matches `relief` best, and the share by which they still differ."""
    spectra = np.fft.rfft(relief, axis=1) * np.conj(np.fft.rfft(other, axis=1))
    correlation = matmul(weights, np.fft.irfft(spectra, n=relief.shape[1], axis=1))
    shift = int(correlation.argmax())
    return shift * 2 * np.pi / relief.shape[1], _relief_difference(relief, np.roll(other, shift, 1), weights)


def _aligned(design: Design, plane_from_part: Pose, yaw: float) -> Pose:
    """The part at rest on the cavity's floor, centred, at the nearby yaw with the largest overlap of rim shadows."""
    rim = design.shadows.rim
    centre = design.centre
    from scipy.optimize import minimize_scalar  # only here: few parts need it, and importing it takes long

    def placed(angle: float) -> Pose:
        rotated = Pose.from_rotvec(np.array([0, 0, angle])) @ plane_from_part
        low = rotated.apply(design.mesh.vertices)[:, 2].min()
        seated = Pose.from_translation(np.array([0, 0, -design.shadows.depth - low])) @ rotated
        offset = centre - area_centroid(shadow_below(design.standing(seated), design.shadows.depth))
        return Pose.from_translation(np.array([*offset, 0.0])) @ seated

    shadow = shadow_below(design.standing(placed(yaw)), design.shadows.depth)

    def overlap(extra: float) -> float:
        return (_rotated(shadow, centre, extra) ^ rim).area()

    best = minimize_scalar(
        lambda extra: -overlap(extra), bounds=(-ALIGN_RANGE, ALIGN_RANGE), method="bounded", options={"xatol": 1e-7}
    )
    return placed(yaw + best.x)


def nearest_about_axis(pose: Pose, goal: Pose, axis: FreeAxis) -> Pose:
    """Goals rotated about the free axis to the orientation nearest to that of the pose; either may be a batch.

    By the twist decomposition of the rotation between them.
    """
    wxyz = (pose @ goal.inverse()).wxyz
    angle = 2 * np.arctan2(matmul(wxyz[..., 1:], axis.direction), wxyz[..., 0])
    about = Pose.from_translation(axis.point) @ Pose.from_rotvec(angle[..., None] * axis.direction)
    return about @ Pose.from_translation(-axis.point) @ goal


def is_goal(pose: Pose, slot: Slot, max_angle: float | None = None) -> bool:
    """Whether a pose is a goal up to the free axis, within 1 mm and NEAR_GOAL_ANGLE (or a larger `max_angle` [rad])."""
    return _is_near_some_goal(pose, slot, max(NEAR_GOAL_ANGLE, max_angle or 0.0), SEATED_LIMIT / 3)


def near_goal_limits(clearance: float) -> tuple[float, float]:
    """The angle [rad] and the shift [m] up to which a pose is near a goal: 10 degrees and 5 mm, more in wide slots.

    clearance: of the slot [m].
    """
    return rotation_limit(clearance), max(NEAR_GOAL_SHIFT, SHIFT_PER_CLEARANCE * clearance)


def is_near_goal(pose: Pose, slot: Slot, margin: float = 0.0) -> bool:
    """Whether a pose is within both limits of a goal, up to the free axis; the limit of shift grows by a margin [m]."""
    most_angle, most_shift = near_goal_limits(slot.clearance)
    return _is_near_some_goal(pose, slot, most_angle, most_shift + margin)


def _is_near_some_goal(pose: Pose, slot: Slot, most_angle: float, most_shift: float) -> bool:
    return bool(_are_near(pose, slot.goals, slot.free_axis, most_angle, most_shift).any())


def _are_near(poses: Pose, goals: Pose, axis: FreeAxis | None, most_angle: float, most_shift: float) -> np.ndarray:
    """(n,) bool: whether poses are within both limits of goals, up to a free axis; either may be a batch of n."""
    nearest = goals if axis is None else nearest_about_axis(poses, goals, axis)
    is_turned_little = quaternion_angle(poses.wxyz, nearest.wxyz) < most_angle
    return is_turned_little & (np.linalg.norm(nearest.xyz - poses.xyz, axis=-1) < most_shift)
