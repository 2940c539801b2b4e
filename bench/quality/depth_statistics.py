"""Statistics of the errors of a depth image: noise on flat tiles, its correlation, bending, ramps and holes at jumps.

All in disparity [px], fx * baseline / depth, in which the errors of triangulating sensors do not grow with distance.
Letters: H rows, W columns; d disparity (H, W) float64, NaN for no return.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_erosion, gaussian_filter, maximum_filter1d

TILE, WIDE_TILE = 48, 64  # [px] sides of flat tiles
LAGS = 24  # [px] of the correlation
TRIPLES, SAMPLES = 400, 4000  # draws and pixels of the search for the largest plane
NEAR_PLANE = 1.5  # [px] from it, of its pixels
CALM = 1 / 3  # share of tiles, the flattest ones: others show more than a plane
LOW_PASS = 40.0  # [px] standard deviation, at FOCAL
FOCAL = 925.0  # [px]
JUMPS = ((1.0, 2.0), (2.0, 3.0), (3.0, 5.0), (5.0, 8.0), (8.0, 20.0))  # [px] classes
HOLE_JUMP = 3.0  # [px] smallest jump at which holes are counted: smaller ones are often no edges but bends
REACH, FLAT = 7, 4  # px from a jump to a surface, and of that surface
BETWEEN = (0.2, 0.8)  # share of the jump within which a pixel is between both surfaces
RAMP = 3  # such pixels of a ramp


class Jump(NamedTuple):
    """A jump along a line of pixels."""

    rise: float
    """[px] of the disparity, along the line."""
    between: int
    """Pixels between both surfaces."""
    gap: int
    """Pixels without a return."""


@dataclass(frozen=True)
class ImageStatistics:
    """Statistics of one image; NaN where it shows too little."""

    flat_px: float
    """RMS on the flattest tiles of TILE px."""
    half_across: float
    """[px] lag at which the correlation on them falls to one half."""
    half_down: float
    wide_half_across: float
    """The same on tiles of WIDE_TILE px."""
    wide_half_down: float
    far_correlation: float
    """On wide tiles, at 13 px across."""
    low_pass_px: float
    """RMS of the largest plane's residual under a low pass of LOW_PASS px."""
    ramps: tuple[float, ...]
    """Share of ramps by JUMPS, along rows and columns."""
    holes_left: float
    """Share with a hole of jumps along rows whose near surface is on the right: on the left of near bodies."""
    holes_right: float
    holes_columns: float
    """Share with a hole of jumps along columns."""
    shadow_left: float
    """[px] median width of holes on the left of near bodies, for each px of the jump, at jumps over 5 px."""
    shadow_right: float

    def named(self) -> dict[str, float]:
        """The statistics by name."""
        values = {name: value for name, value in self.__dict__.items() if name != "ramps"}
        shares = {f"ramps_{low:g}_{high:g}": share for (low, high), share in zip(JUMPS, self.ramps, strict=True)}
        return {**values, **shares}


def image_statistics(
    depth: np.ndarray, gain: float, focal: float = FOCAL, ideal: np.ndarray | None = None
) -> ImageStatistics:
    """The statistics of a depth image.

    Args:
        depth: (H, W) [m], 0 for no return.
        gain: [px m] focal length times baseline.
        focal: [px] focal length.
        ideal: (H, W) [m] depths without errors, where they are known: only jumps that are steps there count then.
    """
    d = disparity_of(depth, gain)
    true = None if ideal is None else disparity_of(ideal, gain)
    plane = largest_plane(d)
    residual = d - plane
    flat_px, near = tile_statistics(residual, TILE)
    _, far = tile_statistics(residual, WIDE_TILE)
    along_rows = list(jumps(d, true))
    along_columns = list(jumps(d.T, None if true is None else true.T))
    every = [*along_rows, *along_columns]
    left = [jump for jump in along_rows if jump.rise > HOLE_JUMP]
    right = [jump for jump in along_rows if jump.rise < -HOLE_JUMP]
    down = [jump for jump in along_columns if abs(jump.rise) > HOLE_JUMP]
    return ImageStatistics(
        flat_px,
        half_lag(near[0]),
        half_lag(near[1]),
        half_lag(far[0]),
        half_lag(far[1]),
        float(far[0][13]),
        low_pass_rms(residual, LOW_PASS * focal / FOCAL),
        tuple(ramp_share(every, *ends) for ends in JUMPS),
        _hole_share(left),
        _hole_share(right),
        _hole_share(down),
        _shadow_width(left),
        _shadow_width(right),
    )


