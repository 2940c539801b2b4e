"""Where a suction cup seals on the seen top of a part, and whether it then holds on the true one.

The cup comes down vertically. At a candidate point a disc a little wider than the cup is laid on the surface: it must
be wholly on the part, flat, and nearly level. The best candidate has much margin to the rim and little lever arm to the
part's middle. The robot has cups of three sizes and takes the largest that seals. The paper's gripper has one of 45 mm;
no part here has so wide a flat top.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from kit1000.mesh import Mesh
from kit1000.numerics.linear_algebra import matmul
from kit1000.numerics.trigonometry import cosine, sine, tangent
from kit1000.planner.robot import CUPS
from kit1000.pose import Pose
from kit1000.values import FIRST_PART_LABEL, LabelledDepth

SUCTION = 70e3  # [Pa] below the air's pressure
HOLD = 1.5  # times the weight of the part, at least: the arm accelerates by a hundredth of gravity
RIM = 0.5e-3  # [m] of flat surface beyond the cup
NOZZLE_ROOM = 3e-3  # [m] about the cup, where nothing may rise above the surface: the nozzle is as wide as the cup
FLATNESS = 0.5e-3  # [m] by which the lip of the cup bends
MAX_TILT = np.radians(8)  # of the surface: the bellows bend no farther
TRUE_TILT = np.radians(10)  # the same on the true surface under the cup: the image is not exact
CANDIDATE_SPACING = 2e-3  # [m]
WIDER_RINGS = np.array([1e-3, 1.5e-3, 2e-3, 3e-3, 5e-3])  # [m] beyond the cup: radii of samples that give the margin
MARGIN_WEIGHT = 5.0  # of a margin against a lever arm: a leak loses the part, a lever arm only lets it swing
SPOKES = 16
MAX_GRASPS = 8  # candidates of a cup that are tried before a part is given up
APART = 4e-3  # [m] between them


@dataclass(frozen=True, eq=False)
class Grasp:
    """A point where the cup seems to seal."""

    point: np.ndarray  # (3,) [m] world, on the seen surface
    cup: float  # [m] radius
    margin: float  # [m] of flat surface beyond the cup
    lever: float  # [m] level distance to the middle of what is seen

    @property
    def score(self) -> float:
        """[m] the larger the better."""
        return MARGIN_WEIGHT * self.margin - self.lever


def find_grasps(image: LabelledDepth, part: int, flatness: float = FLATNESS) -> list[Grasp]:
    """The best grasps of a part, larger cups first, then best first, at most MAX_GRASPS a cup; none if none seals.

    image: as seen. part: index of the part. flatness: [m] that seen heights may deviate from a plane.
    """
    return [grasp for grasps in _grasps_by_cup(image, part, flatness) for grasp in grasps]


def best_grasp(image: LabelledDepth, part: int, flatness: float = FLATNESS) -> Grasp | None:
    """The first grasp of `find_grasps`; None if no cup seals."""
    return next((grasps[0] for grasps in _grasps_by_cup(image, part, flatness) if grasps), None)


def _grasps_by_cup(image: LabelledDepth, part: int, flatness: float) -> Iterator[list[Grasp]]:
    """The grasps of each cup, larger cups first."""
    view, mask = image.view, image.labels == FIRST_PART_LABEL + part
    rows, columns = np.nonzero(mask & (view.depth > 0))
    if len(rows) == 0:
        return
    pixels = np.stack([columns, rows], axis=-1)
    points = view.world_from_camera.apply(view.camera.unproject_pixels(pixels, view.depth[rows, columns]))
    middle = (points[:, :2].min(0) + points[:, :2].max(0)) / 2
    _, first = np.unique(np.round(points / CANDIDATE_SPACING).astype(np.int64), axis=0, return_index=True)
    candidates = points[np.sort(first)]
    for cup in CUPS:
        yield _grasps_of_cup(image, mask, candidates, middle, cup, flatness)


def _grasps_of_cup(
    image: LabelledDepth, mask: np.ndarray, candidates: np.ndarray, middle: np.ndarray, cup: float, flatness: float
) -> list[Grasp]:
    """The best grasps of one cup among candidate points (n, 3) [m], best first, APART from each other."""
    margins, heights = _margins(image, mask, candidates, cup, flatness)
    grasps = [
        Grasp(np.array([*xyz[:2], height]), cup, float(margin), float(np.hypot(*(xyz[:2] - middle))))
        for xyz, margin, height in zip(candidates, margins, heights, strict=True)
        if np.isfinite(margin)
    ]
    chosen: list[Grasp] = []
    for grasp in sorted(grasps, key=lambda grasp: (-round(grasp.score, 6), *np.round(grasp.point, 6))):
        if all(np.hypot(*(grasp.point - other.point)[:2]) >= APART for other in chosen):
            chosen.append(grasp)
        if len(chosen) == MAX_GRASPS:
            break
    return chosen


def _margins(
    image: LabelledDepth, mask: np.ndarray, candidates: np.ndarray, cup: float, flatness: float
) -> tuple[np.ndarray, np.ndarray]:
    """Margin [m] of each candidate (n, 3), NaN if the cup does not seal, and the height [m] of its plane there."""
    offsets, radii = _disc((cup / 2, cup, cup + RIM, *(cup + WIDER_RINGS)))
    under = radii <= cup + RIM
    level = np.concatenate([np.zeros((len(candidates), 2)), candidates[:, 2:]], axis=1)
    _, seen, _ = _laid_on(image, mask, candidates, offsets, level)
    slopes = _fit_planes(seen[:, under] - candidates[:, None] * (1, 1, 0))
    slopes[:, :2] = np.clip(slopes[:, :2], -tangent(MAX_TILT), tangent(MAX_TILT))
    samples, seen, on_part = _laid_on(image, mask, candidates, offsets, slopes)  # now along the surface
    slopes = _fit_planes(seen[:, under] - candidates[:, None] * (1, 1, 0))
    across = seen[..., :2] - candidates[:, None, :2]
    rise = seen[..., 2] - np.einsum("nki,ni->nk", across, slopes[:, :2]) - slopes[:, 2, None]
    deviation = np.abs(rise)
    aside = np.hypot(*np.moveaxis(seen - samples, -1, 0)[:2])  # what is seen there may lie behind, or in front
    flat = on_part & (deviation <= flatness) & (aside <= flatness + RIM)
    walls = on_part & (rise > flatness + RIM) & (radii <= cup + NOZZLE_ROOM)
    seals = flat[:, under].all(1) & ~walls.any(1) & (np.hypot(slopes[:, 0], slopes[:, 1]) <= tangent(MAX_TILT))
    margin = np.full(len(candidates), RIM)
    wide = np.ones(len(candidates), bool)
    for wider in WIDER_RINGS:
        wide &= flat[:, radii == cup + wider].all(1)
        margin = np.where(wide, wider, margin)
    return np.where(seals, margin, np.nan), slopes[:, 2]


def _laid_on(
    image: LabelledDepth, mask: np.ndarray, candidates: np.ndarray, offsets: np.ndarray, planes: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Samples (n, k, 3) [m] at level offsets (k, 2) from candidates (n, 3), on planes (n, 3) as of `_fit_planes` about
    them; what is seen there; and whether that is on the part."""
    samples = np.empty((len(candidates), len(offsets), 3))
    samples[..., :2] = candidates[:, None, :2] + offsets
    samples[..., 2] = matmul(planes[:, :2], offsets.T) + planes[:, 2, None]
    return samples, *_seen_points(image, mask, samples)


