"""What an image hides of the kits, as the network completes it: a surface to look at."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import binary_erosion, label
from scipy.spatial import Delaunay, QhullError
from trimesh.util import append_faces

from kit1000.mesh import Mesh
from kit1000.perception.observed.kits import Completer, ObservedKits
from kit1000.perception.observed.relief import CELL, CELLS, DEEPEST, CompletedRelief, SeenRelief
from kit1000.perception.restoration import calibrated_image
from kit1000.perception.sensor_facts import SensorFacts
from kit1000.values import ASSEMBLY_LABEL, Query

if TYPE_CHECKING:
    from kit1000.perception.restoration.restorer import Restorer

FACE = 1.0  # [mm] from a plate's face, within which a seen cell is of it
LEAST_CELLS = 10  # of a hidden region: smaller ones are cells that a rim crosses
BORDER = 2  # cells of the border of the face, in which its edge lies


def completed_kits(query: Query, sensor: SensorFacts, completer: Completer, restorer: Restorer | None) -> Mesh:
    """What the image of a query hides of the kits, as a network completes it, at places the image shows the rest of.

    Args:
        query: any about the image.
        sensor: that took the image.
        completer: the network that completes kits.
        restorer: the network that restores images of stereo cameras; None: they are only calibrated.

    Returns:
        [m] world, as the recorded camera is believed to stand: a noisy image is calibrated to complete it.
    """
    image = calibrated_image(query.image, sensor)
    restored = image if restorer is None else restorer(image, sensor, (ASSEMBLY_LABEL,))
    kits = ObservedKits(restored, sensor.kind.best.noise, query.scene_id, completer=completer)
    recorded_from_calibrated = query.view.world_from_camera @ image.view.world_from_camera.inverse()
    return hidden_surfaces(kits).moved(recorded_from_calibrated)


def hidden_surfaces(kits: ObservedKits) -> Mesh:
    """The completed surface of hidden cells of all observed plates; empty without network. [m] world."""
    reliefs = [kits.relief(plate.point) for plate in kits.plates]
    surfaces = [hidden_surface(relief) for relief in reliefs if relief is not None]
    vertices, faces = append_faces([part.vertices for part in surfaces], [part.faces for part in surfaces])
    return Mesh(vertices, faces.astype(np.int32))


def hidden_surface(relief: CompletedRelief) -> Mesh:
    """The surface of the hidden cells within a plate, joined to the seen cells beside them.

    Its vertices are the middles of cells. A plate is where its seen face has its convex hull, as plates are
    rectangles. There is no surface where a cell has none above DEEPEST.

    Returns:
        [m] world, facing along the plate's normal.
    """
    shown, depths = relief.shown, relief.depths
    hidden = _large(~shown.seen & _within_face(shown))
    there = (shown.seen | hidden) & (depths < DEEPEST)
    squares = _corners(there).all(-1) & _corners(hidden).any(-1)
    a, b, c, d = np.moveaxis(_corners(np.arange(CELLS**2).reshape(CELLS, CELLS))[squares], -1, 0)
    faces = np.concatenate([np.stack([a, c, b], -1), np.stack([b, c, d], -1)])
    used, renumbered = np.unique(faces, return_inverse=True)
    at = (np.arange(CELLS) - (CELLS - 1) / 2) * CELL
    points = np.stack([*np.meshgrid(at, at, indexing="ij"), -1e-3 * depths.astype(np.float64)], -1).reshape(-1, 3)
    return Mesh(shown.world_from_plate.apply(points[used]), renumbered.reshape(-1, 3).astype(np.int32))


def _corners(cells: np.ndarray) -> np.ndarray:
    """(n - 1, n - 1, 4): the values of cells (n, n) at the corners of the squares between their middles."""
    return np.stack([cells[:-1, :-1], cells[:-1, 1:], cells[1:, :-1], cells[1:, 1:]], -1)


def _large(cells: np.ndarray) -> np.ndarray:
    """The cells (n, n) bool of regions of at least LEAST_CELLS."""
    regions = np.asarray(label(cells)[0], np.int64)  # type: ignore[index]
    return cells & (np.bincount(regions.ravel())[regions] >= LEAST_CELLS)


def _within_face(shown: SeenRelief) -> np.ndarray:
    """(CELLS, CELLS) bool: the cells within the convex hull of the seen face, without its border."""
    face = np.argwhere(shown.seen & (np.abs(shown.least) < FACE))
    try:
        hull = Delaunay(face)
    except (QhullError, ValueError):  # too few cells, or all in a line
        return np.zeros((CELLS, CELLS), bool)
    inside = hull.find_simplex(np.argwhere(np.ones((CELLS, CELLS), bool))) >= 0
    return binary_erosion(inside.reshape(CELLS, CELLS), iterations=BORDER, border_value=1)