def disparity_of(depth: np.ndarray, gain: float) -> np.ndarray:
    """(H, W) [px] of depths (H, W) [m], NaN for no return. gain: [px m] focal length times baseline."""
    return np.where(depth > 0, gain / np.where(depth > 0, depth, 1), np.nan).astype(float)


def largest_plane(d: np.ndarray) -> np.ndarray:
    """(H, W) disparities of the plane that holds most pixels: by random triples, then least squares."""
    rng = np.random.default_rng(0)
    v, u = np.nonzero(np.isfinite(d))
    terms, values = np.stack([np.ones(len(v)), u, v], 1).astype(float), d[v, u]
    chosen = rng.integers(len(v), size=SAMPLES)
    some, some_values = terms[chosen], values[chosen]
    best, most = np.zeros(3), -1
    for triple in rng.integers(SAMPLES, size=(TRIPLES, 3)):
        if abs(np.linalg.det(some[triple])) < 1e3:
            continue
        plane = np.linalg.solve(some[triple], some_values[triple])
        inside = int((np.abs(some_values - some @ plane) < NEAR_PLANE).sum())
        best, most = (plane, inside) if inside > most else (best, most)
    for reach in (NEAR_PLANE, NEAR_PLANE / 2, NEAR_PLANE / 2):
        inside = np.abs(values - terms @ best) < reach
        best = np.linalg.lstsq(terms[inside], values[inside], rcond=None)[0]
    rows, columns = np.indices(d.shape)
    return best[0] + best[1] * columns + best[2] * rows


def tile_statistics(residual: np.ndarray, side: int) -> tuple[float, np.ndarray]:
    """Median RMS of the flattest tiles [px], and (2, LAGS) their correlation across and down; NaN without tiles."""
    tiles = [tile for tile in _tiles(residual, side) if tile is not None]
    if not tiles:
        return np.nan, np.full((2, LAGS), np.nan)
    rms = np.array([np.sqrt(np.mean(tile**2)) for tile in tiles])
    calm = [tile for tile, each in zip(tiles, rms, strict=True) if each <= np.quantile(rms, CALM)]
    power = np.mean([np.mean(tile**2) for tile in calm])
    lags = range(LAGS)
    across = [np.mean([np.mean(tile[:, lag:] * tile[:, : side - lag]) for tile in calm]) for lag in lags]
    down = [np.mean([np.mean(tile[lag:] * tile[: side - lag]) for tile in calm]) for lag in lags]
    return float(np.median([np.sqrt(np.mean(tile**2)) for tile in calm])), np.array([across, down]) / power


