"""Refinement of a fit in a noisy image, by least squares and by a network: both move it in the plane of its plate.

In a volume, the noise of a pixel's disparity becomes walls that are millimetres off. In the image it stays noise, equal
for all pixels. So the plate is rendered with the cavity that the part would cut, and the place and yaw of the fit are
refined until the rendered disparities equal the image's, except for a bend: an error of the plate's face, which has
nothing to do with the place of the cavity.

A network then reads a patch: what the image shows about the fit, on a grid on the face of its plate that looks away
from the camera. Its origin lies below the middle of the part, its first axis points away from the camera, its z axis
out of the plate. All disparities are beyond the face's: negative in a cavity. So a plate may stand anywhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import binary_dilation, map_coordinates, uniform_filter

from kit1000.camera import Camera
from kit1000.numerics.elimination import solve_positive
from kit1000.numerics.linear_algebra import length, matmul
from kit1000.perception.placement import CELL, Channel
from kit1000.pose import Pose
from kit1000.registration.geometry.height_maps import RAY_CELL, cavity_heights, trace
from kit1000.registration.part_volume import SLIMMER, WIDER, PartShape
from kit1000.registration.prepared_image import RestoredImage
from kit1000.registration.refine import LEVER, descend, linearised
from kit1000.registration.search import Candidate
from kit1000.values import ASSEMBLY_LABEL, LabelledDepth, View
from kit1000.voxels import Volume

LEAST_CUT = 1e-3  # [m] below the face; cells of the cavity are deeper
AROUND = 10e-3  # [m] about the cavity, of the plate that is compared
BORDER = 5  # [px] inside the masks of the kits; nearer to their edge the image shows something else
IN_FRONT, BEHIND = 12e-3, 60e-3  # [m] of depth from the face, up to which a pixel shows the plate or its cavity
LEAST_PIXELS = 200  # that are compared
HOLD = 620.0  # [1/m] weight of the fit's former place: it wins if the image shows no rim
HALF = 1  # [px] on either side over which rendered disparities are averaged: edges of the image are as soft
BEND = 2e3  # factor of a unit of bend, so that all unknowns weigh about as much as a move of the cavity
DIFFERENCES = np.array([14e-3, 1e-3, 1e-3, 0.4e-3, 0.4e-3, 0.05e-3])  # a rendered image changes in steps of a pixel
SCALES = (2.0, 1.0)  # of the Geman-McClure weights
LEAST_SPREAD = 1e-6  # [m] of a place: no image is exact
REGULAR = 1e-9  # share of its trace on the diagonal of a matrix that is solved: pixels in a row determine no slope

LARGEST_DISPARITY = 24.0  # [px] beyond the face: what is farther from the face is another surface
LEAST_LENGTH = 1e-9  # [m] of a direction


@dataclass(frozen=True, eq=False)
class PlateInImage:
    """The pixels of an image that show a plate about a fit, as seen from the plate's frame."""

    origin: np.ndarray
    """(3,) [m] the camera in the plate frame."""
    rays: np.ndarray
    """(h * w, 3) directions of depth 1 in the plate frame, row by row of a box of the image."""
    face: np.ndarray
    """(h, w) disparity of the plate's face; all disparities here are in units of the image's noise."""
    measured: np.ndarray
    """(h, w) disparity beyond that of the face: negative in a cavity."""
    shown: np.ndarray
    """(h, w) bool: pixels that show the plate or its cavity."""


@dataclass(frozen=True, eq=False)
class ImageFit:
    """A fit, moved and rotated in its plate to where the image shows the cavity."""

    plate_from_now: Pose
    problem: ImageProblem
    twist: np.ndarray
    """(6,) that solves the problem."""

    def cost(self) -> float:
        """The mean cost of the pixels at the last of SCALES: 0 if all of them agree, 1 if none does."""
        problem, twist = self.problem, self.twist
        square = problem.residuals(twist[None], problem.floors_at(twist))[0, : -problem.priors] ** 2
        return float((square / (SCALES[-1] ** 2 + square)).mean())

    def spread(self) -> float:
        """[m] standard deviation of the place, by the residuals, along the less certain axis of the plate."""
        problem, twist = self.problem, self.twist
        residuals, normal, _ = linearised(problem, twist, problem.floors_at(twist), SCALES[-1], DIFFERENCES)
        regular = normal + REGULAR * np.trace(normal) * np.eye(6)
        variances = [solve_positive(regular, np.eye(6)[k])[k] for k in (3, 4)]
        return max(float(np.sqrt(max(variances) * np.square(residuals[: -problem.priors]).mean())), LEAST_SPREAD)


