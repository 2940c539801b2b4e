"""The goals of a slot: every pose of the part whose swept shadow below the rim equals that of the design pose.

Declared symmetries are goals by construction. A numeric search adds what only the seated part decides: turns that the
shadow cannot tell apart, other faces down that leave the same shadow, and a free axis where every shadow is round.
Two shadows are equal when neither leaves the other grown by SAME. Frame: kit frame; all lengths are metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from manifold3d import CrossSection, JoinType, Manifold
from scipy.optimize import minimize_scalar

from kit1000.kits.cavity import AREA_TOLERANCE, Cavity, Probe
from kit1000.kits.envelope import polar_relief
from kit1000.kits.face import resting_faces
from kit1000.kits.sweep import shadow_below
from kit1000.mesh import Mesh, solid_from_mesh
from kit1000.pose import Pose, quaternion_angle
from kit1000.symmetry import Symmetry
from kit1000.values import FreeAxis

SHADOW_TOLERANCE = 0.05e-3  # [m] shadows that differ by less are one shadow
ROTATION_ORDERS = tuple(range(36, 1, -1))  # turns tried about the insertion axis: 360 degrees / n
MAX_RELIEF_DIFFERENCE = 0.15  # share of relief that may differ, on the coarse grid, in a candidate worth an exact test
ALIGN_RANGE = np.radians(4.5)  # the coarse grid knows a turn to 3 degrees
SAME_GOAL_ANGLE, SAME_GOAL_SHIFT = np.radians(1.0), 0.2e-3  # goals closer than this are one goal


@dataclass(frozen=True, eq=False)
class Design:
    """What the search starts from: the part, its design pose, its cavity."""

    mesh: Mesh
    symmetry: Symmetry
    kit_from_part: Pose
    cavity: Cavity

    @cached_property
    def relief(self) -> tuple[np.ndarray, np.ndarray]:
        """The relief of the part in its design pose and the weights of its rings, as `polar_relief` has them."""
        relief, _, weights = polar_relief(self.mesh.moved(self.kit_from_part), self.cavity.depth)
        return relief, weights

    def standing(self, kit_from_part: Pose) -> Manifold:
        """The part in a pose, raised so that the cavity's floor is z = 0."""
        return solid_from_mesh(self.mesh).transform(kit_from_part.matrix()[:3]).translate((0, 0, self.cavity.depth))


def find_goals(design: Design) -> tuple[Pose, FreeAxis | None]:
    """All goals of a design, the design pose first, and the free axis if there is one."""
    axis = _free_axis(design)
    order = 1 if axis is not None and abs(axis.direction[2]) > 0.5 else _rotation_order(design)
    declared = [Pose(_design_rotation(design, q), design.kit_from_part.xyz) for q in design.symmetry.rotations]
    flips = _flipped_poses(design, known=declared)
    goals: list[Pose] = []
    for pose in [*declared, *flips]:
        for turned in _rotated_copies(design, pose, order):
            if not any(_same_goal(turned, goal, axis) for goal in goals):
                goals.append(turned)
    return Pose.stack(goals), axis


def has_design_shadow(cavity: Cavity, standing: Manifold) -> bool:
    """Whether a solid standing on the cavity's floor sweeps the shadow the cavity was made for, at every height."""
    for probe in _probes(cavity):
        other = shadow_below(standing, probe.z)
        if not (_within_tolerance(probe.shadow, other) and _within_tolerance(other, probe.shadow)):
            return False
    return True


def _probes(cavity: Cavity, most: int = 8) -> list[Probe]:
    """The heights compared, the rim first: it tells most."""
    picks = np.unique(np.linspace(0, len(cavity.probes) - 1, most).round().astype(int))
    return [cavity.probes[i] for i in picks[::-1]]


def _within_tolerance(inner: CrossSection, outer: CrossSection) -> bool:
    return (inner - outer.offset(SHADOW_TOLERANCE, JoinType.Round, circular_segments=16)).area() < AREA_TOLERANCE


def area_centroid(shadow: CrossSection) -> np.ndarray:
    """(2,) [m] centre of area."""
    moment, area = np.zeros(2), 0.0
    for loop in shadow.to_polygons():
        a, b = loop, np.roll(loop, -1, axis=0)
        cross = a[:, 0] * b[:, 1] - b[:, 0] * a[:, 1]
        moment += ((a + b) * cross[:, None]).sum(0) / 6
        area += cross.sum() / 2
    return moment / area


def _free_axis(design: Design) -> FreeAxis | None:
    """The declared free axis, else a vertical one when every contour of every shadow is a circle about one centre."""
    if design.symmetry.axis is not None:
        direction = design.kit_from_part.rotate(design.symmetry.axis)
        return FreeAxis(design.kit_from_part.xyz, direction / np.linalg.norm(direction))
    centre = area_centroid(design.cavity.rim_shadow)
    for probe in design.cavity.probes:
        for loop in probe.shadow.to_polygons():
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
    """The largest n such that a turn of 360/n degrees about the shadow's centre keeps every shadow."""
    relief, weights = design.relief
    for order in ROTATION_ORDERS:
        if _relief_difference(relief, _shifted(relief, relief.shape[1] / order), weights) > MAX_RELIEF_DIFFERENCE:
            continue
        turned = _rotated_copies(design, design.kit_from_part, order, which=1)[0]
        if has_design_shadow(design.cavity, design.standing(turned)):
            return order
    return 1


