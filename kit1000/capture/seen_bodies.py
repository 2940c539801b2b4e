"""Bodies on the table: regions of the image above its plane, larger than its ripple explains."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_dilation, binary_erosion, binary_fill_holes, binary_opening, find_objects

from kit1000.capture.table_search import Table, convex_outline, inside_outline
from kit1000.perception.segmentation.pieces import connected

LEAST_HEIGHT = 2.5e-3  # [m] of a pixel of a body above the table, at least
RIPPLES = 2.5  # standard deviations of the table's ripple that such a pixel must exceed
MOST_LEAST = 8e-3  # [m] that the ripple can raise LEAST_HEIGHT to
BODY_HEIGHT, BODY_QUANTILE = 6e-3, 0.9  # [m] that the highest tenth of a body's pixels reaches
SURE = 2.3  # times RIPPLES, that a sure body reaches: ripple alone reaches 2.1 times
MOST_SURE = 19e-3  # [m] that the ripple can raise the height of a sure body to
TALLEST = 0.2  # [m]
EDGE = 6e-3  # [m] inside the table's outline, where bodies stand
STRIP = 15e-3  # [m] shorter side of a strip: beside something higher at the outline it is the foot of that
TOUCHING = 3  # [px]
LONG = 4.0  # ratio of length and width of a strip along the table's outline
BORDER, INSIDE = 36e-3, 0.3  # [m] from the outline, within which such a strip has all but this share of its pixels
LEAST_AREA = 1e-4  # [m^2] seen
LEAST_PIXELS = 150
MOST_BODIES = 200
SPIKE = 3  # [px] side of a square that fits into a body, but not into noise
NARROW = 5  # [px] side of a square that fits into every body: what a matcher smears beside edges is narrower
SEAM = 9  # [px] the same, of a body that touches another one in the image
GAP = 25e-3  # [m] along the table, between neighbouring pixels that belong to two bodies
FRAGMENT = 0.1  # ratio of areas up to which a piece inside the outline of a body was cut off by a shadow
FRAGMENT_AREA = 5e-4  # [m^2] of such a piece, at most
MOST_POINTS = 2000  # whose smallest rectangle is searched


@dataclass(frozen=True, eq=False)
class SeenBody:
    """A body."""

    mask: np.ndarray  # (H, W) bool
    area: float  # [m^2] as seen from straight above
    height: float  # [m] above the table, 98th percentile
    sides: tuple[float, float]  # [m] of the smallest rectangle about it from above, the shorter first
    centre: np.ndarray  # (2,) [m] along the table's `axes`


class SeenBodies(NamedTuple):
    """The bodies of an image, the largest first."""

    sure: list[SeenBody]  # higher than the ripple of the table explains
    doubtful: list[SeenBody]  # lower ones


def seen_bodies(table: Table) -> SeenBodies:
    """The bodies of an image, at most MOST_BODIES."""
    heights = table.flat_heights
    least = float(np.clip(RIPPLES * table.ripple, LEAST_HEIGHT, MOST_LEAST))
    high = heights > least
    sure = sure_height(table)
    on_table = np.zeros_like(high)
    on_table[high] = inside_outline(table.ground(high), table.outline, EDGE)
    beside = binary_dilation(_opened(high & ~on_table), iterations=TOUCHING)
    opened = _opened(on_table & (heights < TALLEST))
    regions = _regions(table, opened)
    found: list[tuple[float, SeenBody]] = []  # with the height that a tenth of it reaches
    for number, box in enumerate(find_objects(regions), start=1):
        mask = regions[box] == number
        if not _is_broad(mask):
            continue
        reached = float(np.quantile(heights[box][mask], BODY_QUANTILE))
        if reached <= BODY_HEIGHT or _is_smear(regions, number, box):
            continue
        whole = np.zeros(high.shape, bool)
        whole[box] = np.asarray(binary_fill_holes(mask), bool) & ~(
            heights[box] < least / 2
        )  # a hole without a return is a shadow
        body = measured_body(table, whole)
        strip = body.sides[0] < STRIP and (mask & beside[box]).any()
        if body.area > LEAST_AREA and not strip and not _lies_along_outline(table, body):
            found.append((reached, body))
    found.sort(key=lambda entry: -entry[1].area)
    high_ones = _with_fragments(table, [body for reached, body in found if reached > sure])[:MOST_BODIES]
    low_ones = [body for reached, body in found if reached <= sure]
    return SeenBodies(high_ones, low_ones[: MOST_BODIES - len(high_ones)])


def sure_height(table: Table) -> float:
    """[m] that the highest tenth of a sure body reaches."""
    return float(np.clip(SURE * RIPPLES * table.ripple, BODY_HEIGHT, MOST_SURE))


def _lies_along_outline(table: Table, body: SeenBody) -> bool:
    """Whether a body is a long strip at the outline of the table: the foot of a wall, or the bent border."""
    short, long = body.sides
    if long < LONG * short:
        return False
    return bool(np.mean(inside_outline(table.ground(body.mask), table.outline, BORDER)) < INSIDE)


def _is_smear(regions: np.ndarray, number: int, box: tuple[slice, ...]) -> bool:
    """Whether a region is a seam beside another one: pixels between a near edge and what is behind it."""
    rows, columns = (slice(max(side.start - TOUCHING, 0), side.stop + TOUCHING) for side in box)
    near = regions[rows, columns]
    mask = near == number
    if binary_erosion(mask, np.ones((SEAM, SEAM))).any():
        return False
    return bool(((near > 0) & ~mask & binary_dilation(mask, iterations=TOUCHING)).any())


def _is_broad(mask: np.ndarray) -> bool:
    """Whether a region (h, w) bool is large and broad enough for a body."""
    return mask.sum() >= LEAST_PIXELS and bool(binary_erosion(mask, np.ones((NARROW, NARROW))).any())


def _with_fragments(table: Table, bodies: list[SeenBody]) -> list[SeenBody]:
    """Bodies, the largest first; small ones inside the convex outline of a much larger one become pieces of it."""
    whole: list[SeenBody] = []
    for body in bodies:
        homes = (i for i, other in enumerate(whole) if body.area < FRAGMENT * other.area and body.area < FRAGMENT_AREA)
        home = next((i for i in homes if lies_within(table, body, whole[i])), None)
        if home is None:
            whole.append(body)
        else:
            whole[home] = measured_body(table, whole[home].mask | body.mask)
    return whole


def lies_within(table: Table, body: SeenBody, other: SeenBody) -> bool:
    """Whether most of a body lies inside the convex outline of another one, from above."""
    outline = convex_outline(table.ground(other.mask))
    return bool(np.mean(inside_outline(table.ground(body.mask), outline, 0.0)) > 0.5)


def _opened(mask: np.ndarray) -> np.ndarray:
    """A mask (H, W) without spikes."""
    return np.asarray(binary_opening(mask, np.ones((SPIKE, SPIKE))), bool)


def _regions(table: Table, mask: np.ndarray) -> np.ndarray:
    """(H, W) int: from 1 on the regions of a mask, whose neighbours are no more than GAP apart along the table."""
    feet = np.full((*mask.shape, 2), np.inf)
    feet[mask] = table.ground(mask)
    joined = []
    for axis in (0, 1):
        with np.errstate(invalid="ignore"):
            joined.append(np.square(np.diff(feet, axis=axis)).sum(-1) < GAP**2)
    return connected(mask, joined)


def measured_body(table: Table, mask: np.ndarray) -> SeenBody:
    """A body by its mask (H, W) bool, which has a return."""
    camera = table.image.camera
    rows, columns = np.nonzero(mask & (table.image.depth > 0))
    depth = table.image.depth[rows, columns].astype(float)
    rays = camera.unproject_pixels(np.stack([columns, rows], -1), np.ones(len(rows)))
    points = rays * depth[:, None]
    slant = np.abs(rays @ table.up)  # a level face fills fewer pixels the flatter it is seen
    area = float((depth**2 / np.maximum(slant, 0.1)).sum() / (camera.fx * camera.fy))
    feet, heights = points @ table.axes[:2].T, table.heights[rows, columns]
    middle = (feet.min(0) + feet.max(0)) / 2
    return SeenBody(mask, area, float(np.quantile(heights, 0.98)), _sides(feet), middle)


def _sides(feet: np.ndarray) -> tuple[float, float]:
    """The sides of the smallest of 90 rectangles about points (n, 2), without a hundredth of them at either end."""
    some = feet[:: max(len(feet) // MOST_POINTS, 1)]
    best, sides = np.inf, (0.0, 0.0)
    for angle in np.radians(np.arange(90)):
        axes = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        low, high = np.quantile(some @ axes.T, (0.005, 0.995), axis=0)
        across, along = sorted((high - low).tolist())
        if across * along < best:
            best, sides = across * along, (across, along)
    return sides
