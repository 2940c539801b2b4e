"""Refinement of the poses of known shapes by what an image shows of them: depths, outlines, and the table below.

Damped Gauss-Newton over a small motion of each body, the width by which its mask is too wide, the bend of the depths
at it, and the scale of the depths, which all bodies share. Residuals, each in its own standard deviation and under
Tukey's weights:

- depth: from a measured point to the plane of the face that a render shows at its pixel;
- outline: signed distance of a rendered outline from that of the mask, less the width;
- stand: height over the table and tilt of a body that stands on it.

A depth sensor widens masks evenly about a body, so a width is unknown and only the even remainder places the outline.
Everything is in the camera frame and in true lengths: a measured depth is divided by the scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.ndimage import binary_erosion

from kit1000.labelling.body_windows import BodyWindow
from kit1000.labelling.standing_plane import CELL, Support
from kit1000.mesh import Mesh
from kit1000.perception.calibration.table import TUKEY, tukey_weights
from kit1000.pose import Pose, unit_vector
from kit1000.sim.render import render

MOST_PIXELS = 3000  # of a body, whose depths are compared; evenly spaced ones of more
SUPERSAMPLING = 3  # rendered pixels across one of the image: the outline is exact to a sixth of a pixel
RAMP = 4.0  # [px] inside a mask, in which depths of a stereo camera mix those of the body and of what is behind it
LEAST_CORE = 60  # pixels further inside; with fewer, all of the mask are compared
CORRELATED_DEPTHS = 50.0  # pixels whose depth errors are as one: windows of a stereo matcher
CORRELATED_OUTLINE = 8.0  # px along an outline over which an error of one px holds
LEAST_OUTLINE_SPREAD, MOST_OUTLINE_SPREAD = 0.3, 3.0  # [px]
WIDTH_SPREAD = 3.0  # [px] of the width by which the masks of an image are too wide
# Standard deviation of the width of one mask about the common one: [px], and of each px by which the outline spreads
# beyond LEAST_OUTLINE_SPREAD. Exact masks are all alike; those of a sensor that fattens edges are not.
OWN_WIDTH, OWN_WIDTH_SHARE = 0.045, 0.8
WIDE_SCALE_SPREAD = 1.2e-3  # of the scale, where outlines spread by WIDE_OUTLINE [px] or more: widths differ by body
WIDE_OUTLINE = 1.0
OWN = 8  # unknowns of a body: turn and shift (6), width of its mask, bend of the depths at it
DAMPING, FIXED = 1e-6, 1e15  # added to the diagonal
SCALE_SPREAD = 2e-3  # of the depth scale; a D415 is within 3e-3 by its data sheet
HEIGHT_SPREAD, TILT_SPREAD = 0.3e-3, np.radians(0.15)  # [m], [rad] of a body that stands on the table
PLANE_SHARE = 0.4  # of the bend, by which the plane of the table is off below a body
DEPTH_REACH = (20e-3, 10e-3, 6e-3)  # [m] beyond which depths do not count, in the first rounds
OUTLINE_REACH = (14.0, 8.0, 5.0)  # [px]
STEP_LIMIT = (np.radians(8), 8e-3)  # [rad], [m] of one round


@dataclass(frozen=True, eq=False)
class PlacedShape:
    """A known shape at a pose, and the body of the image that it is taken for."""

    mesh: Mesh
    seen: BodyWindow
    camera_from_body: Pose
    width: float = 0.0
    """[px] by which the mask is wider than the shape."""
    downs: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    """(k, 3) unit, body frame: directions that can point into the table; none where it does not stand on it."""
    spread: float = 0.0
    """[m] standard deviation of its middle along the line of sight; 0 before a refinement."""

    @property
    def centre(self) -> np.ndarray:
        """(3,) [m] camera frame: the middle of its box, about which it is turned."""
        return self.camera_from_body.apply(self.mesh.bounds.mean(0))


@dataclass(frozen=True, eq=False)
class Alignment:
    """Refined shapes, and the depth scale that fits them."""

    shapes: tuple[PlacedShape, ...]
    scale: float
    """Measured over true depth."""
    scale_spread: float
    """Standard deviation of the scale."""


@dataclass(frozen=True, eq=False)
class _Rows:
    """Residuals with slopes: (n,) and (n, 6) by turn and shift of a body, (n,) by its width, its bend and the scale."""

    values: np.ndarray
    motion: np.ndarray
    width: np.ndarray
    bend: np.ndarray
    scale: np.ndarray
    outline_spread: float = 0.0  # [px]

    @staticmethod
    def of(
        values: np.ndarray,
        motion: np.ndarray,
        width: float,
        bend: float | np.ndarray,
        scale: float | np.ndarray,
        outline_spread: float = 0.0,
    ) -> _Rows:
        by_width, by_bend, by_scale = (np.broadcast_to(slope, len(values)) for slope in (width, bend, scale))
        return _Rows(values, motion, by_width, by_bend, by_scale, outline_spread)

    @property
    def slopes(self) -> np.ndarray:
        """(n, 9): by the motion, the width, the bend and the scale."""
        return np.column_stack([self.motion, self.width, self.bend, self.scale])

    def weighted(self, root: np.ndarray) -> _Rows:
        width, bend, scale = (slope * root for slope in (self.width, self.bend, self.scale))
        return _Rows(self.values * root, self.motion * root[:, None], width, bend, scale, self.outline_spread)


def align(
    shapes: Sequence[PlacedShape], support: Support, scale: float = 1.0, rounds: int = 8, fixed_scale: bool = False
) -> Alignment:
    """The shapes moved to where they explain the image best, from poses within a centimetre and some degrees.

    Args:
        shapes: of one image.
        support: the table in its image.
        scale: measured over true depth, to begin with.
        rounds: of Gauss and Newton.
        fixed_scale: whether the scale stays.
    """
    moved, log_scale, spread = list(shapes), float(np.log(scale)), SCALE_SPREAD
    width, bends = float(np.mean([shape.width for shape in shapes])), np.zeros(len(shapes))
    covariance = np.zeros((0, 0))
    for number in range(rounds):
        rows = [_rows(shape, support, log_scale, bend, number) for shape, bend in zip(moved, bends, strict=True)]
        normal, gradient = _equations(moved, rows, width, bends, log_scale, support)
        if fixed_scale:
            normal[-1, -1] += FIXED
        covariance = np.linalg.inv(normal)
        step = -covariance @ gradient
        moved = [_moved(shape, step[OWN * i : OWN * i + 7]) for i, shape in enumerate(moved)]
        bends += step[7:-2:OWN]
        width, log_scale = width + float(step[-2]), log_scale + float(step[-1])
        wide = float(np.median([own.outline_spread for own in rows])) - 1.2 * LEAST_OUTLINE_SPREAD
        wide = WIDE_SCALE_SPREAD * float(np.clip(wide / WIDE_OUTLINE, 0, 1))
        spread = min(float(np.hypot(np.sqrt(covariance[-1, -1]), wide)), SCALE_SPREAD)
    placed = (_with_spread(shape, covariance[OWN * i + 3 : OWN * i + 6, OWN * i + 3 : OWN * i + 6])
              for i, shape in enumerate(moved))  # fmt: skip
    return Alignment(tuple(placed), float(np.exp(log_scale)), spread)


def _with_spread(shape: PlacedShape, covariance: np.ndarray) -> PlacedShape:
    """A shape with the spread of its middle, whose covariance (3, 3) [m^2] is given."""
    sight = unit_vector(shape.centre)
    return replace(shape, spread=float(np.sqrt(sight @ covariance @ sight)))


def _equations(
    shapes: Sequence[PlacedShape],
    rows: Sequence[_Rows],
    width: float,
    bends: np.ndarray,
    log_scale: float,
    support: Support,
) -> tuple[np.ndarray, np.ndarray]:
    """The normal equations: turn, shift, width and bend of each shape, then the common width and the scale."""
    count = OWN * len(shapes) + 2
    normal, gradient = DAMPING * np.eye(count), np.zeros(count)
    for i, (shape, own) in enumerate(zip(shapes, rows, strict=True)):
        at = np.r_[OWN * i : OWN * i + OWN, count - 1]
        slopes = own.slopes
        normal[np.ix_(at, at)] += slopes.T @ slopes
        gradient[at] += slopes.T @ own.values
        pair = [OWN * i + 6, count - 2]
        beyond = max(own.outline_spread - 1.2 * LEAST_OUTLINE_SPREAD, 0.0)
        certainty = (OWN_WIDTH + OWN_WIDTH_SHARE * beyond) ** -2
        normal[np.ix_(pair, pair)] += certainty * np.array([[1.0, -1.0], [-1.0, 1.0]])
        gradient[pair] += certainty * (shape.width - width) * np.array([1.0, -1.0])
        certainty = (support.bend * float(shape.centre[2])) ** -2
        normal[OWN * i + 7, OWN * i + 7] += certainty
        gradient[OWN * i + 7] += certainty * bends[i]
    normal[-2, -2] += WIDTH_SPREAD**-2
    gradient[-2] += width * WIDTH_SPREAD**-2
    normal[-1, -1] += SCALE_SPREAD**-2
    gradient[-1] += log_scale * SCALE_SPREAD**-2
    return normal, gradient


def _moved(shape: PlacedShape, step: np.ndarray) -> PlacedShape:
    """A shape turned about its centre, shifted, its width changed by a step (7,), which is limited."""
    turn, shift = step[:3], step[3:6]
    factor = min(1.0, *(limit / max(float(np.linalg.norm(part)), 1e-12)
                        for limit, part in zip(STEP_LIMIT, (turn, shift), strict=True)))  # fmt: skip
    centre = Pose.from_translation(shape.centre)
    motion = centre @ Pose.from_rotvec(factor * turn, factor * shift) @ centre.inverse()
    return replace(shape, camera_from_body=motion @ shape.camera_from_body, width=shape.width + float(step[6]))


def _rows(shape: PlacedShape, support: Support, log_scale: float, bend: float, number: int) -> _Rows:
    """All residuals of a shape in a round."""
    parts = [_depth_rows(shape, support, log_scale + bend, number), _outline_rows(shape, number)]
    if len(shape.downs):
        parts.append(_stand_rows(shape, support, log_scale))
    columns = ([getattr(part, name) for part in parts] for name in ("values", "motion", "width", "bend", "scale"))
    return _Rows(*map(np.concatenate, columns), outline_spread=parts[1].outline_spread)


def _depth_rows(shape: PlacedShape, support: Support, log_scale: float, number: int) -> _Rows:
    """Residuals of measured depths at the pixels that both the mask and a render show."""
    seen = shape.seen
    image = render(seen.camera, Pose.identity(), [(shape.mesh, shape.camera_from_body)], threads=1)
    both = seen.mask & (seen.depth > 0) & (image.body_ids > 0)
    core = both & (seen.distance < -RAMP)
    v, u = np.nonzero(core if np.count_nonzero(core) >= LEAST_CORE else both)
    correlated = CORRELATED_DEPTHS + support.bend_share * min(len(v), CELL**2)
    share = max(len(v) / MOST_PIXELS, 1.0)
    kept = (np.arange(min(len(v), MOST_PIXELS)) * share).astype(int)
    v, u = v[kept], u[kept]
    rays, measured, rendered = seen.rays[v, u], seen.depth[v, u] / np.exp(log_scale), image.depth[v, u].astype(float)
    normals = shape.camera_from_body.rotate(shape.mesh.normals[image.face_ids[v, u]])
    facing = np.abs(np.einsum("ij,ij->i", normals, rays))
    normals = normals * np.where(np.einsum("ij,ij->i", normals, rays) < 0, 1.0, -1.0)[:, None]
    values = -facing * (measured - rendered)
    arms = rays * rendered[:, None] - shape.centre
    motion = -np.column_stack([np.cross(arms, normals), normals])
    spread = support.noise_at(rendered) * np.maximum(facing, 0.2)
    reach = DEPTH_REACH[min(number, 2)] if number < 4 else 0.0
    limit = np.maximum(TUKEY * spread, reach)
    weight = tukey_weights(values, limit) * share / correlated
    return _Rows.of(values, motion, 0.0, facing * measured, facing * measured).weighted(np.sqrt(weight) / spread)


def _outline_rows(shape: PlacedShape, number: int) -> _Rows:
    """Residuals of the outline that a render shows, where no other body is near."""
    seen, camera = shape.seen, shape.seen.camera.scaled(SUPERSAMPLING)
    image = render(camera, Pose.identity(), [(shape.mesh, shape.camera_from_body)], threads=1)
    inside = image.body_ids > 0
    v, u = np.nonzero(inside & np.logical_not(binary_erosion(inside)))  # the border of the window counts as outside
    z = image.depth[v, u].astype(float)
    uv = (np.stack([u, v], axis=-1) + 0.5) / SUPERSAMPLING - 0.5
    rows, columns = np.rint(uv[:, 1]).astype(int), np.rint(uv[:, 0]).astype(int)
    height, width = seen.mask.shape
    rows, columns = np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)
    border = (rows > 0) & (columns > 0) & (rows < height - 1) & (columns < width - 1)
    kept = border & ~seen.others[rows, columns]
    uv, z = uv[kept], z[kept]
    distance, gradient = seen.distances_at(uv)
    values = distance + 0.5 / SUPERSAMPLING + shape.width
    points = seen.camera.unproject_pixels(uv, z)
    focal = np.array([seen.camera.fx, seen.camera.fy])
    pull = gradient * focal / z[:, None]  # of a shift of the point, across and down
    along = -np.einsum("ij,ij->i", pull, points[:, :2]) / z
    shift = np.column_stack([pull, along])
    motion = np.column_stack([np.cross(points - shape.centre, shift), shift])
    spread = 1.4826 * float(np.median(np.abs(values - np.median(values)))) if len(values) else 1.0
    spread = float(np.clip(spread, LEAST_OUTLINE_SPREAD, MOST_OUTLINE_SPREAD))
    limit = max(TUKEY * spread, OUTLINE_REACH[min(number, 2)] if number < 4 else 0.0)
    correlated = SUPERSAMPLING * max(CORRELATED_OUTLINE * spread, 1.0)
    weight = tukey_weights(values, limit) / correlated
    return _Rows.of(values, motion, 1.0, 0.0, 0.0, spread).weighted(np.sqrt(weight) / spread)


def _stand_rows(shape: PlacedShape, support: Support, log_scale: float) -> _Rows:
    """Residuals of a body that stands on the table: height of its lowest point, and tilt of what points down."""
    n, points = support.normal, shape.camera_from_body.apply(shape.mesh.vertices)
    offset = support.offset / np.exp(log_scale)
    height = float((points @ n).min()) - offset
    spread = float(np.hypot(HEIGHT_SPREAD, PLANE_SHARE * support.bend * shape.centre[2] * abs(shape.centre @ n)))
    downs = shape.camera_from_body.rotate(shape.downs)
    tilt = np.cross(downs[int(np.argmin(downs @ n))], -n)  # the turn that sets it right
    values = np.array([height / spread, *(tilt / TILT_SPREAD)])
    motion = np.zeros((4, 6))
    motion[0, 3:] = n / spread  # by a turn its lowest point changes: that is left to the tilt
    motion[1:, :3] = (np.outer(n, n) - np.eye(3)) / TILT_SPREAD
    return _Rows.of(values, motion, 0.0, 0.0, np.array([offset / spread, 0.0, 0.0, 0.0]))