def _shifted(relief: np.ndarray, columns: float) -> np.ndarray:
    """The relief turned by a fraction of columns (linear between neighbours)."""
    whole, part = int(np.floor(columns)), columns % 1
    return (1 - part) * np.roll(relief, whole, 1) + part * np.roll(relief, whole + 1, 1)


def _relief_difference(a: np.ndarray, b: np.ndarray, weights: np.ndarray) -> float:
    return float(weights @ np.abs(a - b).sum(1) / (weights @ (a + b).sum(1) / 2))


def _rotated_copies(design: Design, pose: Pose, order: int, which: int | None = None) -> list[Pose]:
    """The pose turned by multiples of 360/order degrees about the vertical through the rim shadow's centre."""
    centre = np.array([*area_centroid(design.cavity.rim_shadow), 0.0])
    turns = range(order) if which is None else [which]
    spun = [Pose.from_rotvec(np.array([0, 0, 2 * np.pi * k / order])) for k in turns]
    return [
        Pose.from_translation(centre) @ turn @ Pose.from_translation(-centre) @ pose if k else pose
        for k, turn in zip(turns, spun, strict=True)
    ]


def _flipped_poses(design: Design, known: list[Pose]) -> list[Pose]:
    """Poses with another face down that leave the same shadow (one a face: its turns follow from the turn order)."""
    relief, weights = design.relief
    found = []
    for face in resting_faces(design.mesh, min_probability=0.0):
        if any(_faces_down(pose, face.normal) for pose in known) or face.height < design.cavity.depth:
            continue
        lying = design.mesh.moved(face.plane_from_part)
        other, _, _ = polar_relief(lying, design.cavity.depth)
        turn, difference = _best_yaw(relief, other, weights)
        if difference > MAX_RELIEF_DIFFERENCE:
            continue
        pose = _aligned(design, face.plane_from_part, turn)
        if has_design_shadow(design.cavity, design.standing(pose)):
            found.append(pose)
    return found


def _faces_down(pose: Pose, normal: np.ndarray) -> bool:
    return bool(pose.rotate(normal)[2] < -np.cos(SAME_GOAL_ANGLE))


def _best_yaw(relief: np.ndarray, other: np.ndarray, weights: np.ndarray) -> tuple[float, float]:
    """The turn [rad] of `other` that matches `relief` best, and the share of relief that still differs."""
    spectra = np.fft.rfft(relief, axis=1) * np.conj(np.fft.rfft(other, axis=1))
    correlation = weights @ np.fft.irfft(spectra, n=relief.shape[1], axis=1)
    shift = int(correlation.argmax())
    return shift * 2 * np.pi / relief.shape[1], _relief_difference(relief, np.roll(other, shift, 1), weights)


def _aligned(design: Design, lying: Pose, turn: float) -> Pose:
    """The lying pose turned so that its rim shadow overlaps the design's best , centred and seated."""
    rim = design.cavity.rim_shadow
    centre = area_centroid(rim)

    def placed(angle: float) -> Pose:
        spun = Pose.from_rotvec(np.array([0, 0, angle])) @ lying
        low = spun.apply(design.mesh.vertices)[:, 2].min()
        seated = Pose.from_translation(np.array([0, 0, -design.cavity.depth - low])) @ spun
        offset = centre - area_centroid(shadow_below(design.standing(seated), design.cavity.depth))
        return Pose.from_translation(np.array([*offset, 0.0])) @ seated

    flat = shadow_below(design.standing(placed(turn)), design.cavity.depth)

    def overlap(extra: float) -> float:
        spun = flat.translate(-centre).rotate(np.degrees(extra)).translate(centre)
        return (spun ^ rim).area()

    best = minimize_scalar(
        lambda extra: -overlap(extra), bounds=(-ALIGN_RANGE, ALIGN_RANGE), method="bounded", options={"xatol": 1e-7}
    )
    return placed(turn + best.x)


def _design_rotation(design: Design, rotation: np.ndarray) -> np.ndarray:
    return (design.kit_from_part @ Pose(rotation, np.zeros(3))).wxyz


def _same_goal(a: Pose, b: Pose, axis: FreeAxis | None) -> bool:
    """Whether two goals are one, up to a turn about the free axis."""
    if axis is not None:
        b = nearest_about_axis(a, b, axis)
    close = np.linalg.norm(a.xyz - b.xyz) < SAME_GOAL_SHIFT
    return bool(close and quaternion_angle(a.wxyz, b.wxyz) < SAME_GOAL_ANGLE)


def nearest_about_axis(pose: Pose, goal: Pose, axis: FreeAxis) -> Pose:
    """The goal turned about the free axis so that its rotation comes nearest to that of the pose (twist)."""
    w, *v = (pose @ goal.inverse()).wxyz
    angle = 2 * np.arctan2(np.dot(v, axis.direction), w)
    about = Pose.from_translation(axis.point) @ Pose.from_rotvec(angle * axis.direction)
    return about @ Pose.from_translation(-axis.point) @ goal
