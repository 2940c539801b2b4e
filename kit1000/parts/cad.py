"""CAD functions for drawing part families, in MILLIMETRES and degrees (`family.make_part` converts to metres).

Profiles are defined in `sketch` and exported here again, so a family imports this module alone. Solids are
`manifold3d.Manifold`s standing on z = 0 and centred in x and y; combine them with `+`, `-` and `^`. An axis is one of
x, y, z, -x, -y, -z. For cuts it is the side the cutting tool comes from: `drill(..., axis="z")` drills downwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from itertools import pairwise
from typing import Literal

import numpy as np
from manifold3d import CrossSection, Error, FillRule, Manifold, Mesh64, OpType, triangulate
from numpy.typing import ArrayLike, NDArray

from kit1000.numerics.linear_algebra import length, matmul
from kit1000.numerics.trigonometry import cosine, sine
from kit1000.parts.sketch import (
    arc_points,
    bearing,
    bolt_circle,
    bore,
    chance,
    circle,
    circle_segments,
    gear,
    grid,
    holes,
    hull_2d,
    ngon,
    pick,
    polygon,
    rectangle,
    ring,
    rounded,
    sector,
    slot,
    span,
)
from kit1000.symmetry import Symmetry

__all__ = [
    "Axis", "CrossSection", "Manifold", "Symmetry", "along", "arc_points", "at", "bearing", "bolt_circle", "bore",
    "box", "chance", "circle", "circle_segments", "cone", "cut_slot", "cyclic", "cylinder", "dihedral", "drill",
    "free", "free_flipped", "gear", "grid", "gusset", "holes", "hull", "hull_2d", "join", "keyway", "mirrored",
    "ngon", "none", "pick", "pocket", "polygon", "prism", "rectangle", "repeated", "revolved", "ring", "rotated",
    "rounded", "sector", "slot", "span", "sphere", "swept", "tube", "wedge",
]  # fmt: skip

Axis = Literal["x", "y", "z", "-x", "-y", "-z"]

none, cyclic, dihedral = Symmetry.none, Symmetry.cyclic, Symmetry.dihedral
free, free_flipped = Symmetry.free, Symmetry.free_flipped

REACH_MM = 200.0
"""Length of a cutting tool: longer than any part."""
ROUND_STEPS = 5
"""Layers of a rounded rim: enough to look round, and few faces."""

# Euler angles that rotate a z-up solid along an axis. Seen from the tip of the axis its x stays to the right and, for
# the four level axes, its y points up.
_ALONG_ANGLES_DEG: dict[str, tuple[float, float, float]] = {
    "z": (0, 0, 0),
    "-z": (180, 0, 0),
    "x": (90, 0, 90),
    "-x": (90, 0, -90),
    "y": (90, 0, 180),
    "-y": (90, 0, 0),
}


# --- solids -----------------------------------------------------------------------------------------------------


def prism(
    profile: CrossSection,
    height: float,
    chamfer: float = 0.0,
    chamfer_top: float | None = None,
    chamfer_bottom: float | None = None,
    fillet_top: float = 0.0,
) -> Manifold:
    """The profile extruded up from z = 0, its rims (those of holes too) chamfered at 45 degrees or the top one rounded.

    A chamfer too large for the profile (a narrow wall, a tight corner radius) is reduced until it fits.
    """
    top = chamfer if chamfer_top is None else chamfer_top
    bottom = chamfer if chamfer_bottom is None else chamfer_bottom
    if max(top, bottom, fillet_top) <= 0:
        return profile.extrude(height)
    contours = profile.simplify(1e-4).to_polygons()
    bottom = _feasible_inset(contours, min(bottom, 0.45 * height))
    top = _feasible_inset(contours, min(max(top, fillet_top), 0.45 * height))
    layers = [(0.0, bottom), (bottom, 0.0)] if bottom > 0 else [(0.0, 0.0)]
    layers += _top_rim(height, top, round_rim=fillet_top > 0)
    return _lofted([_inset(contours, inset) for _, inset in layers], [z for z, _ in layers])


def revolved(points: ArrayLike, sweep_deg: float = 360.0) -> Manifold:
    """The solid of revolution of a closed loop of points (n, 2) as (radius, z) about the z axis."""
    loop = np.asarray(points, dtype=np.float64)
    return polygon(loop).revolve(circle_segments(float(loop[:, 0].max())), sweep_deg)


def box(x: float, y: float, z: float, chamfer: float = 0.0, radius: float = 0.0) -> Manifold:
    """A block x by y by z; `radius` rounds the four upright edges, `chamfer` the upper and lower rims."""
    return prism(rectangle(x, y, radius), z, chamfer)


def cylinder(d: float, h: float, chamfer: float = 0.0) -> Manifold:
    """An upright cylinder, both rims chamfered by `chamfer`."""
    return prism(circle(d), h, chamfer)


def tube(d: float, inner: float, h: float, chamfer: float = 0.0) -> Manifold:
    """An upright cylinder with a hole of diameter `inner` along it."""
    return prism(ring(d, inner), h, chamfer)


def cone(d_bottom: float, d_top: float, h: float) -> Manifold:
    """A cone or its stump, upright."""
    return Manifold.cylinder(h, d_bottom / 2, d_top / 2, circle_segments(max(d_bottom, d_top) / 2))


def sphere(d: float) -> Manifold:
    """A ball of diameter d about the origin, a true solid of revolution about z."""
    latitudes = np.deg2rad(np.linspace(-90, 90, circle_segments(d / 2) // 4 + 1))
    half = d / 2 * np.column_stack([np.maximum(cosine(latitudes), 0), sine(latitudes)])
    return revolved(half)


def wedge(x: float, y: float, z: float, top_x: float = 0.0) -> Manifold:
    """A ramp: x long at the foot, `top_x` at the top (0 = a sharp edge), its upright face at x = -x/2, y wide."""
    side = [(-x / 2, 0), (x / 2, 0), (top_x - x / 2, z), (-x / 2, z)]
    return at(along(prism(polygon(side), y), "-y"), y=y / 2)


def gusset(x: float, z: float, thickness: float) -> Manifold:
    """A triangular stiffening rib in the xz plane: its right angle at the origin, legs along +x and +z."""
    return at(along(prism(polygon([(0, 0), (x, 0), (0, z)]), thickness), "-y"), y=thickness / 2)


def swept(profile: CrossSection, path: ArrayLike) -> Manifold:
    """The profile swept along an open path of points (n, 3) without twist, mitred at each point.

    The profile's origin follows the path; bends must be wider than the profile.
    """
    points = np.asarray(path, dtype=np.float64)
    contours = profile.simplify(1e-4).to_polygons()
    steps = np.diff(points, axis=0)
    steps /= np.linalg.norm(steps, axis=1, keepdims=True)
    right = np.cross(steps[0], np.eye(3)[int(np.argmin(np.abs(steps[0])))])
    right /= length(right)
    rings = []
    for index, point in enumerate(points):
        before, after = steps[max(index - 1, 0)], steps[min(index, len(steps) - 1)]
        up = np.cross(before, right)
        plane = before + after  # normal of the mitre plane
        ring_points = matmul(np.vstack(contours), np.stack([right, up]))  # (n, 3), square to the step before
        ring_points -= np.outer(matmul(ring_points, plane) / matmul(before, plane), before)
        rings.append(point + ring_points)
        right = right - 2 * matmul(plane, right) / matmul(plane, plane) * plane  # reflect twice: no twist
        right = right - 2 * matmul(after, right) * after
        right /= length(right)
    return _skinned(rings, contours, contours)


def hull(*solids: Manifold) -> Manifold:
    """The convex hull of the solids together."""
    return Manifold.batch_hull(list(solids))


def join(*solids: Manifold) -> Manifold:
    """All solids as one (faster than a chain of `+`)."""
    return Manifold.batch_boolean(list(solids), OpType.Add)


# --- placing ----------------------------------------------------------------------------------------------------


def at(solid: Manifold, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Manifold:
    """The solid moved by (x, y, z)."""
    return solid.translate((x, y, z))


def rotated(solid: Manifold, axis: Literal["x", "y", "z"], angle_deg: float) -> Manifold:
    """The solid rotated about an axis through the origin, counter-clockwise seen from the axis tip."""
    x, y, z = (angle_deg if name == axis else 0.0 for name in "xyz")
    return solid.rotate((x, y, z))


def along(solid: Manifold, axis: Axis) -> Manifold:
    """A z-up solid rotated so that its z points along `axis`; for level axes its y points up (to +z)."""
    return solid.rotate(_ALONG_ANGLES_DEG[axis])


def mirrored(solid: Manifold, axis: Literal["x", "y", "z"]) -> Manifold:
    """The mirror image in the plane through the origin perpendicular to `axis`."""
    x, y, z = (1.0 if name == axis else 0.0 for name in "xyz")
    return solid.mirror((x, y, z))


def repeated(solid: Manifold, n: int) -> Manifold:
    """n copies evenly about the z axis, joined."""
    return join(*(rotated(solid, "z", 360 * k / n) for k in range(n)))


# --- cutting ----------------------------------------------------------------------------------------------------


def drill(
    solid: Manifold,
    d: float,
    at: ArrayLike = (0.0, 0.0, 0.0),
    axis: Axis = "z",
    depth: float | None = None,
    countersink: float = 0.0,
    counterbore: tuple[float, float] | None = None,
) -> Manifold:
    """Holes of diameter d at one point or several, (3,) or (n, 3) or level points (2,), (n, 2), from the side `axis`.

    The points are the mouths of the holes; a through hole (depth None) needs no height. `countersink` is the head
    diameter of a 90 degree countersink, `counterbore` is (diameter, depth). All material before the mouth is removed.
    """
    mouths = np.atleast_2d(np.asarray(at, dtype=np.float64))
    if mouths.shape[1] == 2:
        mouths = np.column_stack([mouths, np.zeros(len(mouths))])
    tool = _drill_tool(d, depth, countersink, counterbore)
    facing = [bearing(x, y) if axis in ("z", "-z") else 0.0 for x, y, _ in mouths]
    sign = 1 if axis == "z" else -1
    tools = [
        along(rotated(tool, "z", sign * angle), axis).translate(mouth.tolist())
        for mouth, angle in zip(mouths, facing, strict=True)
    ]
    return Manifold.batch_boolean([solid, *tools], OpType.Subtract)


def pocket(
    solid: Manifold,
    profile: CrossSection,
    depth: float | None = None,
    at: Sequence[float] = (0.0, 0.0, 0.0),
    axis: Axis = "z",
) -> Manifold:
    """The profile milled `depth` deep (None = through) from the side `axis`, its origin at `at` on that face."""
    below = REACH_MM if depth is None else depth
    tool = profile.extrude(below + REACH_MM).translate((0, 0, -below))
    return solid - along(tool, axis).translate((at[0], at[1], at[2]))


def cut_slot(
    solid: Manifold,
    length: float,
    width: float,
    at: Sequence[float] = (0.0, 0.0, 0.0),
    axis: Axis = "z",
    depth: float | None = None,
    angle_deg: float = 0.0,
) -> Manifold:
    """A stadium-shaped slot, `length` overall, along the profile's x rotated by `angle_deg`; through unless `depth`."""
    return pocket(solid, slot(length, width).rotate(angle_deg), depth, at, axis)


