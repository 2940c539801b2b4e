"""Patches: what an image shows about a fit, on a grid on the face of its plate that looks away from the camera.

A patch lies below the middle of the part, its first axis away from the camera, its z axis out of the plate. All its
disparities are those beyond the face's: negative in a cavity. So a plate may stand anywhere, and its patch is the same.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import map_coordinates

from kit1000.camera import Camera
from kit1000.numerics.linear_algebra import length
from kit1000.perception.placement.channels import CELL, Channel
from kit1000.pose import Pose
from kit1000.registration.geometry import relief_rays
from kit1000.registration.geometry.relief_rays import cavity_relief, trace
from kit1000.registration.inputs.volume_sources import DepthSource
from kit1000.registration.search.correlation import Candidate
from kit1000.values import ASSEMBLY_LABEL, LabelledDepth
from kit1000.voxels import Volume

LARGEST = 24.0  # [px] of a disparity beyond the face: what is farther from it is another surface
LEAST_LENGTH = 1e-9  # [m] of a direction


@dataclass(frozen=True, eq=False)
class PlatePatch:
    """A fit in an image."""

    channels: np.ndarray
    """(Channel, n, n) float32, cells of CELL."""
    world_from_patch: Pose

    def moved(self, goal_from_now: Pose, middle: np.ndarray, move: np.ndarray) -> Pose:
        """A motion of the part, followed by a move in the plate.

        Args:
            goal_from_now: of the fit.
            middle: (3,) [m] world, of the part now; the yaw is about where the fit takes it.
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


def plate_patch(source: DepthSource, candidate: Candidate, clearance: float, cells: int) -> PlatePatch | None:
    """The patch of a fit; None where the camera does not see the plate's face from above.

    Args:
        source: of a noisy image.
        candidate: the fit.
        clearance: [m]
        cells: of a side.
    """
    world_from_plate = candidate.cavity.world_from_plate
    plate_from_camera = world_from_plate.inverse() @ source.query.view.world_from_camera
    pivot = candidate.plate_from_now.apply(source.middle)
    plate_from_patch = Pose(_yaw_along(pivot[:2] - plate_from_camera.xyz[:2]), np.array([*pivot[:2], 0.0]))
    along = (np.arange(cells) - (cells - 1) / 2) * CELL
    x, y = np.meshgrid(along, along, indexing="ij")
    face = plate_from_patch.apply(np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3))
    seen = plate_from_camera.inverse().apply(face)
    if plate_from_camera.xyz[2] <= 0 or (seen[:, 2] <= 0).any():
        return None
    camera = source.query.view.camera
    pixels = _Pixels(camera, camera.project(seen), source.gain / seen[:, 2], source.gain)
    channels = np.zeros((len(Channel), cells * cells), np.float32)
    restored, measured = source.query.image, source.measured or source.query.image
    channels[Channel.RESTORED], channels[Channel.IS_RESTORED] = pixels.beyond(restored)
    channels[Channel.MEASURED], channels[Channel.IS_MEASURED] = pixels.beyond(measured)
    rays = _Rays.of(pixels, plate_from_camera)
    if rays is None:
        return None
    for channel, part in _parts(source).items():
        relief = cavity_relief(part, candidate.plate_from_now, pivot, clearance)
        channels[channel] = rays.beyond(relief, pivot, pixels)
        if channel == Channel.CAVITY:
            channels[Channel.RELIEF] = _heights(relief, face[:, :2] - pivot[:2])
    return PlatePatch(channels.reshape(-1, cells, cells), world_from_plate @ plate_from_patch)


def _yaw_along(direction: np.ndarray) -> np.ndarray:
    """(4,) the rotation about z that takes the x axis along a direction (2,), by roots alone: they are exact."""
    cosine = direction[0] / max(length(direction), LEAST_LENGTH)
    half_sine = np.sqrt(max(1 - cosine, 0.0) / 2)
    return np.array([np.sqrt(max(1 + cosine, 0.0) / 2), 0.0, 0.0, half_sine if direction[1] >= 0 else -half_sine])


def _parts(source: DepthSource) -> dict[Channel, Volume]:
    """The part as the search takes it, and slimmer and wider."""
    return {
        Channel.CAVITY: source.evidence.filled,
        Channel.WIDER: source.wider,
        Channel.SLIMMER: source.slimmer,
    }


def _heights(relief: np.ndarray, places: np.ndarray) -> np.ndarray:
    """(k,) [m] of a relief at places (k, 2) [m] about its middle; 0 beyond it."""
    cells = places / relief_rays.CELL + (len(relief) - 1) / 2
    return map_coordinates(relief, cells.T, order=1, mode="constant", cval=0.0)


@dataclass(frozen=True, eq=False)
class _Pixels:
    """Where an image shows the cells of a patch, if nothing but the plate's face is there."""

    camera: Camera
    uv: np.ndarray
    """(k, 2) [px]"""
    face: np.ndarray
    """(k,) [px] disparities."""
    gain: float
    """[px m] disparity times depth."""

    def beyond(self, image: LabelledDepth) -> tuple[np.ndarray, np.ndarray]:
        """(k,) [px] disparities of an image beyond the face, 0 where it shows no kit; and (k,) the share that does."""
        depth = image.view.depth[self.box]
        shown = (depth > 0) & (image.labels[self.box] == ASSEMBLY_LABEL)
        disparity = np.where(shown, self.gain / np.where(shown, depth, 1.0), 0.0)
        total, share = (self.between(values, "constant") for values in (disparity, shown.astype(float)))
        beyond = total / np.maximum(share, 1e-6) - self.face
        return np.where(share > 0.5, np.clip(beyond, -LARGEST, LARGEST), 0.0), share

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
        """(k,) values (h, w) of the box between its pixels; beyond them by a mode of `scipy.ndimage`."""
        return map_coordinates(values, (self.uv - self.corner).T[::-1], order=1, mode=mode)


@dataclass(frozen=True, eq=False)
class _Rays:
    """The rays of a box of an image, plate frame."""

    shape: tuple[int, int]
    origin: np.ndarray
    """(3,) [m] the camera."""
    directions: np.ndarray
    """(h * w, 3) of a depth of 1, row by row."""

    @staticmethod
    def of(pixels: _Pixels, plate_from_camera: Pose) -> _Rays | None:
        """The rays of the box of pixels; None where one of them misses the plate."""
        v, u = np.mgrid[pixels.box]
        ends = pixels.camera.unproject_pixels(np.stack([u, v], -1).reshape(-1, 2), np.ones(u.size))
        directions = np.ascontiguousarray(plate_from_camera.rotate(ends))
        if (directions[:, 2] >= 0).any():
            return None
        return _Rays(u.shape, plate_from_camera.xyz, directions)

    def beyond(self, relief: np.ndarray, pivot: np.ndarray, pixels: _Pixels) -> np.ndarray:
        """(k,) [px] disparities beyond the face where these rays meet a relief about a pivot, at the cells' pixels."""
        depth = np.empty(len(self.directions))
        trace(self.origin, self.directions, relief, pivot[:2], 0.0, depth)
        face = -self.origin[2] / self.directions[:, 2]
        beyond = (pixels.gain / depth - pixels.gain / face).reshape(self.shape)
        return pixels.between(beyond, "nearest")