def refine_in_image(
    image: LabelledDepth,
    gain: float,
    part: Volume,
    middle: np.ndarray,
    candidate: Candidate,
    clearance: float,
) -> ImageFit | None:
    """The refined fit; None if too few pixels show the plate.

    Args:
        image: restored, with masks.
        gain: [m] disparity times depth, with the disparity in units of the image's noise.
        part: as it lies now.
        middle: (3,) [m] world, of the part.
        candidate: the fit; its tilt and height stay.
        clearance: [m]
    """
    pose = candidate.plate_from_now
    pivot = pose.apply(middle)
    heights = cavity_heights(part, pose, pivot, clearance)
    plate = _plate_in_image(image, gain, candidate.cavity.world_from_plate, pivot, _radius(heights) + AROUND)
    if plate is None:
        return None
    problem = ImageProblem(plate, heights, pivot, gain)
    twist = descend(problem, np.zeros(6), SCALES, DIFFERENCES)
    rotation = Pose(np.array([1.0, 0.0, 0.0, twist[0] / 2]), np.zeros(3))
    about = Pose.from_translation((-pivot[0], -pivot[1], 0.0))
    refined = Pose.from_translation((*(pivot[:2] + twist[3:5]), 0.0)) @ rotation @ about @ pose
    return ImageFit(refined, problem, twist)


def _radius(heights: np.ndarray) -> float:
    """[m] from the middle of a height map (n, n) [m] to the farthest cell of its cavity."""
    cells = np.argwhere(heights < -LEAST_CUT) - (len(heights) - 1) / 2
    return RAY_CELL * float(np.sqrt(np.square(cells).sum(1).max(initial=0.0)))


def _plate_in_image(
    image: LabelledDepth, gain: float, world_from_plate: Pose, pivot: np.ndarray, radius: float
) -> PlateInImage | None:
    """The pixels within a radius [m] of a pivot (3,) [m]; None if too few of them show the plate."""
    camera, pose = image.view.camera, world_from_plate.inverse() @ image.view.world_from_camera
    middle = pose.inverse().apply(pivot * (1.0, 1.0, 0.0))
    if middle[2] <= radius:
        return None
    box = _box(image.view, camera.project(middle), int(np.ceil(radius * camera.fx / middle[2])) + BORDER)
    v, u = np.mgrid[box]
    rays = pose.rotate(camera.unproject_pixels(np.stack([u, v], -1).reshape(-1, 2), np.ones(u.size)))
    if not u.size or (rays[:, 2] >= 0).any() or pose.xyz[2] <= 0:
        return None
    to_face = -pose.xyz[2] / rays[:, 2]
    face = (gain / to_face).reshape(u.shape)
    away = pose.xyz[:2] + to_face[:, None] * rays[:, :2] - pivot[:2]
    depth, kits = image.view.depth[box].astype(float), image.labels[box] == ASSEMBLY_LABEL
    inside = ~np.asarray(binary_dilation(~kits, iterations=BORDER), bool)
    behind = depth - to_face.reshape(u.shape)
    shown = inside & (depth > 0) & (behind > -IN_FRONT) & (behind < BEHIND)
    shown &= (np.square(away).sum(1) < radius**2).reshape(u.shape)
    if np.count_nonzero(shown) < LEAST_PIXELS:
        return None
    measured = gain / np.where(depth > 0, depth, np.inf) - face
    return PlateInImage(pose.xyz, np.ascontiguousarray(rays), face, measured, shown)


def _box(view: View, middle: np.ndarray, reach: int) -> tuple[slice, slice]:
    """The rows and columns within a reach [px] of a place (u, v) [px]."""
    (u, v), (rows, columns) = np.rint(middle).astype(int).tolist(), view.depth.shape
    return (
        slice(min(max(v - reach, 0), rows), min(max(v + reach + 1, 0), rows)),
        slice(min(max(u - reach, 0), columns), min(max(u + reach + 1, 0), columns)),
    )


