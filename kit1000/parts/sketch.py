"""Profiles and random choices: the two-dimensional functions for drawing part families, in MILLIMETRES and degrees.

Every profile is a `manifold3d.CrossSection` in the xy plane, centred on the origin unless its docstring says otherwise.
Combine profiles with `+` (join), `-` (cut) and `^` (common area); place them with `.translate((x, y))`, `.rotate(deg)`.
Circles have a multiple of four vertices, all on the circle, so axis-aligned symmetry is exact.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from manifold3d import CrossSection, FillRule, JoinType
from numpy.typing import ArrayLike, NDArray

from kit1000.numerics.trigonometry import cosine, sine, tangent

SAGITTA_MM = 0.013
"""Largest distance between an arc and its chords as drawn: below 0.02 mm also when a small drawing is scaled by 1.5."""
BEARING_DECIMALS = 9  # [deg]
PRESSURE_ANGLE_DEG = 20.0
"""Pressure angle of the involute gears, the usual one of machine design (ISO 53)."""

Choice = TypeVar("Choice")


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
