"""The face a part is inserted on: its stable resting faces, in the order in which an engineer would try them.

A part dropped in a random orientation rolls over its convex hull until its centre of mass is above the facet it rests
on (Goldberg et al. 1999, quasi-static: a face's probability is the solid angle of all orientations that roll to it).
The face that a part rests on most often is the one to lay it on, so plates and gears lie flat.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull

from kit1000.kits.height_fields import polar_relief
from kit1000.mesh import Mesh
from kit1000.numerics.compiled import compiled
from kit1000.numerics.linear_algebra import matmul
from kit1000.numerics.trigonometry import cosine, sine
from kit1000.pose import Pose, quaternion_between, quaternion_from_rotvec
from kit1000.symmetry import Symmetry

MIN_PROBABILITY = 0.05  # share of drops after which the part lies on a face, for it to count as a resting face
ROLLING_ANGLE = np.radians(12)  # stable facets closer than this are one rolling surface (a tessellated cylinder)
# Unlikely facets closer than this are one rolling surface too: a regular prism none of whose faces reaches
# MIN_PROBABILITY has 19 sides or more, 18.95 degrees apart.
UNLIKELY_ROLLING_ANGLE = np.radians(19)
SAME_PROBABILITY = 0.1  # share below the most likely face at which a face counts as equally likely
SAME_SHAPE = 2e-6  # [m] by which the vertices of congruent views may differ
WRONG_YAW = np.radians(20)  # a yaw error beyond this should collide with the walls
SAME_RELIEF_SHARE = 0.02  # share of a relief by which two equal reliefs may differ on the grid
TIP_ANGLE, TIP_RISE = np.radians(20), 3e-3  # a seated part must not tip by this angle while rising less than [m]
DOWN = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True, eq=False)
class RestingFace:
    """A face of the convex hull on which a part rests stably on a plane."""

    normal: np.ndarray  # (3,) outward unit normal of the face, in the part frame: it points into the table
    probability: float  # share of random drops after which the part rests on it
    height: float  # [m] of the part above the plane when it rests so
    rolls: bool = False  # whether it is a rolling surface: stable facets of which neighbours are close, but not all

    @cached_property
    def plane_from_part(self) -> Pose:
        """The shortest rotation that turns the face down, about the part's origin."""
        return Pose(quaternion_between(self.normal, DOWN), np.zeros(3))


def resting_faces(mesh: Mesh, min_probability: float = MIN_PROBABILITY) -> list[RestingFace]:
    """The faces on which the part rests stably, most probable first.

    mesh: closed, with its centre of mass at the origin.
    """
    hull = ConvexHull(mesh.vertices)
    normals, share = hull.equations[:, :3], _solid_angles(mesh.vertices[hull.simplices]) / (4 * np.pi)
    sinks, owner = np.unique(_rolls_to(mesh.vertices, hull), return_inverse=True)
    normals, probability = normals[sinks], np.bincount(owner, weights=share)
    groups = _rolling_groups(normals, np.arange(len(sinks)), ROLLING_ANGLE)
    likely = [group for group in groups if probability[group].sum() >= min_probability]
    if len(likely) < len(groups):
        rest = np.setdiff1d(np.arange(len(sinks)), np.concatenate([np.zeros(0, dtype=int), *likely]))
        likely += _rolling_groups(normals, rest, UNLIKELY_ROLLING_ANGLE)
    faces = [_face(mesh, normals[group], probability[group]) for group in likely]
    likely_faces = (face for face in faces if face.probability >= min_probability)
    return sorted(likely_faces, key=lambda face: -round(face.probability, 6))


def _face(mesh: Mesh, normals: np.ndarray, probability: np.ndarray) -> RestingFace:
    """The face of a group of stable facets: the most probable one represents all."""
    normal = normals[np.argmax(np.round(probability, 6))]
    along = matmul(mesh.vertices, normal)
    rolls = bool(matmul(normals, normals.T).min() < cosine(ROLLING_ANGLE))
    return RestingFace(normal, float(probability.sum()), float(along.max() - along.min()), rolls)