@dataclass(frozen=True, eq=False)
class ImageProblem:
    """The least-squares problem: the image less the rendered plate.

    A twist (6,) holds the yaw [rad] of the part about its pivot, the slopes of the bend across and down the box, the
    place x and y [m], and the bend in the middle. Slopes are in units of LEVER times BEND at the box's sides.
    """

    plate: PlateInImage
    heights: np.ndarray
    """(n, n) [m] heights of the cavity about the pivot, 0 on the plate's face; cells of RAY_CELL."""
    pivot: np.ndarray
    """(3,) [m] plate frame."""
    gain: float
    """[m] see `refine_in_image`."""

    @property
    def priors(self) -> int:
        """Yaw and place."""
        return 3

    @cached_property
    def bends(self) -> np.ndarray:
        """(3, n) disparities of unit bends across, down and in the middle, at the pixels that are shown."""
        (rows, columns), (v, u) = self.plate.face.shape, np.nonzero(self.plate.shown)
        return BEND * np.stack([LEVER * (2 * u / columns - 1), LEVER * (2 * v / rows - 1), np.ones(len(u))])

    def floors_at(self, twist: np.ndarray) -> np.ndarray:
        """Nothing: this problem has no floors."""
        return np.empty((0, 0))

    def residuals(self, twists: np.ndarray, floors: np.ndarray) -> np.ndarray:
        """(m, n + 3) at twists (m, 6)."""
        places, which = np.unique(twists[:, [0, 3, 4]], axis=0, return_inverse=True)
        beyond = np.stack([(self.plate.measured - self.rendered(place))[self.plate.shown] for place in places])
        held = HOLD * twists[:, [0, 3, 4]] * (LEVER, 1.0, 1.0)
        return np.concatenate([beyond[which.ravel()] - matmul(twists[:, [1, 2, 5]], self.bends), held], axis=1)

    def rendered(self, place: np.ndarray) -> np.ndarray:
        """(h, w) disparities beyond the face, at a place (3,): yaw [rad] and offset x, y [m] from the fit."""
        depth = np.empty(self.plate.face.size)
        trace(self.plate.origin, self.plate.rays, self.heights, self.pivot[:2] + place[1:], place[0] / 2, depth)
        beyond = self.gain / depth.reshape(self.plate.face.shape) - self.plate.face
        return np.asarray(uniform_filter(beyond, 2 * HALF + 1))


@dataclass(frozen=True, eq=False)
class PlatePatch:
    """What an image shows about a fit, on a grid on the face of its plate."""

    channels: np.ndarray
    """(Channel, n, n) float32, cells of CELL."""
    world_from_patch: Pose

    def moved(self, goal_from_now: Pose, middle: np.ndarray, move: np.ndarray) -> Pose:
        """The motion of a fit, followed by a move in the plate.

        Args:
            goal_from_now: the motion of the fit.
            middle: (3,) [m] world, of the part now; the yaw is about its goal.
            move: (3,) yaw [rad], shift along the axes of the patch [m].
        """
        patch_from_world = self.world_from_patch.inverse()
        pivot = (patch_from_world @ goal_from_now).apply(middle)
        shifted = pivot + (move[1], move[2], 0.0)
        about = Pose(np.array([1.0, 0.0, 0.0, move[0] / 2]), shifted) @ Pose.from_translation(-pivot)
        return self.world_from_patch @ about @ patch_from_world @ goal_from_now

    def twist_to(self, true: Pose, goal_from_now: Pose, middle: np.ndarray) -> np.ndarray:
        """(6,) rotation vector [rad] and shift [m], in the frame of the patch, from a fit to the true motion."""
        patch_from_world = self.world_from_patch.inverse()
        pivot = (patch_from_world @ goal_from_now).apply(middle)
        difference = patch_from_world @ true @ goal_from_now.inverse() @ self.world_from_patch
        return np.concatenate([difference.rotvec(), difference.apply(pivot) - pivot])


def plate_patch(
    part: PartShape, image: RestoredImage, candidate: Candidate, clearance: float, cells: int
) -> PlatePatch | None:
    """The patch of a fit; None if the camera does not see the plate's face from above.

    Args:
        part: as it lies now.
        image: a noisy image, restored.
        candidate: the fit.
        clearance: [m]
        cells: along a side.
    """
    world_from_plate = candidate.cavity.world_from_plate
    view = image.restored.view
    plate_from_camera = world_from_plate.inverse() @ view.world_from_camera
    pivot = candidate.plate_from_now.apply(part.middle)
    plate_from_patch = Pose(_yaw_along(pivot[:2] - plate_from_camera.xyz[:2]), np.array([*pivot[:2], 0.0]))
    along = (np.arange(cells) - (cells - 1) / 2) * CELL
    x, y = np.meshgrid(along, along, indexing="ij")
    face = plate_from_patch.apply(np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3))
    seen = plate_from_camera.inverse().apply(face)
    if plate_from_camera.xyz[2] <= 0 or (seen[:, 2] <= 0).any():
        return None
    pixels = _Pixels(view.camera, view.camera.project(seen), image.gain / seen[:, 2], image.gain)
    rays = _Rays.of(pixels, plate_from_camera)
    if rays is None:
        return None
    channels = np.zeros((len(Channel), cells * cells), np.float32)
    channels[Channel.RESTORED], channels[Channel.IS_RESTORED] = pixels.beyond(image.restored)
    channels[Channel.MEASURED], channels[Channel.IS_MEASURED] = pixels.beyond(image.measured)
    heights = cavity_heights(part.bounds.filled, candidate.plate_from_now, pivot, clearance)
    channels[Channel.CAVITY] = rays.beyond(heights, pivot, pixels)
    channels[Channel.HEIGHTS] = _heights(heights, face[:, :2] - pivot[:2])
    for channel, logit in ((Channel.WIDER, WIDER), (Channel.SLIMMER, SLIMMER)):
        other = cavity_heights(part.solid_above(logit), candidate.plate_from_now, pivot, clearance)
        channels[channel] = rays.beyond(other, pivot, pixels)
    return PlatePatch(channels.reshape(-1, cells, cells), world_from_plate @ plate_from_patch)


