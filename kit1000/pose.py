"""Rigid poses and rotations: unit quaternions (w, x, y, z) and positions [m], batched over leading axes.

`a_from_b` maps coordinates in b to coordinates in a, so that `a_from_c = a_from_b @ b_from_c`. Angles are computed by
atan2, so results are accurate to rounding from 0 to 180 degrees. No sum uses a matrix library: a result does not depend
on the number of poses or points in a batch.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from kit1000.errors import InputError, ShapeError, checked
from kit1000.numerics.linear_algebra import determinant
from kit1000.numerics.trigonometry import cosine, sine

# A product of a few float32 matrices deviates from a rotation by less; a scaled or sheared one by more.
ROTATION_TOLERANCE = 1e-5
# The computed norm of a normalised quaternion is within this of 1; such quaternions are not changed, bit for bit.
UNIT_TOLERANCE = 4 * np.finfo(np.float64).eps
# Quaternions and directions of a greater length, or one under its inverse, are rejected.
NORM_LIMIT = 1e100
# Directions this close to opposite [rad] define no rotation axis: any perpendicular one is used.
OPPOSITE_TOLERANCE = 1e-12


@dataclass(frozen=True, eq=False)
class Pose:
    """Rigid poses `a_from_b`, one or a batch; a point p in b is at `rotate(p) + xyz` in a.

    The leading axes of the two arrays broadcast. Quaternions are normalised and keep their sign, so q and -q remain
    different though they are the same rotation. Both arrays are read-only copies.
    """

    wxyz: np.ndarray
    """Rotation as a unit quaternion, scalar first. (..., 4) float64."""
    xyz: np.ndarray
    """Position of the origin of b in a. (..., 3) float64 [m]."""

    def __post_init__(self) -> None:
        wxyz = _unit(checked("wxyz", self.wxyz, (..., 4)), "wxyz")
        xyz = checked("xyz", self.xyz, (..., 3))
        batch = _broadcast("xyz", xyz, "wxyz", wxyz)
        object.__setattr__(self, "wxyz", _frozen(wxyz, (*batch, 4)))
        object.__setattr__(self, "xyz", _frozen(xyz, (*batch, 3)))

    @classmethod
    def identity(cls, batch_shape: tuple[int, ...] = ()) -> Pose:
        """The identity, repeated over `batch_shape`."""
        return cls(np.broadcast_to((1.0, 0.0, 0.0, 0.0), (*batch_shape, 4)), np.zeros(3))

    @classmethod
    def from_translation(cls, xyz: ArrayLike) -> Pose:
        """Pure translations. xyz: (..., 3) [m]."""
        return cls(np.array((1.0, 0.0, 0.0, 0.0)), np.asarray(xyz))

    @classmethod
    def from_rotvec(cls, rotvec: ArrayLike, xyz: ArrayLike = (0.0, 0.0, 0.0)) -> Pose:
        """Rotations about the axis `rotvec` by its length. rotvec: (..., 3) [rad], xyz: (..., 3) [m]."""
        return cls(quaternion_from_rotvec(rotvec), np.asarray(xyz))

    @classmethod
    def from_rotation_matrix(cls, matrix: ArrayLike, xyz: ArrayLike = (0.0, 0.0, 0.0)) -> Pose:
        """From rotation matrices (..., 3, 3) and positions (..., 3) [m]; rejects scale, shear and reflections."""
        return cls(_quaternion_from_matrix(checked("rotation matrix", matrix, (..., 3, 3))), np.asarray(xyz))

    @classmethod
    def from_matrix(cls, matrix: ArrayLike) -> Pose:
        """From homogeneous matrices (..., 4, 4) with positions in m; rejects all but rigid ones."""
        rows = checked("matrix", matrix, (..., 4, 4))
        if np.any(np.abs(rows[..., 3, :] - (0.0, 0.0, 0.0, 1.0)) > ROTATION_TOLERANCE):
            raise InputError("matrix: expected the last row 0 0 0 1 (positions are in the last column)")
        return cls.from_rotation_matrix(rows[..., :3, :3], rows[..., :3, 3])

    __array_ufunc__ = None  # so that `array @ pose` raises TypeError instead of iterating over the pose

    def __matmul__(self, other: Pose) -> Pose:
        """Compose: `a_from_c = a_from_b @ b_from_c`; leading axes broadcast."""
        if not isinstance(other, Pose):
            raise TypeError(f"a pose composes with a pose, not with {type(other).__name__}; use apply() for points")
        return Pose(quaternion_multiply(self.wxyz, other.wxyz), self.apply(other.xyz))

    def inverse(self) -> Pose:
        """`b_from_a` of an `a_from_b`."""
        back = quaternion_conjugate(self.wxyz)
        return Pose(back, -_rotated(_matrix(back), self.xyz))

    def apply(self, points: ArrayLike) -> np.ndarray:
        """Map points from b to a. points: (..., 3) [m] -> (..., 3) [m].

        Leading axes broadcast: one pose maps any points, n poses map n points one to one, and `poses[:, None]` maps
        every point by every pose. Non-finite points are allowed.
        """
        return self.rotate(points) + self.xyz

    def rotate(self, vectors: ArrayLike) -> np.ndarray:
        """Map vectors from b to a: rotation without translation. (..., 3) -> (..., 3), broadcasting like `apply`."""
        array = _trailing("points", vectors, 3)
        _broadcast("points", array, "wxyz", self.wxyz)
        return _rotated(self.rotation_matrix(), array)

    def rotation_matrix(self) -> np.ndarray:
        """The rotations as matrices. (..., 3, 3)."""
        return _matrix(self.wxyz)

    def matrix(self) -> np.ndarray:
        """The poses as homogeneous matrices, positions in m in the last column. (..., 4, 4)."""
        matrix = np.zeros((*self.batch_shape, 4, 4))
        matrix[..., :3, :3] = self.rotation_matrix()
        matrix[..., :3, 3] = self.xyz
        matrix[..., 3, 3] = 1.0
        return matrix

    def rotvec(self) -> np.ndarray:
        """Rotation vectors: axis times angle. (..., 3) [rad], length at most pi."""
        w = self.wxyz[..., :1]
        v = np.where(w < 0, -self.wxyz[..., 1:], self.wxyz[..., 1:])
        sine = np.linalg.norm(v, axis=-1, keepdims=True)
        # atan2(s, w)/s is accurate to rounding for every s > 0; where the squares in s underflow it is 1.
        ratio = np.where(sine == 0, 1.0, np.arctan2(sine, np.abs(w)) / np.where(sine == 0, 1.0, sine))
        return 2 * ratio * v

    def angle(self) -> np.ndarray:
        """Angle of the rotation. (...,) [rad], 0 .. pi."""
        return _angle(self.wxyz)

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """The leading axes; () for a single pose."""
        return self.xyz.shape[:-1]

    @classmethod
    def stack(cls, poses: Sequence[Pose]) -> Pose:
        """Stack poses of one batch shape along a new first axis; no poses give the batch of shape (0,)."""
        if not poses:
            return cls.identity((0,))
        shapes = {pose.batch_shape for pose in poses}
        if len(shapes) > 1:
            raise ShapeError(f"poses: expected one batch shape to stack, got {sorted(shapes)}")
        return cls(np.stack([pose.wxyz for pose in poses]), np.stack([pose.xyz for pose in poses]))

    def __getitem__(self, index: Any) -> Pose:
        """Index the batch axes as numpy does: ints, slices, masks, index arrays, None."""
        if self.batch_shape == () and isinstance(index, int | slice):
            raise IndexError("a single pose has no batch axis to index")
        chosen = np.arange(self.xyz.size // 3).reshape(self.batch_shape)[index]
        return Pose(self.wxyz.reshape(-1, 4)[chosen], self.xyz.reshape(-1, 3)[chosen])

    def __len__(self) -> int:
        if self.batch_shape == ():
            raise TypeError("a single pose has no length")
        return self.batch_shape[0]

    def __bool__(self) -> bool:
        raise TypeError("a pose has no truth value; test for a missing one with `is None`")

    def __iter__(self) -> Iterator[Pose]:
        return (self[i] for i in range(len(self)))

    def __reduce__(self) -> tuple[type[Pose], tuple[np.ndarray, np.ndarray]]:
        # Unpickled arrays are writable; constructing the pose again makes them read-only and keeps every bit.
        return Pose, (self.wxyz, self.xyz)


def normalized_quaternion(wxyz: ArrayLike, name: str = "quaternion") -> np.ndarray:
    """Scale quaternions to unit length. (..., 4) -> (..., 4); `name` begins an error message.

    A quaternion that has unit length to rounding is not changed, so that normalising twice, or reading back what was
    written, changes no bit.
    """
    return np.array(_unit(checked(name, wxyz, (..., 4)), name))


def quaternion_multiply(a: ArrayLike, b: ArrayLike) -> np.ndarray:
    """Hamilton product: rotation by b, then by a. (..., 4), (..., 4) -> (..., 4), broadcasting."""
    left, right = _trailing("a", a, 4), _trailing("b", b, 4)
    batch = _broadcast("a", left, "b", right)
    (aw, ax, ay, az), (bw, bx, by, bz) = _components(left), _components(right)
    result = np.empty((*batch, 4))
    result[..., 0] = aw * bw - ax * bx - ay * by - az * bz
    result[..., 1] = aw * bx + ax * bw + ay * bz - az * by
    result[..., 2] = aw * by - ax * bz + ay * bw + az * bx
    result[..., 3] = aw * bz + ax * by - ay * bx + az * bw
    return result


def quaternion_conjugate(q: ArrayLike) -> np.ndarray:
    """The inverse of unit quaternions. (..., 4) -> (..., 4)."""
    return _trailing("q", q, 4) * (1.0, -1.0, -1.0, -1.0)


def quaternion_angle(a: ArrayLike, b: ArrayLike) -> np.ndarray:
    """Geodesic angle between rotations. (..., 4), (..., 4) -> (...,) [rad], 0 .. pi; the same for q and -q."""
    return _angle(quaternion_multiply(quaternion_conjugate(a), b))


def quaternion_from_rotvec(rotvec: ArrayLike) -> np.ndarray:
    """Unit quaternions of rotations about the axis `rotvec` by its length. (..., 3) [rad] -> (..., 4)."""
    v = checked("rotvec", rotvec, (..., 3))
    half = np.linalg.norm(v, axis=-1, keepdims=True) / 2
    return np.concatenate([cosine(half), 0.5 * _sinc(half) * v], axis=-1)


def quaternion_between(u: ArrayLike, v: ArrayLike) -> np.ndarray:
    """The shortest rotation that maps direction u to direction v. (..., 3), (..., 3) -> (..., 4).

    Lengths have no effect. For opposite directions the rotation is by pi about a perpendicular of u, always the same
    one for the same u.
    """
    start, end = unit_vector(u, "u"), unit_vector(v, "v")
    batch = _broadcast("u", start, "v", end)
    start, end = np.broadcast_to(start, (*batch, 3)), np.broadcast_to(end, (*batch, 3))
    cosine = np.sum(start * end, axis=-1, keepdims=True)
    # Beyond a right angle: a half turn about an axis perpendicular to u, then the remaining small rotation.
    half_turn = np.concatenate([np.zeros_like(cosine), _axis_between(start, end)], axis=-1)
    far = quaternion_multiply(_half_way(-start, end), half_turn)
    return np.where(cosine >= 0, _half_way(start, end), far)


def unit_vector(vector: ArrayLike, name: str = "vector") -> np.ndarray:
    """Scale vectors to unit length. (..., 3) -> (..., 3); `name` begins an error message.

    One that has unit length to rounding is not changed.
    """
    array = checked(name, vector, (..., 3))
    with np.errstate(over="ignore"):
        norm = np.linalg.norm(array, axis=-1, keepdims=True)
    if not np.all((norm > 1 / NORM_LIMIT) & (norm < NORM_LIMIT)):
        raise InputError(f"{name}: expected a direction, got a vector of no or huge length")
    return np.where(np.abs(norm - 1) <= UNIT_TOLERANCE, array, array / norm)


def random_quaternions(rng: np.random.Generator, n: int) -> np.ndarray:
    """Draw n uniformly distributed rotations. (n, 4) unit quaternions of either sign."""
    # Normal deviates have no preferred direction in four dimensions.
    return normalized_quaternion(rng.standard_normal((n, 4)))


def _unit(q: np.ndarray, name: str) -> np.ndarray:
    """Finite quaternions (..., 4) scaled to unit length; the array itself when all have unit length."""
    if q.ndim == 1 and abs(math.sqrt(sum(x * x for x in q.tolist())) - 1) <= UNIT_TOLERANCE:
        return q
    with np.errstate(over="ignore"):
        norm = np.sqrt(np.sum(q * q, axis=-1, keepdims=True))
    off = np.abs(norm - 1) > UNIT_TOLERANCE
    if not off.any():
        return q
    if not np.all((norm > 1 / NORM_LIMIT) & (norm < NORM_LIMIT)):
        raise InputError(f"{name}: expected unit quaternions (w, x, y, z), got one of no or huge length")
    return np.where(off, q / norm, q)


def _half_way(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Unit quaternions that rotate unit vector u to unit vector v, for angles up to about 90 degrees."""
    w = 1 + np.sum(u * v, axis=-1, keepdims=True)
    q = np.concatenate([w, np.cross(u, v)], axis=-1)
    # A vector near -u gives a quaternion near zero; the caller discards it, so its length only must not be 0.
    return q / np.maximum(np.linalg.norm(q, axis=-1, keepdims=True), OPPOSITE_TOLERANCE)


