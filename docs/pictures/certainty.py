"""What one image makes certain about a part and a cavity, at a wrong pose and at the right one (`kit1000` 1.0.0).

    python docs/pictures/certainty.py data/kit1000

Two queries without a guess, each cut along the plate's normal and the line of sight, the camera to the left. On the
left the pose in which the filled part fits best, on the right that of `registration`.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from scipy.ndimage import distance_transform_edt

from kit1000.dataset.reader import Dataset
from kit1000.pictures.shading import contact_sheet
from kit1000.pose import Pose, unit_vector
from kit1000.registration.geometry.cavity import VOXEL, Cavity, cells_at
from kit1000.registration.predictor import Registration
from kit1000.registration.rank import Fit
from kit1000.registration.search import INSIDE, TOLERANCE, KitHeights, contradictions
from kit1000.values import Query
from kit1000.voxels import Grid, Volume, resample

OUT = Path(__file__).with_suffix(".png")
CASES = (("val-s0010", "val-s0010-p1-place"), ("val-s0026", "val-s0026-p2-place"))
PIXEL = 0.125e-3  # [m]
WIDTH, BELOW, ABOVE = 0.072, 0.022, 0.024  # [m] of a picture, from the plate's face down and up
BAND = 1e-3  # [m] thickness at which a contradiction is drawn
OPEN, MATERIAL, HIDDEN = (250, 250, 248), (203, 178, 140), (226, 220, 210)
SOLID, UNKNOWN, WRONG = (44, 92, 140), (168, 196, 222), (208, 44, 44)


def main(folder: Path) -> None:
    """Draw a row for each case."""
    dataset = Dataset(folder)
    split = dataset.split("val")
    pictures, names = [], []
    for scene, name in CASES:
        query = next(query for query in split.scene(scene).queries if query.id == name)
        for source, words in (("columns", "filled part"), ("depth", "certain bounds")):
            picture, contradicted = draw(dataset, query, Registration(dataset, source).fits(query)[0])
            pictures.append(picture)
            names.append(f"by the {words}: {1e3 * contradicted:.2f} mm")
    contact_sheet(pictures, names, columns=2).save(OUT, optimize=True)


def draw(dataset: Dataset, query: Query, fit: Fit) -> tuple[np.ndarray, float]:
    """(h, w, 3) uint8 of the cut through a fit, and how far it contradicts the image [m]."""
    ((part, _),) = Registration(dataset).scene(query).parts()
    clearance = dataset.summary["config"]["clearance"]
    cavity, pose = fit.candidate.cavity, fit.candidate.plate_from_now
    kit = KitHeights.of(cavity, clearance)
    bounds = part.bounds
    across = cavity.world_from_plate.inverse().rotate(part.middle - query.image.view.world_from_camera.xyz)
    slice_grid = _slice(pose.apply(part.middle), across)
    points = slice_grid.world(np.argwhere(np.ones(slice_grid.shape, bool))).reshape(*slice_grid.shape[::2], 3)
    material, hidden = _kit(cavity, points)
    in_world = Grid(slice_grid.shape, PIXEL, pose.inverse() @ slice_grid.world_from_grid)
    solid, possible = (_inside(volume, in_world) for volume in (bounds.sure, bounds.possible))
    picture = np.full((*points.shape[:2], 3), OPEN, np.uint8)
    for where, colour in ((hidden, HIDDEN), (material, MATERIAL), (possible & ~material, UNKNOWN), (solid, SOLID)):
        picture[where] = colour
    picture[solid & ~_grown(~material)] = WRONG
    picture[_must_fill(kit, points, _grown(possible))] = WRONG
    score = contradictions(part, kit, pose).cost
    return np.ascontiguousarray(picture.transpose(1, 0, 2)[::-1]), score


def _slice(middle: np.ndarray, across: np.ndarray) -> Grid:
    """A flat grid in the plate frame through a middle (3,) [m], x along `across` (3,) as seen from above, z up."""
    x = unit_vector(across * (1, 1, 0))
    axes = np.stack([x, np.cross((0, 0, 1), x), (0, 0, 1)], axis=1)
    corner = middle * (1, 1, 0) - WIDTH / 2 * x - (0, 0, BELOW)
    shape = (round(WIDTH / PIXEL), 1, round((BELOW + ABOVE) / PIXEL))
    return Grid(shape, PIXEL, Pose.from_rotation_matrix(axes, corner))


def _kit(cavity: Cavity, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(w, h) bool each of points (w, h, 3) [m] in the plate frame: certain material of the kit, and not known."""
    relief, free = (_at(image, points) for image in (cavity.certain_heights, cavity.certain_free))
    heights, known = points[..., 2], ~np.isnan(relief)
    return known & (heights < relief), ~known & (heights < free)


def _must_fill(kit: KitHeights, points: np.ndarray, possible: np.ndarray) -> np.ndarray:
    """(w, h) bool: above the floors of the cells of a shrunk cavity in which no height of the floor is possible."""
    lowest, highest = np.full((2, *kit.low.shape), np.nan)
    i, j = cells_at(kit.must_fill, len(kit.low))
    lowest[i, j] = kit.must_fill[:, 2] + INSIDE
    highest[i, j] = lowest[i, j] + kit.span
    above, below = points[..., 2] - _at(lowest, points), points[..., 2] - _at(highest, points)
    filled = (possible & (above >= 0) & (below <= PIXEL)).any(1, keepdims=True)
    return (below > 0) & (below < BAND) & ~filled


def _at(image: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(w, h) values of an image (n, n) at points (w, h, 3) [m] in the plate frame; NaN beside it."""
    i, j = cells_at(points.reshape(-1, 3), len(image)).reshape(2, *points.shape[:2])
    beside = np.abs(points[..., :2]).max(-1) > (len(image) - 1) / 2 * VOXEL
    return np.where(beside, np.nan, image[i, j])


def _inside(volume: Volume, grid: Grid) -> np.ndarray:
    """(w, h) bool: where a volume is solid."""
    return resample(volume, grid, threads=1).values[:, 0] < 0


def _grown(region: np.ndarray) -> np.ndarray:
    """(w, h) bool: a region grown by the tolerance of contradictions."""
    return np.asarray(distance_transform_edt(~region)) * PIXEL < TOLERANCE


if __name__ == "__main__":
    main(Path(sys.argv[1]))
