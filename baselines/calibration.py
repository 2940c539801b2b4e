"""Calibration of a recorded view by the table: its plane z = 0 and its outline correct camera pose and depth scale.

Nothing is learned and no truth is read: the table is part of the specification of every scene. The seven unknowns are
a small motion of the camera (rotation, translation, in its own frame) and the logarithm of the depth scale. Each is
pulled to 0 by the spread that the specification of the d415 gives it, so what the table does not determine stays as
recorded. Sums are loops of numpy, not BLAS: results are the same on every processor.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import binary_dilation

from baselines.elimination import solve_positive
from kit1000.camera import Camera
from kit1000.errors import checked
from kit1000.pose import Pose
from kit1000.products import length, matmul
from kit1000.sim.layout import TABLE_SIZE
from kit1000.sim.sensors import SENSORS
from kit1000.values import View

D415 = SENSORS["d415"]
CALIBRATED = replace(D415, scale_error=3e-4, position_error=3e-4, rotation_error_deg=0.02)
"""The d415 once the table has calibrated it: about what is left of its errors of pose and scale."""
SPREADS = np.repeat(
    [np.radians(D415.rotation_error_deg) / np.sqrt(3), D415.position_error / np.sqrt(3), D415.scale_error / np.sqrt(3)],
    [3, 3, 1],
)
"""(7,) standard deviations of the unknowns: rotation vector [rad], translation [m], logarithm of the depth scale."""

STEP = 6  # [px] between pixels that enter the plane; noise is correlated over 13 px
MARGIN = 2  # cells of STEP px about every body: there its fattened edge may cover the table
PLANE_REACH = 25e-3  # [m] from the recorded plane, of the pixels that enter
LEAST_PIXELS = 500  # of the plane; with fewer the view stays as it is
PLANE_ROUNDS = 5  # of reweighting
RECORDED_WEIGHT = 0.3  # of the recorded plane, in pixels: noise of a pixel over spread of the plane, squared, at 0.8 m
PLANE_SPREADS = np.array([1e-4, 1e-4, 5e-5])  # of the fitted plane: normal [rad], normal [rad], height [m]

EDGE_REACH = 10  # [px] on either side of where an edge is expected
LEAST_EDGE = 20  # pixels of an edge
PIXEL_SPREAD = 0.3  # [px] standard deviation of an edge within the pixel that it crosses: 1 / sqrt(12), rounded up
DROPOUT_QUANTILE = 0.9  # dropouts move an edge inward only, so it lies where the outermost pixels are
EDGE_TOLERANCE = 1.0  # [px] from the edge, of the pixels that enter
ROUNDS = 4  # of Gauss and Newton; of the choice of pixels at an edge

OUTWARD = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
HALF_SIZES = np.array([TABLE_SIZE[0], TABLE_SIZE[0], TABLE_SIZE[1], TABLE_SIZE[1]]) / 2
"""(4, 2) outward normals of the table's edges, and (4,) [m] their distances from the origin."""


@dataclass(frozen=True, eq=False)
class Plane:
    """The table's top in the camera frame, as measured."""

    normal: np.ndarray
    """(3,) unit vector, up."""
    height: float
    """[m] of the camera above it, in measured depths."""


@dataclass(frozen=True, eq=False)
class Edge:
    """Where the image shows an edge of the table: at most one place in each column, or in each row."""

    index: int
    """In OUTWARD and HALF_SIZES."""
    columns: bool
    """Whether columns cross it, and not rows."""
    lines: np.ndarray
    """(n,) [px] the columns, or the rows."""
    places: np.ndarray
    """(n,) [px] on each, midway between the last pixel with a return and the first without."""
    spread: float
    """[px] standard deviation of each place, such that all together have that of the edge."""


def calibrated(view: View, labels: np.ndarray, flat: bool = False, outline: bool = True) -> View:
    """The view with the camera pose and the depths that its table gives it.

    Args:
        view: as recorded.
        labels: (H, W) uint8 masks, see `kit1000.values.LabelledDepth`; 0 for the table or nothing.
        flat: put the pixels of the table exactly on its plane; those without a return get one.
        outline: use the table's edges as well as its plane.
    """
    labels = checked("labels", labels, view.depth.shape, np.uint8)
    plane = table_plane(view, labels)
    if plane is None:
        return view
    unknowns = _solved(view, plane, [])
    if outline:
        edges = table_edges(_corrected(view, unknowns), labels)
        unknowns = _solved(view, plane, edges) if edges else unknowns
    corrected = _corrected(view, unknowns)
    return flattened(corrected, labels) if flat else corrected