def _axis_between(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Unit vectors perpendicular to u, and to v to rounding. (..., 3)."""
    cross = np.cross(u, v)
    size = np.linalg.norm(cross, axis=-1, keepdims=True)
    # Where u and v span no plane, the coordinate axis at the largest angle from u replaces v.
    partner = np.eye(3)[np.argmin(np.abs(u), axis=-1)]
    axis = np.where(size < OPPOSITE_TOLERANCE, np.cross(u, partner), cross)
    axis = axis / np.linalg.norm(axis, axis=-1, keepdims=True)
    # Rounding of a short product has a component along u; subtract it.
    axis = axis - np.sum(axis * u, axis=-1, keepdims=True) * u
    return axis / np.linalg.norm(axis, axis=-1, keepdims=True)


def _quaternion_from_matrix(matrix: np.ndarray) -> np.ndarray:
    """Rotation matrices (..., 3, 3) as unit quaternions (..., 4).

    The symmetric matrix 4 q q^T is linear in the entries; its column with the largest diagonal entry
    is q without cancellation (Shepperd, "Quaternion from rotation matrix", 1978).
    """
    gram = np.sum(matrix[..., :, :, None] * matrix[..., :, None, :], axis=-3)
    if np.any(np.abs(gram - np.eye(3)) > ROTATION_TOLERANCE) or np.any(determinant(matrix) < 0):
        raise InputError("rotation matrix: expected a rotation, got one that scales, shears or reflects")
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = np.moveaxis(matrix, (-2, -1), (0, 1))
    rows = (
        (1 + xx + yy + zz, zy - yz, xz - zx, yx - xy),
        (zy - yz, 1 + xx - yy - zz, xy + yx, xz + zx),
        (xz - zx, xy + yx, 1 - xx + yy - zz, yz + zy),
        (yx - xy, xz + zx, yz + zy, 1 - xx - yy + zz),
    )
    outer = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)  # (..., 4, 4)
    best = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    column = np.take_along_axis(outer, best[..., None, None], axis=-2)[..., 0, :]
    return column / np.linalg.norm(column, axis=-1, keepdims=True)


def _components(array: np.ndarray) -> Iterable[Any]:
    """The parts (...) of an array (..., n); floats for a single row, which are the same bits in less time."""
    return array.tolist() if array.ndim == 1 else (array[..., i] for i in range(array.shape[-1]))


def _matrix(wxyz: np.ndarray) -> np.ndarray:
    """Unit quaternions (..., 4) as rotation matrices (..., 3, 3)."""
    w, x, y, z = _components(wxyz)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    matrix = np.empty((*wxyz.shape[:-1], 3, 3))
    for i, j in product(range(3), repeat=2):
        matrix[..., i, j] = rows[i][j]
    return matrix


def _rotated(matrix: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Matrices (..., 3, 3) times vectors (..., 3), summed in one fixed order whatever the batch."""
    columns = (matrix[..., :, i] * vectors[..., i, None] for i in range(3))
    return next(columns) + next(columns) + next(columns)


def _angle(q: np.ndarray) -> np.ndarray:
    """Angle of quaternions of any length and sign. (..., 4) -> (...,) [rad], 0 .. pi."""
    return 2 * np.arctan2(np.linalg.norm(q[..., 1:], axis=-1), np.abs(q[..., 0]))


def _sinc(x: np.ndarray) -> np.ndarray:
    """sin(x)/x, accurate to rounding, 1 at x = 0."""
    return np.where(x == 0, 1.0, sine(x) / np.where(x == 0, 1.0, x))


def _trailing(name: str, array: ArrayLike, size: int) -> np.ndarray:
    """Return the array as float64 after checking its last axis."""
    values = np.asarray(array, dtype=np.float64)
    if values.ndim == 0 or values.shape[-1] != size:
        raise ShapeError(f"{name}: expected shape (..., {size}), got {values.shape}")
    return values


def _broadcast(name: str, array: np.ndarray, other_name: str, other: np.ndarray) -> tuple[int, ...]:
    """Shape that the leading axes of two arrays broadcast to."""
    if array.shape[:-1] == other.shape[:-1]:
        return array.shape[:-1]
    try:
        return np.broadcast_shapes(array.shape[:-1], other.shape[:-1])
    except ValueError:
        expected = f"leading axes that broadcast with those of {other_name} {other.shape}"
        raise ShapeError(f"{name}: expected {expected}, got shape {array.shape}") from None


def _frozen(array: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """A private array made read-only; broadcast to the shape by a contiguous copy if it has another."""
    own = array if array.shape == shape else np.array(np.broadcast_to(array, shape), order="C")
    own.setflags(write=False)
    return own
