"""Where the cameras stand: the one drawn anew for each scene, and the fixed ones around and above the table.

World: z up, table top at z = 0, kits at y > 0, loose parts at y < 0. Cameras on the +x or the -x side have y across
their image. Lengths are metres, angles radians, poses `world_from_camera`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from kit1000.camera import Camera, look_at
from kit1000.errors import InputError, checked
from kit1000.pose import Pose

# The image and the focal length of the release of the paper (there 925.27 px), which are those of its real camera;
# the principal point is the middle of the image.
CAMERA = Camera(width=1280, height=720, fx=925.0, fy=925.0, cx=639.5, cy=359.5)

# (2, 3) [m] lowest and highest corner of what may stand on the table: an assembly near (0, 0.2), up to 0.13 m high, and
# the parts near (0, -0.17). A layout keeps within it.
WORKSPACE = np.array([[-0.19, -0.345, 0.0], [0.19, 0.39, 0.13]])
WORKSPACE.setflags(write=False)

LOOK_AT = (0.0, 0.03, 0.02)  # between the halves, towards the assembly, which is the wider and the higher
# The release draws radius U(0.6, 1.0) m, polar angle U(0.5, 1.375) rad from the vertical and any azimuth, for one
# camera a half. The radius is kept. The polar angle ends where the far plates begin to hide behind the near ones,
# the azimuth before one image stops holding both halves: 99 of 100 layouts fit whole.
RADIUS = (0.6, 1.0)
POLAR = (float(np.radians(28)), float(np.radians(60)))
AZIMUTH = float(np.radians(30))  # most, to either side of the x axis

# The fixed cameras look at the middle of the workspace from as near as all of it stays in view, at 1.1 mm a pixel or
# finer: the pixel of the release's height maps is 1.094 mm. Its three cameras stand flatter, at 50 and 56 degrees on
# three sides, for a workspace twice as wide; in their place ours would see 73 % of the cavities' surface, here 86 %.
MIDDLE = (0.0, 0.025, 0.05)
AROUND_RADIUS = 1.02
AROUND_POLAR = float(np.radians(40))
AROUND_AZIMUTHS_DEG = (90.0, 210.0, 330.0)  # one over the kits, two over the parts
ABOVE_HEIGHT = 0.65

CAMERA_SETS = ("primary", "three", "top")


def draw_primary(rng: np.random.Generator) -> Pose:
    """The pose of a scene's own camera: on the +x or the -x side, uniform in radius, polar angle and azimuth."""
    radius, polar, azimuth = rng.uniform(*RADIUS), rng.uniform(*POLAR), rng.uniform(-AZIMUTH, AZIMUTH)
    return _orbit(radius, polar, azimuth + np.pi * rng.integers(2))


def camera_set(name: str, primary: Pose | None = None) -> dict[str, tuple[Camera, Pose]]:
    """The cameras of a set and their poses, by the prefix that their images have in a recording.

    primary: the scene's own camera, key "", which was drawn. three: around the table, for height maps, keys
    "three/0" to "three/2". top: straight above the table, key "top".
    """
    if name == "primary":
        if primary is None:
            raise InputError("camera set 'primary': expected the pose that was drawn for the scene, got none")
        return {"": (CAMERA, primary)}
    if name == "three":
        return {f"three/{i}": (CAMERA, pose) for i, pose in enumerate(_around())}
    if name == "top":
        return {"top": (CAMERA, _above())}
    raise InputError(f"camera set {name!r}: expected one of {', '.join(CAMERA_SETS)}")


def in_view(camera: Camera, world_from_camera: Pose, points: ArrayLike, margin_px: float = 0.0) -> bool:
    """Whether all points (..., 3) [m] of the world project at least `margin_px` inside the edges of the image."""
    uv = camera.project(world_from_camera.inverse().apply(checked("points", points, (..., 3))))
    low, high = margin_px - 0.5, np.array([camera.width, camera.height]) - 0.5 - margin_px
    return bool(((uv >= low) & (uv <= high)).all())  # NaN, of points behind the camera, is not inside


def _orbit(radius: float, polar: float, azimuth: float, target: ArrayLike = LOOK_AT) -> Pose:
    """A camera at spherical coordinates about the target, looking at it, +z upward in its image."""
    across, up = radius * np.sin(polar), radius * np.cos(polar)
    return look_at(np.asarray(target) + (across * np.cos(azimuth), across * np.sin(azimuth), up), target)


def _around() -> list[Pose]:
    return [_orbit(AROUND_RADIUS, AROUND_POLAR, float(np.radians(turn)), MIDDLE) for turn in AROUND_AZIMUTHS_DEG]


def _above() -> Pose:
    """Rows of its image run along x as those of a camera on the +x side do, columns along y."""
    return look_at(np.asarray(MIDDLE) + (0, 0, ABOVE_HEIGHT), MIDDLE, up=(-1.0, 0.0, 0.0))