def table_plane(view: View, labels: np.ndarray) -> Plane | None:
    """The plane of the table's pixels; None where there are too few.

    Fitted in inverse depth, where noise is the same for all pixels, with Tukey's weights; what a narrow strip of table
    leaves open stays as recorded.
    """
    bodies = labels[::STEP, ::STEP] > 0
    depth = view.depth[::STEP, ::STEP].astype(float)
    v, u = np.nonzero((depth > 0) & np.logical_not(binary_dilation(bodies, np.ones((2 * MARGIN + 1,) * 2))))
    z, rays = depth[v, u], _rays(view.camera, np.stack([u, v], axis=-1) * float(STEP))
    axis, height = view.world_from_camera.inverse().rotate((0.0, 0.0, 1.0)), view.world_from_camera.xyz[2]
    near = np.abs(z * matmul(rays, axis) + height) < PLANE_REACH
    rays, inverse = rays[near], 1 / z[near]
    if len(rays) < LEAST_PIXELS or height < PLANE_REACH:
        return None
    recorded = -axis / height
    weights, coefficients = np.ones(len(rays)), recorded
    for _ in range(PLANE_ROUNDS):
        weighted = rays * weights[:, None]
        normal = matmul(weighted.T, rays) + RECORDED_WEIGHT * np.eye(3)
        coefficients = recorded + solve_positive(normal, matmul(weighted.T, inverse - matmul(rays, recorded)))
        residuals = inverse - matmul(rays, coefficients)
        spread = 1.4826 * np.median(np.abs(residuals)) + 1e-9
        weights = np.square(np.clip(1 - np.square(residuals / (4.685 * spread)), 0, None))
    return Plane(-coefficients / length(coefficients), 1 / length(coefficients))


def table_edges(view: View, labels: np.ndarray) -> list[Edge]:
    """The edges of the table that the image shows against nothing, in a view whose plane is right."""
    edges = (_edge(view, labels, index) for index in range(len(OUTWARD)))
    return [edge for edge in edges if edge is not None]


def flattened(view: View, labels: np.ndarray) -> View:
    """The view with the depths of the table's plane at all pixels of the table, with a return or without."""
    depth, on = _table_top(view)
    return replace(view, depth=np.where((labels == 0) & on, depth.astype(view.depth.dtype), view.depth))


def _table_top(view: View) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) [m] depths of the plane z = 0, 0 where it is not in front; (H, W) bool: pixels that look at the table."""
    camera, pose = view.camera, view.world_from_camera
    across = (np.arange(camera.width) - camera.cx) / camera.fx
    along = (np.arange(camera.height) - camera.cy) / camera.fy
    x, y, z = (axis[0] * across + (axis[1] * along + axis[2])[:, None] for axis in pose.rotation_matrix())
    depth = np.divide(pose.xyz[2], -z, out=np.zeros_like(z), where=z < 0)  # of rays of depth 1
    ground = ((pose.xyz[0], x, HALF_SIZES[0]), (pose.xyz[1], y, HALF_SIZES[2]))
    within = [np.abs(start + direction * depth) <= half for start, direction, half in ground]
    return depth, (z < 0) & within[0] & within[1]


def _corrected(view: View, unknowns: np.ndarray) -> View:
    return View(view.camera, _pose(view, unknowns), view.depth * np.float32(np.exp(-unknowns[6])))


def _pose(view: View, unknowns: np.ndarray) -> Pose:
    return view.world_from_camera @ Pose.from_rotvec(unknowns[:3], unknowns[3:6])


def _solved(view: View, plane: Plane, edges: list[Edge]) -> np.ndarray:
    """(7,) unknowns of least squares: plane, edges, and the spread of each unknown."""

    def residuals(scaled: np.ndarray) -> np.ndarray:
        unknowns = scaled * SPREADS
        pose = _pose(view, unknowns)
        up = pose.rotate(plane.normal)
        height = pose.xyz[2] - plane.height * np.exp(-unknowns[6])
        on_plane = np.array([up[0], up[1], height]) / PLANE_SPREADS
        on_edges = [(_crossings(view.camera, pose, edge) - edge.places) / edge.spread for edge in edges]
        return np.concatenate([scaled, on_plane, *on_edges])

    start = np.zeros(len(SPREADS))
    for _ in range(ROUNDS):
        here = residuals(start)
        slopes = np.stack([(residuals(start + step) - here) / 1e-3 for step in 1e-3 * np.eye(len(start))], axis=-1)
        start = start - solve_positive(matmul(slopes.T, slopes), matmul(slopes.T, here))
    return start * SPREADS


def _rays(camera: Camera, uv: np.ndarray) -> np.ndarray:
    """(n, 3) directions of pixels (n, 2), of depth 1."""
    return camera.unproject_pixels(uv, np.ones(len(uv)))


def _ground(pose: Pose, rays: np.ndarray) -> np.ndarray:
    """(n, 3) [m] world: where rays (n, 3) of the camera meet the plane z = 0; NaN where they do not."""
    directions = pose.rotate(rays)
    down = np.where(directions[:, 2] < 0, -directions[:, 2], np.nan)
    return pose.xyz + directions * (pose.xyz[2] / down)[:, None]


def _edge(view: View, labels: np.ndarray, index: int) -> Edge | None:
    """An edge; None where the image shows too little of it or the camera is not on the table's side of it."""
    camera, pose = view.camera, view.world_from_camera
    if matmul(pose.xyz[:2], OUTWARD[index]) > HALF_SIZES[index]:
        return None  # seen from outside, the side of the table continues below its edge
    columns, outward, lines, expected = _expected(camera, pose, index)
    if len(lines) < LEAST_EDGE:
        return None
    steps = np.arange(-EDGE_REACH, EDGE_REACH + 1)
    places = np.rint(expected).astype(int)[:, None] + outward * steps
    pixels = (places, lines[:, None]) if columns else (lines[:, None], places)
    table = labels[pixels] == 0
    seen = table & (view.depth[pixels] > 0)
    inside = len(steps) - np.argmax(seen[:, ::-1], axis=1)  # up to the outermost return
    clean = table.all(axis=1) & seen.any(axis=1) & (inside < len(steps))
    if clean.sum() < LEAST_EDGE:
        return None
    lines, expected = lines[clean], expected[clean]
    last = places[clean, inside[clean] - 1] + 0.5 * outward
    kept = _without_dropouts(lines.astype(float), outward * (last - expected))
    if kept.sum() < LEAST_EDGE:
        return None
    crossed = len(np.unique(last[kept]))  # an edge along a row of pixels is as good as one place alone
    spread = PIXEL_SPREAD * max(np.sqrt(kept.sum()) / crossed, 1.0)
    return Edge(index, columns, lines[kept], last[kept], float(spread))


