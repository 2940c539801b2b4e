"""The table: the plane that most of the image's middle lies on, found at random in inverse depth, then fitted.

On a plane, inverse depth is linear in the image and noise of a stereo camera is the same everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import binary_opening, label
from scipy.spatial import ConvexHull, QhullError

from kit1000.camera import Camera
from kit1000.capture.pinhole_images import PinholeImage
from kit1000.errors import InputError
from kit1000.perception.calibration.table import TUKEY, tukey_weights
from kit1000.rng import stream

STEP = 6  # [px] between pixels that vote
TRIPLES = 600  # planes that are tried
SPAN = 0.25  # [rad] about, between the rays of a triple
TOLERANCE = 8e-3 / 0.7**2  # [1/m] in inverse depth: 8 mm at 0.7 m
MIDDLE = 0.45  # [half sides] standard deviation of the weight about the image's middle
EVERYWHERE = 0.3  # weight that all pixels share evenly, added to that
FINALISTS = 12  # planes that are fitted before the last vote
APART = 0.5  # share of a finalist's votes that come from pixels of no earlier finalist, at least
TALLEST = 0.2  # [m] of bodies: a plane that lies less above another one may be a face of a body on it
LOWER_VOTES = 0.4  # share of the upper plane's votes that the lower one must have
BELOW = 0.9  # share of each plane's pixels that must lie on its side of the other
BETWEEN = 4  # pixels of a plane on either side of one that the plane would hide
STEEPEST = np.sin(np.radians(14))  # of the angle between ray and plane: planes seen flatter are walls or seams
LEAST_SHARE = 0.08  # of the pixels with a return, on the table
ROUNDS = 12  # of reweighting
SINKING = 2.5  # [spreads] instead of TUKEY, for pixels above the plane in the first rounds
LEAST_SPREAD = 1e-5  # [1/m]
SURE_TABLE = 3.0  # [spreads] from the plane, of pixels that are the table's
OPENED = 5  # [px] side of the squares of which the table's regions consist
PIECE = 0.03  # of the largest region's pixels, of regions that count
LEAST_BENT = 500  # pixels that show how the table is bent
MOST_BEND = 4.0  # [spreads]
NEAREST_PLANE = 0.1  # [m] from the camera


@dataclass(frozen=True, eq=False)
class Table:
    """The table's plane as an image shows it."""

    image: PinholeImage
    coefficients: np.ndarray  # (3,) [1/m]: their product with the ray of a pixel, of depth 1, is its inverse depth
    spread: float  # [1/m] robust standard deviation of the inverse depths of its pixels: noise and bending

    @property
    def distance(self) -> float:
        """[m] from the camera to the plane."""
        return float(1 / np.sqrt(self.coefficients @ self.coefficients))

    @property
    def up(self) -> np.ndarray:
        """(3,) unit normal in the camera frame, towards the camera."""
        return -self.coefficients * self.distance

    @cached_property
    def heights(self) -> np.ndarray:
        """(H, W) [m] of each pixel's point above the plane; NaN without a return."""
        depth, expected = self.image.depth, inverse_depths(self.image.camera, self.coefficients)
        return np.where(depth > 0, (1 - expected * depth) * self.distance, np.nan)

    @cached_property
    def mask(self) -> np.ndarray:
        """(H, W) bool: pixels that show the table."""
        depth = self.image.depth
        residuals = np.where(depth > 0, 1 / np.where(depth > 0, depth, 1), np.inf)
        return np.abs(residuals - inverse_depths(self.image.camera, self.coefficients)) < SURE_TABLE * self.spread

    @cached_property
    def solid_mask(self) -> np.ndarray:
        """(H, W) bool: those of `mask` that are no single pixels."""
        return np.asarray(binary_opening(self.mask, np.ones((OPENED, OPENED))), bool)

    @property
    def share(self) -> float:
        """Share of the image that the table fills."""
        return float(self.mask.mean())

    @property
    def share_of_returns(self) -> float:
        """Share of the pixels with a return that lie on the table."""
        return float(np.count_nonzero(self.solid_mask) / max(np.count_nonzero(self.image.depth), 1))

    @property
    def ripple(self) -> float:
        """[m] robust standard deviation of the table's heights, without its bending over the whole image."""
        heights = self.flat_heights[self.mask]
        return 1.4826 * float(np.median(np.abs(heights - np.median(heights)))) if len(heights) else 0.0

    @property
    def tilt_deg(self) -> float:
        """Angle between the optical axis and the line straight down."""
        return float(np.degrees(np.arccos(np.clip(-self.up[2], -1, 1))))

    @cached_property
    def axes(self) -> np.ndarray:
        """(3, 3) rows x, y, z in the camera frame: z up, x as far as may be along the image's rows."""
        x = np.array([1.0, 0.0, 0.0]) - self.up[0] * self.up
        x = x / np.sqrt(x @ x)
        return np.stack([x, np.cross(self.up, x), self.up])

    def ground(self, mask: np.ndarray) -> np.ndarray:
        """(n, 2) [m] along `axes`: the feet of the points of a mask (H, W) bool."""
        v, u = np.nonzero(mask & (self.image.depth > 0))
        points = self.image.camera.unproject_pixels(np.stack([u, v], -1), self.image.depth[v, u])
        return points @ self.axes[:2].T

    @cached_property
    def outline(self) -> np.ndarray:
        """(k, 2) [m] along `axes`: convex, counter-clockwise, about the regions of the image that show the table."""
        regions, _ = label(self.solid_mask)  # type: ignore[misc]
        counts = np.bincount(regions.ravel())
        counts[0] = 0
        return convex_outline(self.ground(np.isin(regions, np.flatnonzero(counts > PIECE * counts.max()))))

    @cached_property
    def bend(self) -> np.ndarray:
        """(H, W) [1/m] by which inverse depths of the table differ from the plane's: a quadratic of the image."""
        camera = self.image.camera
        v, u = (axis[self.mask[::STEP, ::STEP]] for axis in np.mgrid[: camera.height : STEP, : camera.width : STEP])
        if len(u) < LEAST_BENT:
            return np.zeros(self.mask.shape)
        residuals = 1 / self.image.depth[v, u] - inverse_depths(camera, self.coefficients)[v, u]
        terms = _quadratic(2 * u / camera.width - 1, 2 * v / camera.height - 1)
        weights, solution = np.ones(len(u)), np.zeros(terms.shape[1])
        for _ in range(ROUNDS):
            weighted = terms * weights[:, None]
            solution = np.linalg.solve(weighted.T @ terms + 1e-3 * np.eye(len(solution)), weighted.T @ residuals)
            left = residuals - terms @ solution
            spread = max(1.4826 * float(np.median(np.abs(left))), 1e-6)
            weights = tukey_weights(left, TUKEY * spread)
        rows = [_quadratic(2 * np.arange(camera.width) / camera.width - 1, 2 * y / camera.height - 1) @ solution
                for y in range(camera.height)]  # fmt: skip
        return np.clip(np.stack(rows), -MOST_BEND * self.spread, MOST_BEND * self.spread)

    @cached_property
    def flat_heights(self) -> np.ndarray:
        """(H, W) [m] of each pixel's point above the table as it was seen, bent; NaN without a return."""
        depth = self.image.depth
        expected = inverse_depths(self.image.camera, self.coefficients) + self.bend
        return np.where(depth > 0, (1 - expected * depth) * self.distance, np.nan)


