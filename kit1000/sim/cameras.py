"""Camera poses: the primary camera, drawn anew for each scene, and the fixed cameras around and above the table.

World: z up, table top at z = 0, kits at y > 0, loose parts at y < 0. Cameras on the +x or the -x side have y across
their image. Lengths are in m, angles in rad, poses are `world_from_camera`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from kit1000.camera import Camera, look_at
from kit1000.errors import InputError, checked
from kit1000.numerics.trigonometry import cosine, sine
from kit1000.pose import Pose

# Image size and focal length of the paper's release (there 925.27 px), those of its real camera. The principal point
# is the image centre.
CAMERA = Camera(width=1280, height=720, fx=925.0, fy=925.0, cx=639.5, cy=359.5)

# (2, 3) [m] lowest and highest corner of the box that holds a layout: an assembly near (0, 0.2), up to 0.13 m high, and
# the parts near (0, -0.17).
WORKSPACE = np.array([[-0.19, -0.345, 0.0], [0.19, 0.39, 0.13]])
WORKSPACE.setflags(write=False)

PRIMARY_TARGET = (0.0, 0.03, 0.02)  # between the halves, nearer the assembly, which is wider and higher
# The release draws radius U(0.6, 1.0) m, polar angle U(0.5, 1.375) rad from the vertical and any azimuth, with one
# camera for each half. We use the same radius. The largest polar angle is where near plates begin to occlude far ones;
# within the largest azimuth one image holds both halves: 99 of 100 layouts are wholly in view.
PRIMARY_RADIUS = (0.6, 1.0)
PRIMARY_POLAR_ANGLE = (float(np.radians(28)), float(np.radians(60)))
CROWDED_POLAR_ANGLE = (float(np.radians(45)), PRIMARY_POLAR_ANGLE[1])  # from above, no part hides another
MAX_PRIMARY_AZIMUTH = float(np.radians(30))  # to either side of the x axis

# The fixed cameras look at the centre of the workspace from the shortest distance at which all of it is in view, at
# 1.1 mm a pixel or finer: a pixel of the release's height maps is 1.094 mm. The release's three cameras have polar
# angles of 50 and 56 degrees, on three sides of a workspace twice as wide; from there our cameras would see 73 % of the
# cavities' surface, here 86 %.
WORKSPACE_CENTRE = (0.0, 0.025, 0.05)
RING_RADIUS = 1.02
RING_POLAR_ANGLE = float(np.radians(40))
RING_AZIMUTHS_DEG = (90.0, 210.0, 330.0)  # one over the kits, two over the parts
TOP_HEIGHT = 0.65

POSITION_DECIMALS = 9  # [m] of a camera: the last bits of sine and cosine differ between processors

CAMERA_SETS = ("primary", "three", "top")


def draw_primary_pose(rng: np.random.Generator, crowded: bool = False, scale: float = 1.0) -> Pose:
    """The pose of the primary camera: on the +x or the -x side, uniform in radius, polar angle and azimuth.

    scale: of the table's halves, and so of the camera's target and distance.
    """
    polar_angle = CROWDED_POLAR_ANGLE if crowded else PRIMARY_POLAR_ANGLE
    radius, polar = rng.uniform(*PRIMARY_RADIUS), rng.uniform(*polar_angle)
    azimuth = rng.uniform(-MAX_PRIMARY_AZIMUTH, MAX_PRIMARY_AZIMUTH)
    return _orbit_pose(scale * radius, polar, azimuth + np.pi * rng.integers(2), scale * np.asarray(PRIMARY_TARGET))


def camera_set(name: str, primary: Pose | None = None, scale: float = 1.0) -> dict[str, tuple[Camera, Pose]]:
    """The cameras of a set and their poses, by the prefix of their images in a recording.

    primary: the camera at the pose `primary`, key "". three: around the table, for height maps, keys "three/0" to
    "three/2". top: vertically above the table, key "top". scale: of the distances of the last two.
    """
    if name == "primary":
        if primary is None:
            raise InputError("camera set 'primary': expected the pose of the scene's primary camera, got none")
        return {"": (CAMERA, primary)}
    if name == "three":
        return {f"three/{i}": (CAMERA, pose) for i, pose in enumerate(_ring_poses(scale))}
    if name == "top":
        return {"top": (CAMERA, _top_pose(scale))}
    raise InputError(f"camera set {name!r}: expected one of {', '.join(CAMERA_SETS)}")


def in_view(camera: Camera, world_from_camera: Pose, points: ArrayLike, margin_px: float = 0.0) -> bool:
    """Whether all points (..., 3) [m] of the world project at least `margin_px` inside the edges of the image."""
    uv = camera.project(world_from_camera.inverse().apply(checked("points", points, (..., 3))))
    low, high = margin_px - 0.5, np.array([camera.width, camera.height]) - 0.5 - margin_px
    return bool(((uv >= low) & (uv <= high)).all())  # NaN, of points behind the camera, is not inside


def _orbit_pose(radius: float, polar: float, azimuth: float, target: ArrayLike = PRIMARY_TARGET) -> Pose:
    """A camera at spherical coordinates about the target [m, rad], looking at it, +z upward in its image."""
    across, up = radius * sine(polar), radius * cosine(polar)
    offset = np.round((across * cosine(azimuth), across * sine(azimuth), up), POSITION_DECIMALS)
    return look_at(np.asarray(target) + offset, target)


def _ring_poses(scale: float) -> list[Pose]:
    centre = scale * np.asarray(WORKSPACE_CENTRE)
    return [
        _orbit_pose(scale * RING_RADIUS, RING_POLAR_ANGLE, float(np.radians(azimuth)), centre)
        for azimuth in RING_AZIMUTHS_DEG
    ]


def _top_pose(scale: float) -> Pose:
    """The camera above the table: image rows run along x, as for a camera on the +x side, columns along y."""
    centre = scale * np.asarray(WORKSPACE_CENTRE)
    return look_at(centre + (0, 0, scale * TOP_HEIGHT), centre, up=(-1.0, 0.0, 0.0))