def _disc(rings: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Level offsets (k, 2) [m] of samples about a point, its own and those on rings, and their radii (k,) [m]."""
    angles = 2 * np.pi * np.arange(SPOKES) / SPOKES
    spokes = np.column_stack([cosine(angles), sine(angles)])
    offsets = np.concatenate([np.zeros((1, 2)), *(radius * spokes for radius in rings)])
    return offsets, np.concatenate([[0.0], *(np.full(SPOKES, radius) for radius in rings)])


def _seen_points(image: LabelledDepth, mask: np.ndarray, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The points (..., 3) [m] seen where samples (..., 3) [m] appear in the image, and whether they are on the part."""
    view = image.view
    uv = view.camera.project(view.world_from_camera.inverse().apply(samples))
    pixels = np.where(np.isfinite(uv), np.rint(uv), -1).astype(np.int64)
    limits = np.array([view.camera.width, view.camera.height])
    inside = ((pixels >= 0) & (pixels < limits)).all(-1)
    u, v = np.moveaxis(np.clip(pixels, 0, limits - 1), -1, 0)
    on_part = inside & mask[v, u] & (view.depth[v, u] > 0)
    depth = np.where(on_part, view.depth[v, u], 1.0)
    # the pixel's depth on the sample's own ray: rounding to pixels moves no sample sideways
    ray = view.camera.unproject_pixels(np.where(np.isfinite(uv), uv, 0.0), depth)
    return view.world_from_camera.apply(ray), on_part


def _fit_planes(points: np.ndarray) -> np.ndarray:
    """(n, 3) slopes along x and y, and height at x = y = 0, of the least-squares planes of points (n, k, 3)."""
    mean = points.mean(1)
    x, y, z = np.moveaxis(points - mean[:, None], -1, 0)
    xx, yy, xy, xz, yz = ((a * b).sum(1) for a, b in ((x, x), (y, y), (x, y), (x, z), (y, z)))
    area = np.maximum(xx * yy - xy * xy, 1e-30)
    slope_x, slope_y = (xz * yy - yz * xy) / area, (yz * xx - xz * xy) / area
    return np.stack([slope_x, slope_y, mean[:, 2] - slope_x * mean[:, 0] - slope_y * mean[:, 1]], axis=1)


def is_held(grasp: Grasp, weight: float) -> bool:
    """Whether the cup of a grasp carries a weight [N], with HOLD to spare."""
    return np.pi * grasp.cup**2 * SUCTION >= HOLD * weight


def touch(mesh: Mesh, world_from_part: Pose, grasp: Grasp) -> float | None:
    """The height [m] at which the cup, coming down at a grasp, seals on the true part; None if it leaks."""
    point = grasp.point
    spots = point[:2] + _disc((grasp.cup / 2, grasp.cup))[0]
    heights = top_heights(mesh.moved(world_from_part), spots)
    if not np.isfinite(heights).all():
        return None
    found = np.concatenate([spots - point[:2], heights[:, None]], axis=1)
    slope_x, slope_y, height = _fit_planes(found[None])[0]
    deviation = found[:, 2] - found[:, 0] * slope_x - found[:, 1] * slope_y - height
    if np.abs(deviation).max() > FLATNESS or np.hypot(slope_x, slope_y) > tangent(TRUE_TILT):
        return None
    return float(height)


def top_heights(mesh: Mesh, spots: np.ndarray) -> np.ndarray:
    """(n,) [m] the highest point of a mesh above each level spot (n, 2) [m]; -inf beside it."""
    corners = mesh.triangles[mesh.normals[:, 2] > 0]
    low, high = corners[..., :2].min(1), corners[..., :2].max(1)
    corners = corners[((low <= spots.max(0)) & (high >= spots.min(0))).all(1)]
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, ac, ap = (b - a)[:, :2], (c - a)[:, :2], spots[:, None] - a[:, :2]
    area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    v = (ap[..., 0] * ac[:, 1] - ap[..., 1] * ac[:, 0]) / area
    w = (ab[:, 0] * ap[..., 1] - ab[:, 1] * ap[..., 0]) / area
    inside = (v >= 0) & (w >= 0) & (v + w <= 1)
    z = a[:, 2] + v * (b - a)[:, 2] + w * (c - a)[:, 2]
    return np.where(inside, z, -np.inf).max(1, initial=-np.inf)
