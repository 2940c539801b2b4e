"""The face a part is inserted on: its stable resting faces, and which of them tells turns apart best.

A part let go at random rolls over its convex hull until its centre of mass stands above the facet it lies on
(Goldberg et al. 1999, quasi-static: the share of each resting face is the solid angle that drains into it).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import ConvexHull

from kit1000.kits.envelope import polar_relief
from kit1000.mesh import Mesh
from kit1000.pose import Pose, quaternion_between, quaternion_from_rotvec
from kit1000.symmetry import Symmetry

PROBABLE = 0.05  # a resting face is one on which the part comes to lie in at least this share of drops
ROUND = np.radians(12)  # stable facets closer than this are one rolling surface (a tessellated cylinder)
WRONG_TURN = np.radians(20)  # turns beyond this ought to show in the cavity
SAME_RELIEF = 0.02  # share of a relief by which a turn that is none may differ on the grid
TIPPED, LEANING = np.radians(20), 3e-3  # a seated part must not lean so far while rising less than [m]
DOWN = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True, eq=False)
class RestingFace:
    """A way a part can lie on a plane."""

    normal: np.ndarray
    """(3,) outward unit normal of the face, in the part frame: it points into the table."""
    probability: float
    height: float
    """[m] of the part above the plane when it lies so."""

    @cached_property
    def lying(self) -> Pose:
        """plane_from_part: the face turned down by the shortest rotation, about the part's origin."""
        return Pose(quaternion_between(self.normal, DOWN), np.zeros(3))


def resting_faces(mesh: Mesh, probable: float = PROBABLE) -> list[RestingFace]:
    """The faces on which the part lies stably, most probable first.

    mesh: closed, with its centre of mass at the origin.
    """
    hull = ConvexHull(mesh.vertices)
    normals, share = hull.equations[:, :3], _solid_angles(mesh.vertices[hull.simplices]) / (4 * np.pi)
    sinks, owner = np.unique(_rolls_to(mesh.vertices, hull), return_inverse=True)
    probability = np.bincount(owner, weights=share)
    faces = []
    for members in _rolling_groups(normals[sinks]):
        chosen = members[np.argmax(np.round(probability[members], 6))]
        normal = normals[sinks[chosen]]
        along = mesh.vertices @ normal
        faces.append(RestingFace(normal, float(probability[members].sum()), float(along.max() - along.min())))
    return sorted((f for f in faces if f.probability >= probable), key=lambda f: -round(f.probability, 6))


def rank_faces(
    mesh: Mesh, faces: list[RestingFace], depths: list[float], clearance: float, symmetry: Symmetry | None = None
) -> list[int]:
    """Indices of the faces, the best to be inserted on first.

    depths: [m] of the cavity for each face. Faces on which the part would tip over inside its clearance come last;
    among the others the one whose relief tells the least visible wrong turn apart best. A turn that is a symmetry of
    the part is not wrong, so a disc lies on its flat face.
    """
    symmetry = symmetry or Symmetry.none()
    ranks = [
        (_tips(mesh, face, depth, clearance), -round(_turn_contrast(mesh, face, depth, clearance, symmetry), 9))
        for face, depth in zip(faces, depths, strict=True)
    ]
    return sorted(range(len(faces)), key=ranks.__getitem__)


def _tips(mesh: Mesh, face: RestingFace, depth: float, clearance: float) -> bool:
    """Whether a block as narrow as the shadow's narrow side can lean by TIPPED without rising or jamming."""
    points = mesh.moved(face.lying).vertices
    width = narrow_side(points[points[:, 2] <= points[:, 2].min() + depth])
    lean, drop = np.sin(TIPPED), 1 - np.cos(TIPPED)
    rise = width / 2 * lean + points[:, 2].min() * drop  # of the centre, which stands -min above the floor
    jams = depth * lean > 2 * clearance + width * drop
    return bool(rise < min(LEANING, depth / 3) and not jams)


