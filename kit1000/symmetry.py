"""Rotational symmetries of a part about its centroid, and the symmetry-aware rotation error.

A symmetry is a finite group of rotations, or all rotations about a free axis, alone or with a flip of its ends.
Rotations are unit quaternions (w, x, y, z) in the part's own axes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from kit1000.errors import InputError, checked
from kit1000.numerics.trigonometry import cosine, sine
from kit1000.pose import (
    Pose,
    normalized_quaternion,
    quaternion_conjugate,
    quaternion_from_rotvec,
    quaternion_multiply,
    unit_vector,
)

# Rotations nearer than this [rad] are the same element of a group. Distinct elements differ by at least 3 degrees;
# rounding in a chain of 120 products is eight orders of magnitude below.
GROUP_TOLERANCE = 1e-6
# The largest group of a generated symmetry: twice the rotations of an icosahedron.
MAX_GROUP_ORDER = 120
IDENTITY = (1.0, 0.0, 0.0, 0.0)
Z_AXIS = (0.0, 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class Symmetry:
    """The rotations about its centroid that map a part to itself, in the part's axes.

    With an `axis`, every product of a listed rotation and a rotation about the axis belongs to the symmetry. Rotations
    that form no group are rejected, since the error would then depend on the pose.
    """

    rotations: np.ndarray
    """Distinct group elements as unit quaternions, the identity first. (n, 4) float64."""
    axis: np.ndarray | None = None
    """Unit direction of the free axis, or None. (3,) float64."""

    def __post_init__(self) -> None:
        rotations = checked("rotations", normalized_quaternion(self.rotations, "rotations"), ("n", 4))
        axis = None if self.axis is None else checked("axis", unit_vector(self.axis, "axis"), (3,))
        object.__setattr__(self, "rotations", rotations)
        object.__setattr__(self, "axis", axis)
        if not self.is_group():
            raise InputError("rotations: expected a group of distinct rotations with the identity first")

    @classmethod
    def none(cls) -> Symmetry:
        """No symmetry: only the identity."""
        return cls(np.array([IDENTITY]))

    @classmethod
    def cyclic(cls, n: int, axis: ArrayLike = Z_AXIS) -> Symmetry:
        """n equal rotation steps about an axis (3,): an n-fold wheel. n = 1 is no symmetry."""
        return cls(_rotation_steps(_step_count(n), axis))

    @classmethod
    def dihedral(cls, n: int, axis: ArrayLike = Z_AXIS, flip: ArrayLike = (1.0, 0.0, 0.0)) -> Symmetry:
        """n steps about an axis (3,) and a half turn about a perpendicular `flip` (3,): an n-fold prism."""
        steps = _rotation_steps(_step_count(n), axis)
        return cls(np.concatenate([steps, quaternion_multiply(steps, _half_turn(flip, axis))]))

    @classmethod
    def free(cls, axis: ArrayLike = Z_AXIS) -> Symmetry:
        """Every rotation about an axis (3,): a cone."""
        return cls(np.array([IDENTITY]), unit_vector(axis, "axis"))

    @classmethod
    def free_flipped(cls, axis: ArrayLike = Z_AXIS) -> Symmetry:
        """Every rotation about an axis (3,) and the flip of its two ends: a cylinder."""
        n = checked("axis", unit_vector(axis, "axis"), (3,))
        flip = np.cross(n, np.eye(3)[np.argmin(np.abs(n))])
        return cls(np.stack([IDENTITY, _half_turn(flip, n)]), n)

    @classmethod
    def generated(cls, generators: ArrayLike) -> Symmetry:
        """The smallest group that contains the generators (k, 4); rejects more than 120 elements."""
        steps = checked("generators", normalized_quaternion(generators, "generators"), ("k", 4))
        elements = np.array([IDENTITY])
        new = elements
        while len(new):
            products = quaternion_multiply(new[:, None], steps).reshape(-1, 4)
            new = _distinct(products, elements)
            elements = np.concatenate([elements, new])
            if len(elements) > MAX_GROUP_ORDER:
                raise InputError(f"generators: expected a group of up to {MAX_GROUP_ORDER} rotations, got more")
        return cls(elements)

    @classmethod
    def cube(cls) -> Symmetry:
        """The 24 rotations of a cube with edges along the axes."""
        quarter = np.pi / 2
        return cls.generated(quaternion_from_rotvec([[0, 0, quarter], [quarter, 0, 0]]))

    @property
    def order(self) -> int:
        """The number of listed rotations, without those about a free axis."""
        return len(self.rotations)

    @property
    def name(self) -> str:
        """Schoenflies name of the group: "none", "C3", "D4", "T", "O", "I", "free" or "free_flipped"."""
        if self.axis is not None:
            return "free" if self.order == 1 else "free_flipped"
        if self.order == 1:
            return "none"
        smallest = _residual(self.rotations[1:], None).min()
        fold = round(2 * np.pi / smallest)  # the largest n of an n-fold axis identifies the group
        kind = {fold: f"C{fold}", 2 * fold: f"D{fold}", 4 * fold: "T", 6 * fold: "O", 12 * fold: "I"}
        return kind[self.order]

    def error(self, estimate: ArrayLike, truth: ArrayLike) -> np.ndarray:
        """Smallest angle between an estimate and any orientation equivalent to the truth.

        For each g of the group, q = (truth g)^-1 estimate = (w, v) is the remaining rotation. Its angle is
        2 atan2(|v|, |w|); after the best rotation about a free axis n it is 2 atan2(|v - (n.v) n|, hypot(w, n.v)), the
        swing of the swing-twist decomposition.

        Args:
            estimate: estimated `world_from_part` rotations. (..., 4) unit quaternions.
            truth: true ones, broadcasting with the estimate. (..., 4) unit quaternions.

        Returns:
            (...,) [rad], 0 .. pi.
        """
        difference = quaternion_multiply(quaternion_conjugate(truth), estimate)
        smallest = np.full(difference.shape[:-1], np.inf)
        for inverse in quaternion_conjugate(self.rotations):  # one at a time: memory stays that of the input
            smallest = np.minimum(smallest, _residual(quaternion_multiply(inverse, difference), self.axis))
        return smallest

    def conjugated(self, q: ArrayLike) -> Symmetry:
        """The symmetry of the same part after a rotation by q (4,) in its own axes."""
        rotation = checked("q", normalized_quaternion(q, "q"), (4,))
        rotated = quaternion_multiply(quaternion_multiply(rotation, self.rotations), quaternion_conjugate(rotation))
        rotated[0] = IDENTITY  # exactly, not to rounding
        return Symmetry(rotated, None if self.axis is None else Pose(rotation, np.zeros(3)).rotate(self.axis))

    def is_group(self, tol: float = GROUP_TOLERANCE) -> bool:
        """Whether the identity is first, elements are distinct and products are elements, within `tol` [rad]."""
        g = self.rotations
        if len(g) == 0 or _residual(g[0], None) > tol:
            return False
        if self.axis is not None and np.any(_tilt(g, self.axis) > tol):
            return False
        between = quaternion_multiply(quaternion_conjugate(g)[:, None], g)
        angles = _residual(between, self.axis) + 2 * tol * np.eye(len(g))
        # A finite set with every a^-1 b contains the inverses (b = 1), and so the products.
        return bool(np.all(angles > tol) and np.all(self.error(between, IDENTITY) <= tol))

    def __reduce__(self) -> tuple[type[Symmetry], tuple[np.ndarray, np.ndarray | None]]:
        # Unpickled arrays are writable; constructing the symmetry again makes them read-only.
        return Symmetry, (self.rotations, self.axis)


def _residual(q: np.ndarray, axis: np.ndarray | None) -> np.ndarray:
    """Angle of rotations, after the best rotation about the axis if there is one. (..., 4) -> (...,) [rad]."""
    w, v = q[..., 0], q[..., 1:]
    if axis is None:
        return 2 * np.arctan2(np.linalg.norm(v, axis=-1), np.abs(w))
    along = np.sum(v * axis, axis=-1)
    return 2 * np.arctan2(np.linalg.norm(np.cross(axis, v), axis=-1), np.hypot(w, along))


def _tilt(rotations: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Sine of the angle between the axis line and its image. (n, 4), (3,) -> (n,)."""
    images = Pose(rotations, np.zeros(3)).rotate(axis)
    return np.linalg.norm(np.cross(images, axis), axis=-1)