def _expected(camera: Camera, pose: Pose, index: int) -> tuple[bool, int, np.ndarray, np.ndarray]:
    """Where an edge should be in the image.

    Returns:
        Whether columns cross it, and not rows; the outward direction on them, 1 or -1; (n,) which of them cross it;
        (n,) [px] where. Only those with EDGE_REACH to the border of the image.
    """
    a, b, _ = _image_line(camera, pose, index)
    columns = abs(b) > abs(a)
    across, down = (camera.width, camera.height) if columns else (camera.height, camera.width)
    lines = np.arange(across)
    places = _on_line(camera, pose, index, columns, lines)
    ground = _ground(pose, _rays(camera, np.stack([lines, places] if columns else [places, lines], axis=-1)))
    along = np.abs(matmul(ground[:, :2], OUTWARD[index][::-1]))
    inside = (places >= EDGE_REACH) & (places <= down - 1 - EDGE_REACH) & (along < HALF_SIZES[(index + 2) % 4])
    return columns, -1 if (b if columns else a) > 0 else 1, lines[inside], places[inside]


def _crossings(camera: Camera, pose: Pose, edge: Edge) -> np.ndarray:
    """(n,) [px] where a camera at this pose would see the edge, on each of its columns or rows."""
    return _on_line(camera, pose, edge.index, edge.columns, edge.lines)


def _on_line(camera: Camera, pose: Pose, index: int, columns: bool, lines: np.ndarray) -> np.ndarray:
    a, b, c = _image_line(camera, pose, index)
    return -(a * lines + c) / b if columns else -(b * lines + c) / a


def _image_line(camera: Camera, pose: Pose, index: int) -> tuple[float, float, float]:
    """a, b, c of the line a u + b v + c = 0 on which the camera sees an edge; the sum is below 0 outside.

    They are the normal of the plane through camera and edge, in pixels.
    """
    outward = np.array([*OUTWARD[index], 0.0])
    along = np.array([-outward[1], outward[0], 0.0])
    normal = matmul(np.cross(along, outward * HALF_SIZES[index] - pose.xyz), pose.rotation_matrix())
    a, b = normal[0] / camera.fx, normal[1] / camera.fy
    return float(a), float(b), float(normal[2] - a * camera.cx - b * camera.cy)


def _without_dropouts(places: np.ndarray, beyond: np.ndarray) -> np.ndarray:
    """(n,) bool: the pixels of an edge that lie on one line, among those that a dropout moved inward.

    Args:
        places: (n,) [px] along the edge.
        beyond: (n,) [px] outward from where the edge is expected.
    """
    middle = places.mean()
    terms = np.stack([np.ones_like(places), (places - middle) / max(np.ptp(places), 1.0)], axis=-1)
    line = np.full(len(places), np.quantile(beyond, DROPOUT_QUANTILE))
    reach = 3 * EDGE_TOLERANCE  # wide at first: the recorded yaw tilts the line
    for _ in range(ROUNDS):
        kept = np.abs(beyond - line) < reach
        if kept.sum() < LEAST_EDGE:
            return kept
        line = matmul(
            terms,
            solve_positive(matmul(terms[kept].T, terms[kept]) + 1e-6 * np.eye(2), matmul(terms[kept].T, beyond[kept])),
        )
        reach = max(reach / 1.6, EDGE_TOLERANCE)
    return np.abs(beyond - line) < reach