def rank_faces(
    mesh: Mesh, faces: list[RestingFace], depths: list[float], clearance: float, symmetry: Symmetry | None = None
) -> list[int]:
    """Indices of the faces, the first to be tried for insertion first.

    depths: [m] of the cavity for each face. Faces on which the part could tip over within its clearance come last, and
    before them those on which it rolls; the others in the order of their probability. Of faces equally likely, to
    SAME_PROBABILITY, that with the highest yaw contrast is first: how clearly the walls exclude the worst wrong yaw. A
    yaw that is a symmetry of the part is not wrong.
    """
    symmetry = symmetry or Symmetry.none()
    awkward = [(tips_over(mesh, face, depth, clearance), face.rolls) for face, depth in zip(faces, depths, strict=True)]
    order: list[int] = []
    for kind in sorted(set(awkward)):
        left = sorted(
            (i for i in range(len(faces)) if awkward[i] == kind), key=lambda i: -round(faces[i].probability, 6)
        )
        while left:
            least = (1 - SAME_PROBABILITY) * faces[left[0]].probability
            equal = [i for i in left if faces[i].probability >= least]
            left = left[len(equal) :]
            if len(equal) > 1:
                contrast = {i: _yaw_contrast(mesh, faces[i], depths[i], clearance, symmetry) for i in equal}
                equal.sort(key=lambda i: -round(contrast[i], 9))
            order += equal
    return order


def distinct_faces(mesh: Mesh, faces: list[RestingFace]) -> list[RestingFace]:
    """The faces without those on which the part looks as on an earlier one or its mirror image: the kits would too."""
    found: list[tuple[RestingFace, np.ndarray]] = []
    for face in faces:
        view = _view(mesh, face)
        if not any(np.abs(view - other).max() < SAME_SHAPE for _, other in found):
            found.append((face, view))
    return [face for face, _ in found]


def _view(mesh: Mesh, face: RestingFace) -> np.ndarray:
    """(3, n) [m] sorted measures of the vertices that no rotation about the face's normal changes, and no mirror.

    Height, distance from the vertical axis through the centroid, and their sum, which ties the two to each other.
    """
    height = matmul(mesh.vertices, face.normal)
    offset = mesh.vertices - height[:, None] * face.normal
    across = np.sqrt(np.einsum("ij,ij->i", offset, offset))
    return np.sort([height, across, height + across], axis=1)


def tips_over(mesh: Mesh, face: RestingFace, depth: float, clearance: float) -> bool:
    """Whether a block as narrow as the part below the rim can tip by TIP_ANGLE without rising or jamming."""
    points = mesh.moved(face.plane_from_part).vertices
    width = narrowest_width(points[points[:, 2] <= points[:, 2].min() + depth])
    tip_sine, versine = sine(TIP_ANGLE), 1 - cosine(TIP_ANGLE)
    rise = width / 2 * tip_sine + points[:, 2].min() * versine  # of the centroid, which is -min above the floor
    jams = depth * tip_sine > 2 * clearance + width * versine
    return bool(rise < min(TIP_RISE, depth / 3) and not jams)


def narrowest_width(points: np.ndarray) -> float:
    """Least width of points (n, 3) [m] projected onto the xy plane, across an edge of their convex hull [m]."""
    outline = points[ConvexHull(points[:, :2]).vertices, :2]
    edges = np.roll(outline, -1, axis=0) - outline
    across = np.stack([-edges[:, 1], edges[:, 0]], 1) / np.linalg.norm(edges, axis=1, keepdims=True)
    return float(np.ptp(matmul(outline, across.T), axis=0).min())