def _quadratic(x: np.ndarray, y: np.ndarray | float) -> np.ndarray:
    """(n, 6) the terms of a quadratic of two coordinates (n,), or (n,) and one number."""
    return np.stack([x**i * y**j + 0 * x for i in range(3) for j in range(3 - i)], axis=-1)


def find_table(image: PinholeImage, source: str) -> Table:
    """The table of an image. Raises InputError if the largest plane is too small; source: for messages."""
    camera, depth = image.camera, image.depth
    rows, columns = np.arange(STEP // 2, camera.height, STEP), np.arange(STEP // 2, camera.width, STEP)
    grid = depth[np.ix_(rows, columns)].astype(float)
    v, u = np.meshgrid(rows, columns, indexing="ij")
    rays = camera.unproject_pixels(np.stack([u, v], -1).astype(float), np.ones(grid.shape))
    seen = grid > 0
    if not seen.any():
        raise InputError(f"{source}: hardly any pixel has a depth: is it a depth image?")
    inverse = np.where(seen, 1 / np.where(seen, grid, 1), 0)
    weights = np.where(seen, _middle_weights(u, v, camera), 0)
    planes = _random_planes(rays, inverse, seen, camera)
    best = _best_plane(planes, rays, inverse, weights)
    if best is None:
        raise InputError(f"{source}: no plane is seen from above: is the table in view?")
    coefficients, spread = _fitted(rays[seen], inverse[seen], best)
    table = Table(image, coefficients, spread)
    if table.share_of_returns < LEAST_SHARE or not _plausible(coefficients):
        raise InputError(
            f"{source}: the largest plane holds {100 * table.share_of_returns:.0f} % of the image, expected "
            f"{100 * LEAST_SHARE:.0f} or more: is the table in view?"
        )
    return table


def inverse_depths(camera: Camera, coefficients: np.ndarray) -> np.ndarray:
    """(H, W) [1/m] of a plane with coefficients (3,), see `Table`."""
    across = (np.arange(camera.width) - camera.cx) / camera.fx * coefficients[0]
    down = (np.arange(camera.height) - camera.cy) / camera.fy * coefficients[1]
    return across + down[:, None] + coefficients[2]


def convex_outline(points: np.ndarray) -> np.ndarray:
    """(k, 2) the corners of points (n, 2) [m], counter-clockwise; none of points on a line."""
    try:
        return points[ConvexHull(points).vertices]
    except (QhullError, ValueError):
        return np.zeros((0, 2))


def inside_outline(points: np.ndarray, outline: np.ndarray, margin: float) -> np.ndarray:
    """(n,) bool: points (n, 2) [m] inside a convex outline (k, 2), at least a margin [m] from its edges."""
    inside = np.full(len(points), len(outline) > 0)
    for start, end in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        along = (end - start) / max(np.sqrt(((end - start) ** 2).sum()), 1e-12)
        inside &= (points - start) @ np.array([-along[1], along[0]]) >= margin
    return inside


def _random_planes(rays: np.ndarray, inverse: np.ndarray, seen: np.ndarray, camera: Camera) -> np.ndarray:
    """(n, 3) coefficients of planes through triples of pixels that are near each other, the same for the same image."""
    rng = stream(0, "table")
    rows, columns = np.nonzero(seen)
    reach = max(SPAN / 2 * camera.fx / STEP, 2)
    first = rng.integers(0, len(rows), 8 * TRIPLES)
    triples = [np.stack([rows[first], columns[first]])]
    for _ in range(2):
        offsets = rng.uniform(-reach, reach, (2, len(first)))
        places = np.rint(triples[0] + offsets).astype(int)
        triples.append(np.clip(places, 0, np.array(seen.shape)[:, None] - 1))
    at = np.stack(triples, axis=-1)  # (2, n, 3)
    good = seen[at[0], at[1]].all(axis=1)
    at = at[:, good][:, :TRIPLES]
    matrices, sides = rays[at[0], at[1]], inverse[at[0], at[1]]
    volumes = np.abs(np.linalg.det(matrices)) > 1e-5
    return np.linalg.solve(matrices[volumes], sides[volumes][..., None])[..., 0]


def _middle_weights(u: np.ndarray, v: np.ndarray, camera: Camera) -> np.ndarray:
    """(h, w) votes of pixels: those in the middle count most, since people point the camera at what they mean."""
    across, down = 2 * u / camera.width - 1, 2 * v / camera.height - 1
    near = np.exp(-(across**2 + down**2) / (2 * MIDDLE**2))
    return near / near.sum() + EVERYWHERE / near.size


def _plausible(coefficients: np.ndarray) -> bool:
    """Whether a plane is in front of the camera, not too near, and not seen too flat along the optical axis."""
    size = float(np.sqrt(coefficients @ coefficients))
    return coefficients[2] / size > STEEPEST and size < 1 / NEAREST_PLANE


def _best_plane(planes: np.ndarray, rays: np.ndarray, inverse: np.ndarray, weights: np.ndarray) -> np.ndarray | None:
    """(3,) the plane with most votes, fitted; pixels that it would hide vote against it.

    Where it is a face of bodies on a lower plane, that one. rays: (h, w, 3); inverse: (h, w) [1/m], 0 without a
    return; weights: (h, w), 0 there.
    """
    seen = inverse > 0
    scored: list[tuple[float, np.ndarray]] = []
    for plane in _finalists(planes, rays[seen], inverse[seen], weights[seen]):
        fitted, _ = _fitted(rays[seen], inverse[seen], plane)
        nearer = np.where(seen, inverse - rays @ fitted, 0)
        on, below = seen & (np.abs(nearer) < TOLERANCE), nearer < -TOLERANCE
        score = float(weights[on].sum() - weights[below & _between(on)].sum())
        if _plausible(fitted) and score > 0:
            scored.append((score, fitted))
    if not scored:
        return None
    scored.sort(key=lambda item: -item[0])
    most, best = scored[0]
    for score, plane in scored[1:]:
        if score >= LOWER_VOTES * most and _stands_on(best, plane, rays[seen], inverse[seen]):
            best = plane
    return best


def _finalists(planes: np.ndarray, rays: np.ndarray, inverse: np.ndarray, votes: np.ndarray) -> list[np.ndarray]:
    """Planes (3,) with many votes, each by other pixels than those before it. rays: (n, 3); inverse, votes: (n,)."""
    likely = [plane for plane in planes if _plausible(plane)]
    masks = [np.abs(rays @ plane - inverse) < TOLERANCE for plane in likely]
    totals = [float(votes[mask].sum()) for mask in masks]
    taken, chosen = np.zeros(len(inverse), bool), []
    for i in np.argsort(-np.array(totals), kind="stable").tolist():
        if len(chosen) < FINALISTS and votes[masks[i] & ~taken].sum() > APART * totals[i]:
            chosen.append(likely[i])
            taken |= masks[i]
    return chosen


def _stands_on(upper: np.ndarray, lower: np.ndarray, rays: np.ndarray, inverse: np.ndarray) -> bool:
    """Whether the pixels of a plane lie above a lower plane as faces of bodies do, and those of that one below it."""
    above, below = (np.abs(rays @ plane - inverse) < TOLERANCE for plane in (upper, lower))
    heights = (1 - (rays[above] @ lower) / inverse[above]) / np.sqrt(lower @ lower)
    hidden = rays[below] @ upper - inverse[below] > 0
    return bool(np.mean((heights > 0) & (heights < TALLEST)) > BELOW and np.mean(hidden) > BELOW)


def _between(on: np.ndarray) -> np.ndarray:
    """(h, w) bool: pixels with BETWEEN pixels of a mask or more on both sides, in their row and in their column."""
    between = np.ones(on.shape, bool)
    for axis in (0, 1):
        before = np.cumsum(on, axis=axis)
        after = before.max(axis=axis, keepdims=True) - before
        between &= (before >= BETWEEN) & (after >= BETWEEN)
    return between


def _fitted(rays: np.ndarray, inverse: np.ndarray, plane: np.ndarray) -> tuple[np.ndarray, float]:
    """The plane (3,) by Tukey's weights from a first one, and the spread [1/m] about it.

    Bodies are on one side of a table only. So the spread is that of the other side, and first the plane sinks: what is
    above it loses its weight sooner.
    """
    near = np.abs(rays @ plane - inverse) < TOLERANCE
    rays, inverse, spread = rays[near], inverse[near], TOLERANCE / 2
    for turn in range(2 * ROUNDS):
        residuals = inverse - rays @ plane
        cut = np.where((residuals > 0) & (turn < ROUNDS), SINKING, TUKEY)
        weights = tukey_weights(residuals, cut * spread)
        weighted = rays * weights[:, None]
        plane = plane + np.linalg.solve(weighted.T @ rays + 1e-9 * np.eye(3), weighted.T @ residuals)
        below = (rays @ plane - inverse)[inverse < rays @ plane]
        spread = max(1.4826 * float(np.median(below)) if len(below) else 0.0, LEAST_SPREAD)
    return plane, spread
