"""A kit as convex pieces that leave its cavity open, for physics engines that take the hull of every mesh.

The plate is cut into level layers, which are thin if the walls slope. A layer keeps only what is solid over its whole
height, so pieces never reach into the cavity: the errors of steps and chords all enlarge it. The kept section is
triangulated, merged into convex polygons (Hertel and Mehlhorn 1983) and extruded to prisms. Kit frame, metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from manifold3d import CrossSection, FillRule, JoinType, Manifold, triangulate

from kit1000.mesh import Mesh, convex_hull, mesh_from_solid, solid_from_mesh
from kit1000.numerics.linear_algebra import length, matmul
from kit1000.values import Kit

TOLERANCE = 0.4e-3  # [m] by which walls recede at most, roughly; the clearance is 2.5 mm
MAX_LAYERS = 12  # reached by round bottoms, whose steps are then one or two millimetres high
MAX_PART_LAYERS = 24  # of a part, which is higher than its cavity
LEDGE_OFFSET = 1e-6  # [m] from the top of a layer to the ledge above it: keeps corners rounded to float32 above
MIN_LEDGE_AREA = 1e-6  # [m^2] smaller level faces count as slopes
LEDGE_SPACING = 20e-6  # [m] ledges closer than this count as one
GRID = 1e-8  # [m] sections snap to a grid of some 4 nm
MIN_POLYGON_AREA = 1e-8  # [m^2] smaller polygons are dropped: engines refuse such slivers
REACH = 5e-3  # [m] by which overlapping prisms extend below others
MITER_LIMIT = 2.0  # offset corners sharper than 60 degrees are cut off


def convex_prisms(kit: Kit, tolerance: float = TOLERANCE) -> list[Mesh]:
    """Disjoint convex prisms inside a kit, the floor slab first; walls recede by about `tolerance` [m] at most."""
    low, high = kit.mesh.bounds
    block = Manifold.cube(high - low).translate(low)
    cavity = block - solid_from_mesh(kit.mesh)
    floor = cavity.bounding_box()[2]
    pieces = [block.trim_by_plane((0, 0, -1), -floor)]
    plate = CrossSection.square(high[:2] - low[:2] - 2 * GRID).translate(low[:2] + GRID)
    for layer in _layers(cavity, floor, float(high[2]), tolerance):
        kept = plate - _outer_outline(layer.shadow, tolerance / 2)
        pieces += [convex_hull(_prism_corners(polygon, layer.low, layer.high)) for polygon in convex_polygons(kept)]
    return [mesh_from_solid(piece) for piece in pieces]


def overlapping_prisms(kit: Kit, tolerance: float = TOLERANCE) -> list[np.ndarray]:
    """Corners (n, 3) [m] of fewer convex prisms, all of which stand on the plate's underside and may overlap.

    Upright walls protrude by about `tolerance` [m] at most, so what touches a prism is inside the cavity.
    """
    low, high = kit.mesh.bounds
    cavity = Manifold.cube(high - low).translate(low) - solid_from_mesh(kit.mesh)
    floor = cavity.bounding_box()[2]
    plate = CrossSection.square(high[:2] - low[:2]).translate(low[:2])
    sections = [(floor, plate)]
    for layer in _layers(cavity, floor, float(high[2]), tolerance):
        sections.append((layer.high, plate - _inner_outline(layer.shadow, tolerance)))
    covered, prisms = CrossSection(), []
    for top, section in sorted(sections, key=lambda pair: -pair[0]):
        new = (section - covered).offset(-tolerance / 4, JoinType.Miter, MITER_LIMIT)
        near = new.offset(REACH, JoinType.Miter, MITER_LIMIT) ^ section
        for polygon in convex_polygons(near):
            if not (CrossSection([polygon]) ^ new).is_empty():
                prisms.append(_prism_corners(polygon, float(low[2]), top))
        covered += near
    return prisms


def enclosing_prisms(mesh: Mesh, tolerance: float = TOLERANCE, fine_height: float = np.inf) -> list[np.ndarray]:
    """Corners (n, 3) [m] of convex prisms along z that contain a closed mesh and exceed it by about `tolerance` [m].

    Unlike a general convex decomposition they take milliseconds; a slope of the mesh is a stair, whose steps are coarse
    from `fine_height` [m] above the lowest point on.
    """
    solid = solid_from_mesh(mesh)
    low, high = map(float, mesh.bounds[:, 2])
    return [
        _prism_corners(polygon, layer.low, layer.high)
        for layer in _layers(solid, low, high, tolerance, MAX_PART_LAYERS, 2 * LEDGE_OFFSET, low + fine_height)
        for polygon in convex_polygons(_outer_outline(layer.shadow, tolerance / 2))
    ]


def convex_polygons(section: CrossSection) -> list[np.ndarray]:
    """A section cut into convex polygons (n, 2), counter-clockwise: triangles merged, longest sides first."""
    contours = section.to_polygons()
    if not contours:
        return []
    corners = np.concatenate(contours)
    polygons = {i: list(triangle) for i, triangle in enumerate(triangulate(contours).tolist())}
    owner = {(a, b): i for i, loop in polygons.items() for a, b in _edges(loop)}
    shared = [(a, b) for a, b in owner if a < b and (b, a) in owner]
    shared.sort(key=lambda side: -length(corners[side[0]] - corners[side[1]]))
    for a, b in shared:
        left, right = owner[a, b], owner[b, a]
        merged = _merged(polygons[left], polygons[right], a, b)
        if left != right and _is_convex_at(corners, merged, a) and _is_convex_at(corners, merged, b):
            del polygons[right]
            polygons[left] = merged
            owner.update(dict.fromkeys(_edges(merged), left))
    return [corners[loop] for loop in polygons.values() if _area(corners[loop]) > MIN_POLYGON_AREA]


@dataclass(frozen=True, eq=False)
class _Layer:
    """A layer of the plate between two heights [m]."""

    low: float
    high: float
    shadow: CrossSection  # projection along z of the cavity within the layer
    lost_volume: float  # [m^3] of wall inside the shadow, which the pieces leave out

    @property
    def recession(self) -> float:
        """[m] by which the layer's walls recede on average."""
        perimeter = sum(np.linalg.norm(np.roll(p, -1, 0) - p, axis=1).sum() for p in self.shadow.to_polygons())
        return self.lost_volume / (self.high - self.low) / max(perimeter, 1e-9)