def _tiles(residual: np.ndarray, side: int) -> Iterator[np.ndarray | None]:
    """Tiles of the largest plane, less their own plane."""
    at = (np.arange(side) - (side - 1) / 2) / side
    terms = np.stack([np.ones((side, side)), *np.meshgrid(at, at)], -1).reshape(-1, 3)
    inverse = np.linalg.pinv(terms)
    for top in range(0, residual.shape[0] - side + 1, side // 2):
        for left in range(0, residual.shape[1] - side + 1, side // 2):
            tile = residual[top : top + side, left : left + side]
            if np.isfinite(tile).all() and np.abs(tile).max() < NEAR_PLANE:
                yield (tile.ravel() - terms @ (inverse @ tile.ravel())).reshape(side, side)


def half_lag(correlation: np.ndarray) -> float:
    """[px] at which a correlation (LAGS,) first falls to one half, by a straight line between whole lags."""
    below = np.flatnonzero(correlation < 0.5)
    if not len(below):
        return float("nan")
    k = int(below[0])
    return k - (0.5 - correlation[k]) / (correlation[k - 1] - correlation[k]) if k else 0.0


def low_pass_rms(residual: np.ndarray, sigma: float) -> float:
    """RMS [px] of the largest plane's residual under a Gaussian of `sigma` px, away from other surfaces."""
    inside = np.isfinite(residual) & (np.abs(np.nan_to_num(residual)) < NEAR_PLANE)
    inside = np.asarray(binary_erosion(inside, np.ones((5, 5))), bool)
    weight = gaussian_filter(inside.astype(float), sigma)
    smooth = gaussian_filter(np.where(inside, np.nan_to_num(residual), 0.0), sigma) / np.maximum(weight, 1e-9)
    known = inside & (weight > 0.7)
    if known.sum() < 1000:
        return float("nan")
    return float(np.std(smooth[known]))


def jumps(d: np.ndarray, true: np.ndarray | None = None) -> Iterator[Jump]:
    """The jumps along every other row between two surfaces that are each flat over FLAT px.

    true: (H, W) [px] disparities without errors; a jump counts where they have a step of half its height near it.
    """
    for v in range(0, len(d), 2):
        places = np.flatnonzero(np.isfinite(d[v]))
        if len(places) >= 4 * REACH:
            yield from _line_jumps(d[v, places], places, None if true is None else np.abs(np.diff(true[v])))


def _line_jumps(values: np.ndarray, places: np.ndarray, steps: np.ndarray | None) -> Iterator[Jump]:
    """Jumps among the pixels of a line with a return: (n,) disparities and places. steps: (W - 1,) [px] true ones."""
    rise_at = np.zeros(len(values))  # over 6 px about a pixel
    rise_at[3:-3] = np.abs(values[6:] - values[:-6])
    highest = maximum_filter1d(rise_at, 2 * REACH + 1)
    tops = np.flatnonzero((rise_at == highest) & (rise_at > 0.7 * JUMPS[0][0]))
    for k in tops[(tops >= REACH + FLAT) & (tops < len(values) - REACH - FLAT)]:
        before, after = values[k - REACH - FLAT + 1 : k - REACH + 1], values[k + REACH : k + REACH + FLAT]
        rise = float(after.mean() - before.mean())
        if abs(rise) < JUMPS[0][0] or max(np.ptp(before), np.ptp(after)) > 0.3 + 0.1 * abs(rise):
            continue
        if steps is not None and not np.nanmax(steps[places[k - REACH] : places[k + REACH]]) > abs(rise) / 2:
            continue
        share = (values[k - REACH + 1 : k + REACH] - before.mean()) / rise
        between = int(((share > BETWEEN[0]) & (share < BETWEEN[1])).sum())
        gap = int(places[k + REACH] - places[k - REACH]) - 2 * REACH
        yield Jump(rise, between, gap)


def ramp_share(found: list[Jump], low: float, high: float) -> float:
    """Share of ramps among the jumps of low to high px without a hole; NaN for fewer than 20."""
    whole = [jump for jump in found if low <= abs(jump.rise) < high and jump.gap == 0]
    return float(np.mean([jump.between >= RAMP for jump in whole])) if len(whole) >= 20 else float("nan")


def _hole_share(found: list[Jump]) -> float:
    return float(np.mean([jump.gap > 0 for jump in found])) if len(found) >= 20 else float("nan")


def _shadow_width(found: list[Jump]) -> float:
    """[px/px] median over the jumps over 5 px."""
    widths = [jump.gap / abs(jump.rise) for jump in found if abs(jump.rise) > 5]
    return float(np.median(widths)) if len(widths) >= 20 else float("nan")