def _yaw_along(direction: np.ndarray) -> np.ndarray:
    """(4,) the rotation about z that takes the x axis along a direction (2,); square roots are exact everywhere."""
    cosine = direction[0] / max(length(direction), LEAST_LENGTH)
    half_sine = np.sqrt(max(1 - cosine, 0.0) / 2)
    return np.array([np.sqrt(max(1 + cosine, 0.0) / 2), 0.0, 0.0, half_sine if direction[1] >= 0 else -half_sine])


def _heights(heights: np.ndarray, places: np.ndarray) -> np.ndarray:
    """(k,) [m] heights of a map at places (k, 2) [m] about its middle; 0 beyond it."""
    cells = places / RAY_CELL + (len(heights) - 1) / 2
    return map_coordinates(heights, cells.T, order=1, mode="constant", cval=0.0)


@dataclass(frozen=True, eq=False)
class _Pixels:
    """The places in an image of the cells of a patch on the plate's face."""

    camera: Camera
    uv: np.ndarray
    """(k, 2) [px]"""
    face: np.ndarray
    """(k,) [px] disparities."""
    gain: float
    """[px m] disparity times depth."""

    def beyond(self, image: LabelledDepth) -> tuple[np.ndarray, np.ndarray]:
        """(k,) [px] disparities of an image beyond the face, 0 without kit; (k,) share of the pixels that show kits."""
        depth = image.view.depth[self.box]
        shown = (depth > 0) & (image.labels[self.box] == ASSEMBLY_LABEL)
        disparity = np.where(shown, self.gain / np.where(shown, depth, 1.0), 0.0)
        total, share = (self.between(values, "constant") for values in (disparity, shown.astype(float)))
        beyond = total / np.maximum(share, 1e-6) - self.face
        return np.where(share > 0.5, np.clip(beyond, -LARGEST_DISPARITY, LARGEST_DISPARITY), 0.0), share

    @cached_property
    def corner(self) -> np.ndarray:
        """(2,) [px] u, v of the first pixel about the cells."""
        return self._inside(np.min)

    @cached_property
    def box(self) -> tuple[slice, slice]:
        """Rows and columns about the cells, and one more."""
        (left, top), (right, bottom) = self.corner, self._inside(np.max) + 2
        return np.s_[top:bottom, left:right]

    def _inside(self, end: Callable[..., np.ndarray]) -> np.ndarray:
        """(2,) [px] the least or the largest u and v, in the image."""
        return np.clip(end(self.uv, axis=0), 0, (self.camera.width - 1, self.camera.height - 1)).astype(int)

    def between(self, values: np.ndarray, mode: str) -> np.ndarray:
        """(k,) values (h, w) of the box, interpolated at the cells; beyond the box by a mode of `scipy.ndimage`."""
        return map_coordinates(values, (self.uv - self.corner).T[::-1], order=1, mode=mode)


@dataclass(frozen=True, eq=False)
class _Rays:
    """The rays of a box of an image, in the plate frame."""

    shape: tuple[int, int]
    origin: np.ndarray
    """(3,) [m] the camera."""
    directions: np.ndarray
    """(h * w, 3) of depth 1, row by row."""

    @staticmethod
    def of(pixels: _Pixels, plate_from_camera: Pose) -> _Rays | None:
        """The rays of the box of pixels; None if one of them misses the plate."""
        v, u = np.mgrid[pixels.box]
        ends = pixels.camera.unproject_pixels(np.stack([u, v], -1).reshape(-1, 2), np.ones(u.size))
        directions = np.ascontiguousarray(plate_from_camera.rotate(ends))
        if (directions[:, 2] >= 0).any():
            return None
        return _Rays(u.shape, plate_from_camera.xyz, directions)

    def beyond(self, heights: np.ndarray, pivot: np.ndarray, pixels: _Pixels) -> np.ndarray:
        """(k,) [px] disparities beyond the face at which these rays meet a height map about a pivot, at the cells."""
        depth = np.empty(len(self.directions))
        trace(self.origin, self.directions, heights, pivot[:2], 0.0, depth)
        face = -self.origin[2] / self.directions[:, 2]
        beyond = (pixels.gain / depth - pixels.gain / face).reshape(self.shape)
        return pixels.between(beyond, "nearest")