def _layers(
    cavity: Manifold,
    floor: float,
    rim: float,
    tolerance: float,
    most: int = MAX_LAYERS,
    inset: float = 0.0,
    fine_below: float = np.inf,
) -> list[_Layer]:
    """Layers from floor to rim, cut at every ledge; then the layer that loses most is halved until none loses much.

    Args:
        cavity: the solid to cut, between the heights floor and rim [m].
        tolerance: [m] of recession.
        most: number of layers up to which they are halved.
        inset: [m] at the bottom of every layer that does not count for its shadow: the tops of what stands below it.
        fine_below: [m] height from which on layers are not halved.
    """
    heights = [floor, *_ledges(cavity, floor, rim), rim]
    layers = [_layer(cavity, a, b, inset) for a, b in pairwise(heights)]
    while len(layers) < most:
        # a quarter, because the mean hides how far a slope recedes beside upright walls
        coarse = [layer for layer in layers if layer.low < fine_below and layer.recession > tolerance / 4]
        if not coarse:
            break
        worst = max(coarse, key=lambda layer: layer.lost_volume)
        middle = (worst.low + worst.high) / 2
        layers.remove(worst)
        layers += [_layer(cavity, worst.low, middle, inset), _layer(cavity, middle, worst.high, inset)]
    return layers


def _layer(cavity: Manifold, low: float, high: float, inset: float) -> _Layer:
    open_ = cavity.trim_by_plane((0, 0, 1), low + inset).trim_by_plane((0, 0, -1), -high)
    shadow = CrossSection(open_.project().to_polygons(), FillRule.Positive)
    return _Layer(low, high, shadow, shadow.area() * (high - low) - open_.volume())