def _rotation_steps(n: int, axis: ArrayLike) -> np.ndarray:
    """n rotations in equal steps about an axis (3,), the identity first. (n, 4)."""
    unit = checked("axis", unit_vector(axis, "axis"), (3,))
    half = np.arange(n) * (np.pi / n)
    return np.concatenate([cosine(half)[:, None], sine(half)[:, None] * unit], axis=-1)


def _half_turn(flip: ArrayLike, axis: ArrayLike) -> np.ndarray:
    """The half turn about a direction (3,) that must be perpendicular to the axis (3,). (4,)."""
    direction = checked("flip", unit_vector(flip, "flip"), (3,))
    cosine = float(np.sum(direction * unit_vector(axis, "axis")))
    if abs(cosine) > GROUP_TOLERANCE:
        raise InputError(f"flip: expected a perpendicular of the axis, got one at cosine {cosine:.3g}")
    return np.concatenate([[0.0], direction])


def _step_count(n: int) -> int:
    """The number of rotation steps as an int, checked to be a whole number from 1 up."""
    if n != int(n) or n < 1:
        raise InputError(f"n: expected a whole number of steps from 1 up, got {n}")
    return int(n)


def _distinct(candidates: np.ndarray, known: np.ndarray) -> np.ndarray:
    """The candidates (k, 4) that repeat neither a known rotation nor an earlier candidate. (m, 4)."""
    elements = known
    for q in candidates:
        angles = _residual(quaternion_multiply(quaternion_conjugate(elements), q), None)
        if np.all(angles > GROUP_TOLERANCE):
            elements = np.concatenate([elements, q[None]])
    return elements[len(known) :]