def _yaw_contrast(mesh: Mesh, face: RestingFace, depth: float, clearance: float, symmetry: Symmetry) -> float:
    """Mean depth by which the part would cut into the walls, at the wrong yaw with the smallest mean depth [m].

    The relief is the lower envelope of the resting part below the rim; the walls stand around the relief grown by the
    clearance, and a part that rises by less than TIP_RISE counts as seated. 1 % of the mean over all yaws breaks ties.
    """
    relief, cavity, weights = polar_relief(mesh.moved(face.plane_from_part), depth, clearance)
    columns = relief.shape[1]
    overlap, difference = _at_all_yaws(relief, cavity, min(TIP_RISE, depth / 3))
    mean_overlap = matmul(weights, overlap) / (weights.sum() * columns)  # (yaws,)
    yaws = np.arange(columns) * (2 * np.pi / columns)
    rotations = quaternion_from_rotvec(-yaws[:, None] * face.normal)  # the normal points down: opposite sense
    same = matmul(weights, difference) < SAME_RELIEF_SHARE * matmul(weights, relief.sum(1))
    wrong = (symmetry.error(rotations, np.array([1.0, 0, 0, 0])) > WRONG_YAW) & ~same
    return float(mean_overlap[wrong].min() + 0.01 * mean_overlap.mean()) if wrong.any() else np.inf


@compiled
def _at_all_yaws(relief, cavity, rise):
    """(rings, yaws) [m] how far a relief (rings, columns), rotated by each yaw, exceeds a cavity by more than a rise.

    Also returns how far it differs from the relief. Both are sums over the columns, in their order.
    """
    rings, columns = relief.shape
    overlap, difference = np.empty((rings, columns)), np.empty((rings, columns))
    for ring in range(rings):
        for yaw in range(columns):
            beyond, apart = 0.0, 0.0
            for column in range(columns):
                rotated = relief[ring, (column - yaw) % columns]
                beyond += max(rotated - cavity[ring, column] - rise, 0.0)
                apart += abs(rotated - relief[ring, column])
            overlap[ring, yaw], difference[ring, yaw] = beyond, apart
    return overlap, difference


def _rolls_to(vertices: np.ndarray, hull: ConvexHull) -> np.ndarray:
    """(k,) index of the hull triangle on which the part comes to rest when it starts on triangle k."""
    corners = vertices[hull.simplices]
    foot = -hull.equations[:, :3] * hull.equations[:, 3:]  # the origin projected onto each facet's plane
    opposite = np.stack([_beyond_edge(corners, hull.equations[:, :3], foot, k) for k in range(3)], 1)
    worst = opposite.argmax(1)
    rows = np.arange(len(corners))
    following = np.where(opposite[rows, worst] > 1e-9, hull.neighbors[rows, worst], rows)
    # a roll never climbs: the height of the centroid above the plane falls, or the plane stays the same
    climbs = hull.equations[following, 3] < hull.equations[:, 3] - 1e-9
    following = np.where(climbs, rows, following)
    for _ in range(int(np.ceil(np.log2(len(rows)))) + 1):
        following = following[following]
    return following


def _beyond_edge(corners: np.ndarray, normals: np.ndarray, foot: np.ndarray, k: int) -> np.ndarray:
    """(m,) [m] signed distance of the foot beyond the edge opposite corner k."""
    a, b, c = corners[:, (k + 1) % 3], corners[:, (k + 2) % 3], corners[:, k]
    across = np.cross(b - a, normals)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    outward = np.where(np.einsum("ij,ij->i", c - a, across) > 0, -1.0, 1.0)
    return outward * np.einsum("ij,ij->i", foot - a, across)


def _solid_angles(triangles: np.ndarray) -> np.ndarray:
    """(k,) [sr] solid angles of triangles from the origin (Van Oosterom and Strackee 1983, eq. 8)."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
    dot = lambda x, y: np.einsum("ij,ij->i", x, y)  # noqa: E731
    numerator = np.abs(dot(a, np.cross(b, c)))
    return 2 * np.arctan2(numerator, la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb)


def _rolling_groups(normals: np.ndarray, facets: np.ndarray, angle: float) -> list[np.ndarray]:
    """Groups of some stable facets, as arrays of indices: neighbours in a group differ by less than an angle [rad]."""
    close = matmul(normals[facets], normals[facets].T) > cosine(angle)
    count, labels = connected_components(close, directed=False)
    return [facets[labels == label] for label in range(count)]