def keyway(
    shaft: Manifold, d: float, width: float, depth: float, start: float, length: float, round_ends: bool = True
) -> Manifold:
    """A key seat milled from +x into an upright shaft of diameter d, from z = start to start + length."""
    seat = slot(length, width) if round_ends else rectangle(length, width)
    return pocket(shaft, seat.rotate(90), depth, (d / 2, 0, start + length / 2), "x")


# --- implementation ----------------------------------------------------------------------------------------------


def _drill_tool(d: float, depth: float | None, countersink: float, counterbore: tuple[float, float] | None) -> Manifold:
    """The solid to subtract for one hole with its mouth at the origin, drilled downwards."""
    below = REACH_MM if depth is None else depth
    tools = [Manifold.cylinder(below + REACH_MM, d / 2, d / 2, circle_segments(d / 2)).translate((0, 0, -below))]
    if countersink > d:
        radius = countersink / 2
        sink = [(0, -radius), (radius, 0), (radius, REACH_MM), (0, REACH_MM)]
        tools.append(revolved(sink))
    if counterbore is not None:
        radius = counterbore[0] / 2
        seat = Manifold.cylinder(counterbore[1] + REACH_MM, radius, radius, circle_segments(radius))
        tools.append(seat.translate((0, 0, -counterbore[1])))
    return reduce(lambda a, b: a + b, tools)