def narrow_side(points: np.ndarray) -> float:
    """[m] least width of the shadow of points (n, 3): across one of the edges of its convex outline."""
    outline = points[ConvexHull(points[:, :2]).vertices, :2]
    edges = np.roll(outline, -1, axis=0) - outline
    across = np.stack([-edges[:, 1], edges[:, 0]], 1) / np.linalg.norm(edges, axis=1, keepdims=True)
    return float(np.ptp(outline @ across.T, axis=0).min())


def _turn_contrast(mesh: Mesh, face: RestingFace, depth: float, clearance: float, symmetry: Symmetry) -> float:
    """[m] how far the turned part would sink into the walls, on average: for the wrong turn that shows least.

    The relief is the lower envelope of the lying part below the rim; the walls stand around its relief grown by the
    clearance, and a part that still rises by LEANING counts as seated. A little of the mean breaks ties.
    """
    relief, cavity, weights = polar_relief(mesh.moved(face.lying), depth, clearance)
    turns = relief.shape[1]
    shifted = relief[:, (np.arange(turns)[:, None] - np.arange(turns)) % turns]  # (rings, turns, turned by)
    sunk = np.maximum(shifted - cavity[:, :, None] - min(LEANING, depth / 3), 0).sum(1)
    hidden = weights @ sunk / (weights.sum() * turns)
    angles = np.arange(turns) * (2 * np.pi / turns)
    spun = quaternion_from_rotvec(-angles[:, None] * face.normal)  # the face looks down: it turns the other way
    alike = weights @ np.abs(shifted - relief[:, :, None]).sum(1) < SAME_RELIEF * (weights @ relief.sum(1))
    wrong = (symmetry.error(spun, np.array([1.0, 0, 0, 0])) > WRONG_TURN) & ~alike
    return float(hidden[wrong].min() + 0.01 * hidden.mean()) if wrong.any() else np.inf


def _rolls_to(vertices: np.ndarray, hull: ConvexHull) -> np.ndarray:
    """(k,) index of the hull triangle on which a roll that starts on triangle k ends."""
    corners = vertices[hull.simplices]
    foot = -hull.equations[:, :3] * hull.equations[:, 3:]  # the origin dropped onto each facet's plane
    opposite = np.stack([_outside(corners, hull.equations[:, :3], foot, k) for k in range(3)], 1)
    worst = opposite.argmax(1)
    rows = np.arange(len(corners))
    following = np.where(opposite[rows, worst] > 1e-9, hull.neighbors[rows, worst], rows)
    # a roll never climbs: the height of the centre over the plane falls, or stays on the same plane
    climbs = hull.equations[following, 3] < hull.equations[:, 3] - 1e-9
    following = np.where(climbs, rows, following)
    for _ in range(int(np.ceil(np.log2(len(rows)))) + 1):
        following = following[following]
    return following


def _outside(corners: np.ndarray, normals: np.ndarray, foot: np.ndarray, k: int) -> np.ndarray:
    """[m] how far the foot lies beyond the edge opposite corner k."""
    a, b, c = corners[:, (k + 1) % 3], corners[:, (k + 2) % 3], corners[:, k]
    across = np.cross(b - a, normals)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    outward = np.where(np.einsum("ij,ij->i", c - a, across) > 0, -1.0, 1.0)
    return outward * np.einsum("ij,ij->i", foot - a, across)


def _solid_angles(triangles: np.ndarray) -> np.ndarray:
    """(k,) [sr] of triangles seen from the origin (Van Oosterom and Strackee 1983, eq. 8)."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
    dot = lambda x, y: np.einsum("ij,ij->i", x, y)  # noqa: E731
    numerator = np.abs(dot(a, np.cross(b, c)))
    return 2 * np.arctan2(numerator, la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb)


def _rolling_groups(normals: np.ndarray) -> list[np.ndarray]:
    """Stable facets chained by angles below ROUND, as arrays of indices."""
    close = normals @ normals.T > np.cos(ROUND)
    labels = np.arange(len(normals))
    while True:
        merged = np.where(close, labels[None, :], len(normals)).min(1)
        if np.array_equal(merged, labels):
            return [np.flatnonzero(labels == label) for label in np.unique(labels)]
        labels = merged
