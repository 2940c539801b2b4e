"""CAD functions for drawing part families, in MILLIMETRES and degrees (`family.make_part` converts to metres).

Profiles are `manifold3d.CrossSection`s in the xy plane, centred on the origin unless a docstring says otherwise; place
them with `.translate((x, y))` and `.rotate(deg)`. Circles have a multiple of four vertices, all on the circle, so
axis-aligned symmetry is exact. Solids are `manifold3d.Manifold`s standing on z = 0 and centred in x and y. Combine
either with `+` (join), `-` (cut) and `^` (common part). An axis is one of x, y, z, -x, -y, -z. For cuts it is the side
the cutting tool comes from: `drill(..., axis="z")` drills downwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from itertools import pairwise
from typing import Literal, TypeVar

import numpy as np
from manifold3d import CrossSection, Error, FillRule, JoinType, Manifold, Mesh64, OpType, triangulate
from numpy.typing import ArrayLike, NDArray

from kit1000.numerics.linear_algebra import matmul
from kit1000.numerics.trigonometry import cosine, sine, tangent
from kit1000.symmetry import Symmetry

Axis = Literal["x", "y", "z", "-x", "-y", "-z"]
Choice = TypeVar("Choice")

none, cyclic, dihedral = Symmetry.none, Symmetry.cyclic, Symmetry.dihedral
free, free_flipped = Symmetry.free, Symmetry.free_flipped

SAGITTA_MM = 0.013
"""Largest distance between an arc and its chords as drawn: below 0.02 mm also when a small drawing is scaled by 1.5."""
BEARING_DECIMALS = 9  # [deg]
PRESSURE_ANGLE_DEG = 20.0
"""Pressure angle of the involute gears, the usual one of machine design (ISO 53)."""

REACH_MM = 200.0
"""Length of a cutting tool: longer than any part."""

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


# --- random choices and profiles ---------------------------------------------------------------------------------


def span(rng: np.random.Generator, low: float, high: float, step: float = 0.1) -> float:
    """A length drawn uniformly from [low, high], rounded to `step` as on a drawing [mm]."""
    return round(round(rng.uniform(low, high) / step) * step, 6)


def pick(rng: np.random.Generator, *choices: Choice) -> Choice:
    """One of the choices, all equally likely."""
    return choices[int(rng.integers(len(choices)))]


def chance(rng: np.random.Generator, probability: float) -> bool:
    """True with a given probability."""
    return bool(rng.random() < probability)


def circle_segments(radius: float) -> int:
    """Number of sides of the polygon for a circle of this radius [mm]: a multiple of 4, at least 12."""
    half_angle = np.arccos(1.0 - min(SAGITTA_MM / max(radius, SAGITTA_MM), 1.0))
    return max(12, 4 * int(np.ceil(np.pi / half_angle / 4)))


def circle(d: float) -> CrossSection:
    """A disc of diameter d."""
    return CrossSection.circle(d / 2, circle_segments(d / 2))


def ring(outer: float, inner: float) -> CrossSection:
    """The area between two concentric circles, given by their diameters."""
    return circle(outer) - circle(inner)


def rectangle(x: float, y: float, radius: float = 0.0) -> CrossSection:
    """A rectangle x by y, its corners rounded with `radius` if given."""
    if radius <= 0:
        return CrossSection.square((x, y), center=True)
    radius = min(radius, 0.499 * x, 0.499 * y)
    corner = circle(2 * radius)
    dx, dy = x / 2 - radius, y / 2 - radius
    return hull_2d(*(corner.translate((sx * dx, sy * dy)) for sx in (-1, 1) for sy in (-1, 1)))


def ngon(n: int, across_flats: float) -> CrossSection:
    """A regular n-gon with one flat facing +x."""
    corner_radius = across_flats / 2 / cosine(np.pi / n)
    angles = (np.arange(n) - 0.5) * 2 * np.pi / n
    return polygon(corner_radius * np.column_stack([cosine(angles), sine(angles)]))


def slot(length: float, width: float) -> CrossSection:
    """A stadium along x: `length` overall, round ends of diameter `width`."""
    reach = max(length - width, 0.0) / 2
    return hull_2d(circle(width).translate((-reach, 0)), circle(width).translate((reach, 0)))


def polygon(points: ArrayLike) -> CrossSection:
    """The area inside a closed loop of points (n, 2), in either orientation."""
    loop = np.asarray(points, dtype=np.float64)
    return CrossSection([loop], FillRule.NonZero)


def arc_points(center: Sequence[float], radius: float, start_deg: float, end_deg: float) -> NDArray[np.float64]:
    """Points (n, 2) on an arc, both ends included; clockwise when end < start."""
    sweep = abs(end_deg - start_deg) / 360
    n = max(2, int(np.ceil(circle_segments(radius) * sweep)) + 1)
    angles = np.deg2rad(np.linspace(start_deg, end_deg, n))
    return np.asarray(center, dtype=np.float64) + radius * np.column_stack([cosine(angles), sine(angles)])


def sector(d: float, start_deg: float, end_deg: float) -> CrossSection:
    """A circular sector of diameter d from start to end, counter-clockwise."""
    return polygon(np.vstack([[(0.0, 0.0)], arc_points((0, 0), d / 2, start_deg, end_deg)]))


def hull_2d(*profiles: CrossSection) -> CrossSection:
    """The convex hull of the profiles together."""
    return CrossSection.batch_hull(list(profiles))


def rounded(profile: CrossSection, radius: float) -> CrossSection:
    """The profile with its convex and then its concave corners rounded."""
    n = circle_segments(radius)
    convex = profile.offset(-radius, JoinType.Miter, 4.0).offset(radius, JoinType.Round, 2.0, n)
    both = convex.offset(radius, JoinType.Miter, 4.0).offset(-radius, JoinType.Round, 2.0, n)
    return both.simplify(SAGITTA_MM / 10)


def bore(d: float, key_width: float = 0.0, key_depth: float = 0.0, flat: float = 0.0) -> CrossSection:
    """The opening of a bore, to be cut out: round, with a keyway of this width and depth towards +x,
    or D-shaped with a flat standing `flat` inside the circle at +x."""
    opening = circle(d)
    if key_width > 0:
        reach = d / 2 + key_depth
        opening += rectangle(reach, key_width).translate((reach / 2, 0))
    if flat > 0:
        opening ^= rectangle(d - flat, d).translate((-flat / 2, 0))
    return opening


def gear(teeth: int, module_mm: float, flank_points: int = 4) -> CrossSection:
    """A spur gear: pitch diameter teeth * module, involute flanks, the middle of one tooth on +x."""
    pitch, alpha = teeth * module_mm / 2, np.deg2rad(PRESSURE_ANGLE_DEG)
    base, tip, root = pitch * cosine(alpha), pitch + module_mm, pitch - 1.25 * module_mm
    radii = np.linspace(max(base, root), tip, flank_points)
    inverse_cos = np.arccos(np.clip(base / radii, -1, 1))
    half = np.pi / (2 * teeth) + (tangent(alpha) - alpha) - (tangent(inverse_cos) - inverse_cos)
    half = np.maximum(half, 0.1 / radii)  # a tooth never ends in a point
    if root < base:
        radii, half = np.append(root, radii), np.append(half[0], half)
    angles = np.concatenate([-half, half[::-1]])
    reach = np.concatenate([radii, radii[::-1]])
    around = np.arange(teeth)[:, None] * 2 * np.pi / teeth + angles
    loop = np.stack([reach * cosine(around), reach * sine(around)], axis=-1)
    return polygon(loop.reshape(-1, 2))


def bearing(x: float, y: float) -> float:
    """[deg] from +x to a point, rounded: the last bits of an arctangent differ between processors."""
    return round(float(np.degrees(np.arctan2(y, x))), BEARING_DECIMALS)


def bolt_circle(d: float, n: int, start_deg: float = 0.0) -> list[tuple[float, float]]:
    """n points evenly on a circle of diameter d, the first at `start_deg`."""
    angles = np.deg2rad(start_deg) + np.arange(n) * 2 * np.pi / n
    return [(float(d / 2 * cosine(a)), float(d / 2 * sine(a))) for a in angles]


def grid(nx: int, ny: int, pitch_x: float, pitch_y: float) -> list[tuple[float, float]]:
    """nx by ny points, centred on the origin."""
    xs = (np.arange(nx) - (nx - 1) / 2) * pitch_x
    ys = (np.arange(ny) - (ny - 1) / 2) * pitch_y
    return [(float(x), float(y)) for y in ys for x in xs]


def holes(d: float, points: Sequence[tuple[float, float]]) -> CrossSection:
    """Discs of diameter d at the points, to be cut out of a profile; each is rotated to face the origin,
    so that a bolt circle keeps its symmetry exactly."""
    disc = circle(d)
    rotated = [disc.rotate(bearing(x, y)).translate((x, y)) for x, y in points]
    return CrossSection.compose(rotated) if rotated else CrossSection()


# --- solids -----------------------------------------------------------------------------------------------------


def prism(
    profile: CrossSection,
    height: float,
    chamfer: float = 0.0,
    chamfer_top: float | None = None,
    chamfer_bottom: float | None = None,
) -> Manifold:
    """The profile extruded up from z = 0, its rims (those of holes too) chamfered at 45 degrees.

    A chamfer too large for the profile (a narrow wall, a tight corner radius) is reduced until it fits.
    """
    top = chamfer if chamfer_top is None else chamfer_top
    bottom = chamfer if chamfer_bottom is None else chamfer_bottom
    if max(top, bottom) <= 0:
        return profile.extrude(height)
    contours = profile.simplify(1e-4).to_polygons()
    bottom = _feasible_inset(contours, min(bottom, 0.45 * height))
    top = _feasible_inset(contours, min(top, 0.45 * height))
    layers = [(0.0, bottom), (bottom, 0.0)] if bottom > 0 else [(0.0, 0.0)]
    layers += [(height - top, 0.0), (height, top)] if top > 0 else [(height, 0.0)]
    return _lofted([_inset(contours, inset) for _, inset in layers], [z for z, _ in layers])


def revolved(points: ArrayLike) -> Manifold:
    """The solid of revolution of a closed loop of points (n, 2) as (radius, z) about the z axis."""
    loop = np.asarray(points, dtype=np.float64)
    return polygon(loop).revolve(circle_segments(float(loop[:, 0].max())))


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


def gusset(x: float, z: float, thickness: float) -> Manifold:
    """A triangular stiffening rib in the xz plane: its right angle at the origin, legs along +x and +z."""
    return at(along(prism(polygon([(0, 0), (x, 0), (0, z)]), thickness), "-y"), y=thickness / 2)


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
    n = len(rings[0])
    start = np.cumsum([0, *map(len, layers[0])])
    next_corner = np.concatenate([np.roll(np.arange(a, b), -1) for a, b in pairwise(start)])
    here = np.arange(n)
    wall = np.concatenate(
        [np.stack([here, next_corner, next_corner + n], axis=1), np.stack([here, next_corner + n, here + n], axis=1)]
    )
    walls = [wall + k * n for k in range(len(rings) - 1)]
    bottom = np.asarray(triangulate(layers[0]))[:, ::-1]
    top = np.asarray(triangulate(layers[-1])) + (len(rings) - 1) * n
    faces = np.concatenate([bottom, *walls, top])
    solid = Manifold(Mesh64(np.vstack(rings), faces.astype(np.uint64)))
    if solid.status() != Error.NoError:
        raise ValueError(f"contours do not close into a solid: {solid.status().name}")
    return solid