def _top_rim(height: float, size: float, round_rim: bool) -> list[tuple[float, float]]:
    """(z, inset) of the layers at the top of a prism."""
    if size <= 0:
        return [(height, 0.0)]
    if not round_rim:
        return [(height - size, 0.0), (height, size)]
    angles = np.linspace(0, np.pi / 2, ROUND_STEPS)
    return [(float(height - size + size * sine(a)), float(size * (1 - cosine(a)))) for a in angles]


def _inset(contours: list[NDArray], distance: float) -> list[NDArray]:
    """Each contour (n, 2) with its edges moved into the material by `distance`; corners correspond."""
    return [_inset_loop(loop, distance) for loop in contours]


def _inset_loop(loop: NDArray, distance: float) -> NDArray:
    edges = np.roll(loop, -1, axis=0) - loop
    edges = edges / np.linalg.norm(edges, axis=1, keepdims=True)
    inward = np.column_stack([-edges[:, 1], edges[:, 0]])
    before = np.roll(inward, 1, axis=0)
    opening = 1.0 + np.einsum("ij,ij->i", before, inward)
    return loop + distance * (before + inward) / np.maximum(opening, 0.1)[:, None]


def _feasible_inset(contours: list[NDArray], wanted: float) -> float:
    """The largest of wanted, 0.7 wanted, 0.49 wanted, ... by which the contours can be inset and stay simple."""
    for size in wanted * np.cumprod([1.0, *5 * [0.7]]):  # powers of C differ between processors
        if size > 0.05 and _stays_simple(contours, float(size)):
            return float(size)
    return 0.0


