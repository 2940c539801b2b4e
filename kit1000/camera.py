"""A pinhole camera in the convention of OpenCV: +x right, +y down, +z forward, depth along z.

The centre of pixel (u, v) is at exactly (u, v), so the image covers -0.5 .. width - 0.5 across and -0.5 .. height - 0.5
down. Lengths are in m, image coordinates in pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from kit1000.errors import InputError, ShapeError, checked
from kit1000.numerics.linear_algebra import length
from kit1000.pose import Pose, unit_vector

# With a view direction this close [sine of the angle] to `up`, rounding would determine the roll of the camera.
UPRIGHT_TOLERANCE = 1e-6

NEAREST = 1e-3  # [m] depth up to which a point has no window


@dataclass(frozen=True)
class Camera:
    """Intrinsics of a pinhole camera without distortion."""

    width: int
    """Number of columns of the image."""
    height: int
    """Number of rows of the image."""
    fx: float
    """Focal length across [pixels]."""
    fy: float
    """Focal length down [pixels]."""
    cx: float
    """Column of the principal point [pixels], from the centre of the first pixel."""
    cy: float
    """Row of the principal point [pixels], from the centre of the first pixel."""

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            size = getattr(self, name)
            if size != int(size) or size < 1:
                raise InputError(f"{name}: expected a whole number of pixels from 1 up, got {size}")
            object.__setattr__(self, name, int(size))
        for name in ("fx", "fy", "cx", "cy"):
            object.__setattr__(self, name, float(checked(name, getattr(self, name), ())))
        if self.fx <= 0 or self.fy <= 0:
            raise InputError(f"fx, fy: expected focal lengths above 0, got {self.fx}, {self.fy}")

    @property
    def K(self) -> np.ndarray:
        """The intrinsic matrix: (u, v, 1) is proportional to K (x, y, z). (3, 3) float64."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def project(self, points_cam: ArrayLike) -> np.ndarray:
        """Image coordinates of points, inside the image or not; NaN for points at or behind the camera plane.

        Args:
            points_cam: points in the camera frame. (..., 3) [m].

        Returns:
            (..., 2) float64 (u, v) [pixels].
        """
        points = checked("points_cam", points_cam, (..., 3))
        z = np.where(points[..., 2] > 0, points[..., 2], np.nan)
        return np.stack([self.fx * points[..., 0] / z + self.cx, self.fy * points[..., 1] / z + self.cy], axis=-1)

    def unproject(self, depth: ArrayLike) -> np.ndarray:
        """The point seen by each pixel; (0, 0, 0) where the depth is 0 (no return).

        Args:
            depth: z of the surface at each pixel. (height, width) [m].

        Returns:
            (height, width, 3) float64 [m], in the camera frame.
        """
        z = checked("depth", depth, (self.height, self.width))
        v, u = np.indices(z.shape)
        return self.unproject_pixels(np.stack([u, v], axis=-1), z)

    def unproject_pixels(self, uv: ArrayLike, depth: ArrayLike) -> np.ndarray:
        """The points at image coordinates (..., 2) (u, v) [pixels] and depths (...,) [m]. (..., 3) [m]."""
        pixels, z = checked("uv", uv, (..., 2)), checked("depth", depth, (...,))
        if z.ndim > 0 and z.shape != pixels.shape[:-1]:
            raise ShapeError(f"depth: expected one depth or shape {pixels.shape[:-1]}, got shape {z.shape}")
        x = (pixels[..., 0] - self.cx) / self.fx * z
        y = (pixels[..., 1] - self.cy) / self.fy * z
        return np.stack([x, y, np.broadcast_to(z, x.shape)], axis=-1)

    def scaled(self, factor: float) -> Camera:
        """The same view with `factor` times as many rows and columns, rounded to integers.

        The image borders, half a pixel outside the outer pixel centres, do not move; where rounding changes the aspect
        ratio, fx and fy differ slightly.
        """
        if not 0 < factor < np.inf:
            raise InputError(f"factor: expected a number above 0, got {factor}")
        width, height = max(round(self.width * factor), 1), max(round(self.height * factor), 1)
        across, down = width / self.width, height / self.height
        return Camera(
            width=width,
            height=height,
            fx=self.fx * across,
            fy=self.fy * down,
            cx=(self.cx + 0.5) * across - 0.5,
            cy=(self.cy + 0.5) * down - 0.5,
        )

    def window(
        self, points_cam: np.ndarray, low: ArrayLike, high: ArrayLike, margin: int = 0, step: int = 1
    ) -> tuple[int, int, Camera]:
        """The window of an image in which points lie: its first column and row [px], and a camera of it alone.

        Args:
            points_cam: (n, 3) [m] in the camera frame; if some are not in front of the camera, the window is largest.
            low: (2,) first column and row of the largest window; negative ones are beyond the image.
            high: (2,) the columns and rows after its last ones.
            margin: [px] around the points.
            step: [px] of which the first column and row are multiples.
        """
        first, last = np.array(low), np.array(high)
        if points_cam[:, 2].min() > NEAREST:
            pixels = self.project(points_cam)
            first = np.clip(np.floor(pixels.min(0)) - margin, low, last - step) // step * step
            last = np.clip(np.ceil(pixels.max(0)) + 1 + margin, first + step, high)
        (left, top), (width, height) = first.astype(int).tolist(), (last - first).astype(int).tolist()
        return left, top, Camera(width, height, self.fx, self.fy, self.cx - left, self.cy - top)


def look_at(eye: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 0.0, 1.0)) -> Pose:
    """The pose `world_from_camera` of a camera at `eye` that looks at `target`, `up` upward in its image.

    Args:
        eye: position of the camera. (3,) [m], world.
        target: point that projects to the principal point. (3,) [m], world.
        up: direction that is upward in the image; rejected when it is parallel to the line of sight. (3,), world.

    Returns:
        One pose, with the axes of OpenCV.
    """
    position = checked("eye", eye, (3,))
    forward = unit_vector(checked("target", target, (3,)) - position, "target - eye")
    right = np.cross(forward, unit_vector(checked("up", up, (3,)), "up"))
    if length(right) < UPRIGHT_TOLERANCE:
        raise InputError("up: expected a direction off the line of sight, got one along it")
    right = unit_vector(right)
    axes = np.stack([right, np.cross(forward, right), forward], axis=-1)
    return Pose.from_rotation_matrix(axes, position)