def _ledges(cavity: Manifold, floor: float, rim: float) -> list[float]:
    """Heights just below the level faces between floor and rim."""
    mesh = mesh_from_solid(cavity)
    z = mesh.triangles[..., 2]
    edges = mesh.triangles[:, 1:] - mesh.triangles[:, :1]
    areas = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) / 2
    level = (np.ptp(z, axis=1) < LEDGE_OFFSET) & (z.min(1) > floor + LEDGE_SPACING) & (z.min(1) < rim - LEDGE_SPACING)
    order = np.argsort(z[level].min(1))
    heights, areas = z[level].min(1)[order], areas[level][order]
    groups = np.split(np.arange(len(heights)), np.flatnonzero(np.diff(heights) > LEDGE_SPACING) + 1)
    return [float(heights[group[0]]) - LEDGE_OFFSET for group in groups if areas[group].sum() > MIN_LEDGE_AREA]


def _outer_outline(shadow: CrossSection, tolerance: float) -> CrossSection:
    """A polygon of few corners that contains a shadow and exceeds it by about 2 tolerances [m] at most."""
    # slots narrower than the tolerance may have collapsed, so the shadow itself is added
    return _few_corners(shadow, tolerance).offset(tolerance + GRID, JoinType.Miter, MITER_LIMIT) + shadow


def _inner_outline(shadow: CrossSection, tolerance: float) -> CrossSection:
    """An area inside a shadow, which exceeds it by a tolerance [m] at most and has few corners at hollow walls.

    At bulging walls, which are convex pieces, it has all corners.
    """
    return _few_corners(shadow, tolerance) ^ shadow.simplify(tolerance / 10)


def _few_corners(shadow: CrossSection, tolerance: float) -> CrossSection:
    """A shadow simplified to a tolerance [m]."""
    few = [contour[_simplified_indices(contour, tolerance)] for contour in shadow.to_polygons()]
    return CrossSection([contour for contour in few if len(contour) > 2], FillRule.Positive)


def _simplified_indices(contour: np.ndarray, tolerance: float) -> np.ndarray:
    """Indices of the corners of a closed contour (n, 2) simplified to a tolerance [m] (Douglas and Peucker 1973)."""
    far = int(np.argmax(np.linalg.norm(contour - contour[0], axis=1)))
    closed, kept, spans = np.concatenate([contour, contour[:1]]), {0, far}, [(0, far), (far, len(contour))]
    while spans:
        start, end = spans.pop()
        if end - start < 2:
            continue
        distance = _distance(closed[start + 1 : end], closed[start], closed[end])
        worst = int(np.argmax(distance))
        if distance[worst] > tolerance:
            middle = start + 1 + worst
            kept.add(middle)
            spans += [(start, middle), (middle, end)]
    return np.array(sorted(kept))


def _distance(points: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(n,) [m] from points (n, 2) to the segment from a to b."""
    along = b - a
    share = np.clip(matmul(points - a, along) / max(float(matmul(along, along)), 1e-30), 0, 1)
    return np.linalg.norm(points - a - share[:, None] * along, axis=1)


def _area(polygon: np.ndarray) -> float:
    """[m^2] of a polygon (n, 2), positive when it runs counter-clockwise."""
    x, y = polygon.T
    return float(matmul(x, np.roll(y, -1)) - matmul(y, np.roll(x, -1))) / 2


def _prism_corners(polygon: np.ndarray, low: float, high: float) -> np.ndarray:
    return np.concatenate([np.column_stack([polygon, np.full(len(polygon), z)]) for z in (low, high)])


def _edges(loop: list[int]) -> list[tuple[int, int]]:
    return list(zip(loop, loop[1:] + loop[:1], strict=True))


def _merged(left: list[int], right: list[int], a: int, b: int) -> list[int]:
    """Two loops without their common side, a to b in the left one."""
    i, j = left.index(b), right.index(a)
    return left[i:] + left[:i] + (right[j:] + right[:j])[1:-1]


def _is_convex_at(corners: np.ndarray, loop: list[int], vertex: int) -> bool:
    """Whether a counter-clockwise loop is convex at a vertex."""
    i = loop.index(vertex)
    before, here, after = corners[[loop[i - 1], vertex, loop[(i + 1) % len(loop)]]]
    (ax, ay), (bx, by) = here - before, after - here
    return bool(ax * by - ay * bx >= 0)