def _stays_simple(contours: list[NDArray], distance: float) -> bool:
    """Whether no edge flips and no two edges cross when the contours are inset by a distance."""
    moved = _inset(contours, distance)
    for old, new in zip(contours, moved, strict=True):
        kept = np.einsum("ij,ij->i", np.roll(old, -1, 0) - old, np.roll(new, -1, 0) - new)
        if (kept <= 0).any():
            return False
    signed = sum(_signed_area(loop) for loop in moved)
    return abs(CrossSection(moved, FillRule.Positive).area() - signed) < 1e-6 * max(signed, 1.0)


def _signed_area(loop: NDArray) -> float:
    x, y = loop.T
    return float(0.5 * (matmul(x, np.roll(y, -1)) - matmul(y, np.roll(x, -1))))


def _lofted(layers: list[list[NDArray]], heights: list[float]) -> Manifold:
    """A solid through contours with corresponding corners, stacked at heights."""
    rings = [
        np.column_stack([np.vstack(contours), np.full(sum(map(len, contours)), z)])
        for contours, z in zip(layers, heights, strict=True)
    ]
    return _skinned(rings, layers[0], layers[-1])


def _skinned(rings: list[NDArray], first: list[NDArray], last: list[NDArray]) -> Manifold:
    """A solid through rings of points (n, 3); `first` and `last` are the flat contours that close its ends."""
    n = len(rings[0])
    start = np.cumsum([0, *map(len, first)])
    next_corner = np.concatenate([np.roll(np.arange(a, b), -1) for a, b in pairwise(start)])
    here = np.arange(n)
    wall = np.concatenate(
        [
            np.stack([here, next_corner, next_corner + n], axis=1),
            np.stack([here, next_corner + n, here + n], axis=1),
        ]
    )
    walls = [wall + k * n for k in range(len(rings) - 1)]
    bottom = np.asarray(triangulate(first))[:, ::-1]
    top = np.asarray(triangulate(last)) + (len(rings) - 1) * n
    faces = np.concatenate([bottom, *walls, top])
    solid = Manifold(Mesh64(np.vstack(rings), faces.astype(np.uint64)))
    if solid.status() != Error.NoError:
        raise ValueError(f"contours do not close into a solid: {solid.status().name}")
    return solid
