"""First poses of a known shape in an image: every face that it can stand on, at every turn, over its mask."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull

from kit1000.camera import Camera
from kit1000.labelling.alignment import PlacedShape
from kit1000.labelling.body_windows import BodyWindow
from kit1000.labelling.standing_plane import Support, standing_frame
from kit1000.mesh import Mesh
from kit1000.pose import Pose, quaternion_between
from kit1000.sim.render import render

TURNS = 36  # about the vertical, of a face
ACROSS = 56  # [px] of a window in which first poses are compared
APART = np.radians(8)  # between the faces that are tried
MOST_FACES = 60
FLAT = 1e-6  # [m] by which vertices of one face may leave its plane
COPLANAR_DECIMALS = 5  # of the normals of one face
DEPTH_REACH = 8e-3  # [m] at which a difference of depth counts as much as none at all
ROUNDS = 2  # in which the outline's middle is brought over that of the mask
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class KnownShape:
    """A shape whose mesh is known, and how it can stand on a table."""

    name: str
    mesh: Mesh
    downs: np.ndarray
    """(k, 3) unit: outward normals of the faces that it can stand on, the largest first."""

    @staticmethod
    def of(name: str, mesh: Mesh) -> KnownShape:
        """A shape that may stand on any stable face of its convex hull."""
        return KnownShape(name, mesh, stable_normals(mesh))

    @staticmethod
    def upright(name: str, mesh: Mesh) -> KnownShape:
        """A shape that stands as it is, z up."""
        return KnownShape(name, mesh, -UP[None])


@dataclass(frozen=True, eq=False)
class Start:
    """A first pose and its cost, 0 for a shape that explains its mask and depths, 1 for one that explains nothing."""

    placed: PlacedShape
    cost: float


def stable_normals(mesh: Mesh) -> np.ndarray:
    """(k, 3) outward normals of the hull's faces over which the centre of volume lies, the largest face first."""
    hull, centre = ConvexHull(mesh.vertices), mesh.centroid
    planes = np.unique(hull.equations.round(COPLANAR_DECIMALS), axis=0, return_index=True)[1]
    found = []
    for normal, offset in ((hull.equations[i, :3], hull.equations[i, 3]) for i in planes):
        corners = mesh.vertices[hull.vertices]
        on = corners[np.abs(corners @ normal + offset) < FLAT]
        flat = _flattened(on, normal)
        if len(on) < 3 or np.linalg.matrix_rank(flat[1:] - flat[0], tol=FLAT) < 2:
            continue
        face = ConvexHull(flat, qhull_options="QJ")
        if (face.equations[:, :2] @ _flattened(centre[None], normal)[0] + face.equations[:, 2]).max() <= 0:
            found.append((face.volume, normal))
    found.sort(key=lambda entry: -entry[0])
    return np.array([normal for _, normal in found])


def _flattened(points: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """(n, 2) points (n, 3) seen along a normal."""
    return Pose(quaternion_between(normal, UP), np.zeros(3)).rotate(points)[:, :2]


def starts(shape: KnownShape, seen: BodyWindow, support: Support, turns: int = TURNS) -> list[Start]:
    """The first poses of a shape over a mask, that of least cost first; none where the mask has no depth."""
    points = seen.points
    if not len(points):
        return []
    table = standing_frame(support, np.median(points, axis=0))
    coarse = _Coarse.of(seen)
    found = []
    for down in _distinct(shape.downs):
        upright = Pose(quaternion_between(down, -UP), np.zeros(3))
        lift = -float(upright.apply(shape.mesh.vertices)[:, 2].min())
        centre = upright.apply(shape.mesh.bounds.mean(0))
        level = Pose.from_translation((-centre[0], -centre[1], lift)) @ upright
        for angle in np.arange(turns) * (2 * np.pi / turns):
            pose = table @ Pose.from_rotvec((0.0, 0.0, angle)) @ level
            found.append(_start(shape, seen, coarse, pose, table))
    return sorted(found, key=lambda start: start.cost)


def _distinct(downs: np.ndarray) -> list[np.ndarray]:
    """The directions (k, 3) without those nearer than APART to an earlier one."""
    kept: list[np.ndarray] = []
    for down in downs:
        if all(down @ other < np.cos(APART) for other in kept):
            kept.append(down)
    return kept[:MOST_FACES]


@dataclass(frozen=True, eq=False)
class _Coarse:
    """A window with fewer pixels."""

    seen: BodyWindow
    step: int
    depth: np.ndarray
    mask: np.ndarray
    others: np.ndarray

    @staticmethod
    def of(seen: BodyWindow) -> _Coarse:
        step = max(round(max(seen.mask.shape) / ACROSS), 1)
        every = np.s_[step // 2 :: step, step // 2 :: step]
        return _Coarse(seen, step, seen.depth[every], seen.mask[every], seen.others[every])

    def rendered(self, mesh: Mesh, pose: Pose) -> np.ndarray:
        """(h, w) [m] depths of a shape at the pixels of the window, 0 where it is not."""
        camera, step, first = self.seen.camera, self.step, self.step // 2
        rows, columns = self.mask.shape
        small = Camera(columns, rows, camera.fx / step, camera.fy / step, (camera.cx - first) / step,
                       (camera.cy - first) / step)  # fmt: skip
        return render(small, Pose.identity(), [(mesh, pose)], threads=1).depth.astype(float)


def _start(shape: KnownShape, seen: BodyWindow, coarse: _Coarse, pose: Pose, table: Pose) -> Start:
    """A pose moved along the table until its outline lies over the mask, with its cost."""
    wanted = np.argwhere(coarse.mask).mean(0)
    depth = coarse.rendered(shape.mesh, pose)
    for _ in range(ROUNDS):
        if not (depth > 0).any():
            break
        away = (wanted - np.argwhere(depth > 0).mean(0)) * coarse.step  # [px] down and across
        z = float(np.median(depth[depth > 0]))
        shift = np.array([away[1] / seen.camera.fx, away[0] / seen.camera.fy, 0.0]) * z
        line = (pose.apply(shape.mesh.bounds.mean(0)) + shift) / z
        normal = table.rotation_matrix()[:, 2]
        shift = shift - line * float(shift @ normal) / float(line @ normal)  # along the line of sight, to the table
        pose = Pose.from_translation(shift) @ pose
        depth = coarse.rendered(shape.mesh, pose)
    placed = PlacedShape(shape.mesh, seen, pose, 0.0, shape.downs)
    return Start(placed, _cost(depth, coarse.depth, coarse.mask, coarse.others))


def _cost(rendered: np.ndarray, measured: np.ndarray, mask: np.ndarray, others: np.ndarray) -> float:
    """Mean over the pixels of outline and mask: 1 where only one has them, else the difference of depths."""
    shown = rendered > 0
    either = (shown | mask) & ~others
    if not either.any():
        return 1.0
    both = shown & mask & (measured > 0)
    cost = np.where(shown & mask, 0.0, 1.0)
    cost[both] = np.minimum(np.abs(rendered[both] - measured[both]) / DEPTH_REACH, 1.0)
    return float(cost[either].mean())
