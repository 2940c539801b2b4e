"""Refinement in a noisy image: the plate is rendered with the cavity that the part would cut, and compared with it.

In a volume, noise of a pixel's disparity becomes walls that are millimetres off. In the image it stays noise, the same
for all pixels. So a fit's place and yaw in its plate are refined until the rendered disparities are those of the image,
less their bend: how far the plate's face itself is off, which is no matter of the cavity's place.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import binary_dilation, uniform_filter

from kit1000.numerics.elimination import solve_positive
from kit1000.numerics.linear_algebra import matmul
from kit1000.pose import Pose
from kit1000.registration.geometry.relief_rays import CELL, cavity_relief, trace
from kit1000.registration.refinement.levenberg_marquardt import LEVER, descend, linearised
from kit1000.registration.search.correlation import Candidate
from kit1000.values import ASSEMBLY_LABEL, LabelledDepth, View
from kit1000.voxels import Volume

LEAST_CUT = 1e-3  # [m] below the face, of cells that belong to the cavity
AROUND = 10e-3  # [m] about the cavity, of the plate that is compared
BORDER = 5  # [px] inside the masks of the kits: beyond it the image is of something else
IN_FRONT, BEHIND = 12e-3, 60e-3  # [m] of depth from the face, up to which a pixel shows the plate or its cavity
LEAST_PIXELS = 200  # that are compared
HOLD = 620.0  # [1/m] by which a fit is held where it was: it wins where the image shows no rim
HALF = 1  # px on either side over which rendered disparities are averaged: edges of the image are as soft
BEND = 2e3  # of a unit of bend, so that all unknowns weigh about as much as a move of the cavity
DIFFERENCES = np.array([14e-3, 1e-3, 1e-3, 0.4e-3, 0.4e-3, 0.05e-3])  # a rendered image changes in steps of a pixel
SCALES = (2.0, 1.0)  # of the Geman-McClure weights
LEAST_SPREAD = 1e-6  # [m] of a place: no image is exact
REGULAR = 1e-9  # share of its trace on the diagonal of a matrix that is solved: pixels in a row determine no slope


@dataclass(frozen=True, eq=False)
class PlateInImage:
    """The pixels of an image that show a plate about a fit, as seen from the plate's frame."""

    origin: np.ndarray
    """(3,) [m] the camera, plate frame."""
    rays: np.ndarray
    """(h * w, 3) directions of a depth of 1, plate frame, row by row of a box of the image."""
    face: np.ndarray
    """(h, w) disparity of the plate's face, in units of the image's noise as all disparities here."""
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

    @cached_property
    def misfit(self) -> float:
        """The mean cost of the pixels at the last of SCALES: 0 where all of them agree, 1 where none does."""
        problem, twist = self.problem, self.twist
        square = problem.residuals(twist[None], problem.floors_at(twist))[0, : -problem.priors] ** 2
        return float((square / (SCALES[-1] ** 2 + square)).mean())

    @cached_property
    def spread(self) -> float:
        """[m] standard deviation of the place that the residuals leave, along the less certain axis of the plate."""
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
    """The refined fit; None where too few pixels show the plate.

    Args:
        image: restored, with masks.
        gain: [m] disparity times depth, the disparity in units of the image's noise.
        part: as it lies now.
        middle: (3,) [m] world, of the part.
        candidate: the fit; its tilt and height stay.
        clearance: [m]
    """
    pose = candidate.plate_from_now
    pivot = pose.apply(middle)
    relief = cavity_relief(part, pose, pivot, clearance)
    plate = _plate_in_image(image, gain, candidate.cavity.world_from_plate, pivot, _radius(relief) + AROUND)
    if plate is None:
        return None
    problem = ImageProblem(plate, relief, pivot, gain)
    twist = descend(problem, np.zeros(6), SCALES, DIFFERENCES)
    rotation = Pose(np.array([1.0, 0.0, 0.0, twist[0] / 2]), np.zeros(3))
    about = Pose.from_translation((-pivot[0], -pivot[1], 0.0))
    refined = Pose.from_translation((*(pivot[:2] + twist[3:5]), 0.0)) @ rotation @ about @ pose
    return ImageFit(refined, problem, twist)


def _radius(relief: np.ndarray) -> float:
    """[m] from the middle of a relief (n, n) [m] to the farthest cell of its cavity."""
    cells = np.argwhere(relief < -LEAST_CUT) - (len(relief) - 1) / 2
    return CELL * float(np.sqrt(np.square(cells).sum(1).max(initial=0.0)))


def _plate_in_image(
    image: LabelledDepth, gain: float, world_from_plate: Pose, pivot: np.ndarray, radius: float
) -> PlateInImage | None:
    """The pixels within a radius [m] of a pivot (3,) [m]; None where too few of them show the plate."""
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

    Its twists (6,) are the yaw [rad] of the part about its pivot, the slopes of the bend across and down the box, the
    place x and y [m], and the bend in the middle; slopes are in units of LEVER times BEND at the box's sides.
    """

    plate: PlateInImage
    relief: np.ndarray
    """(n, n) [m] heights of the cavity about the pivot, 0 on the plate's face; cells of CELL."""
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
        """(3, n) disparities of units of bend across, down and in the middle, at the pixels that are shown."""
        (rows, columns), (v, u) = self.plate.face.shape, np.nonzero(self.plate.shown)
        return BEND * np.stack([LEVER * (2 * u / columns - 1), LEVER * (2 * v / rows - 1), np.ones(len(u))])

    def floors_at(self, twist: np.ndarray) -> np.ndarray:
        """Nothing: no floor is kept while derivatives are taken."""
        return np.empty((0, 0))

    def residuals(self, twists: np.ndarray, floors: np.ndarray) -> np.ndarray:
        """(m, n + 3) at twists (m, 6)."""
        places, which = np.unique(twists[:, [0, 3, 4]], axis=0, return_inverse=True)
        beyond = np.stack([(self.plate.measured - self.rendered(place))[self.plate.shown] for place in places])
        held = HOLD * twists[:, [0, 3, 4]] * (LEVER, 1.0, 1.0)
        return np.concatenate([beyond[which.ravel()] - matmul(twists[:, [1, 2, 5]], self.bends), held], axis=1)

    def rendered(self, place: np.ndarray) -> np.ndarray:
        """(h, w) disparities beyond those of the face, at a yaw [rad] and an offset x, y [m] from the fit."""
        depth = np.empty(self.plate.face.size)
        trace(self.plate.origin, self.plate.rays, self.relief, self.pivot[:2] + place[1:], place[0] / 2, depth)
        beyond = self.gain / depth.reshape(self.plate.face.shape) - self.plate.face
        return np.asarray(uniform_filter(beyond, 2 * HALF + 1))
