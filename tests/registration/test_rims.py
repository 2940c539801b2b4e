"""The rims of a cavity from one oblique image: they lie where the plate ends, on the near side too."""

from __future__ import annotations

import numpy as np
import pytest

from kit1000.camera import Camera, look_at
from kit1000.mesh import mesh_from_solid
from kit1000.perception.image_kinds import IDEAL
from kit1000.pose import Pose
from kit1000.registration.geometry.cavity import CUT, RIM, VOXEL, find_cavity, plate_grid, seen_face
from kit1000.sim.render import render
from kit1000.values import View
from kit1000.voxels import Volume, tsdf
from tests.samples.shapes import MM, box

CAMERA = Camera(width=600, height=500, fx=1500.0, fy=1500.0, cx=299.5, cy=249.5)
HALF = np.array([20e-3, 15e-3])  # [m] of the cavity
SIDE, NOISE = 0.12, IDEAL.noise


def plate_seen_from(polar_deg: float, dark: bool = False) -> Volume:
    """A plate with its face at z = 0 and a cavity 15 mm deep, seen from x < 0 at an angle from its normal.

    dark: whether nothing below the face returns.
    """
    plate = mesh_from_solid(
        box(90, 90, 22, (0, 0, -22)) - box(2e3 * HALF[0], 2e3 * HALF[1], 15.001, (0, 0, -15))
    ).scaled(MM)
    polar = np.radians(polar_deg)
    pose = look_at((-0.7 * np.sin(polar), 0.0, 0.7 * np.cos(polar)), (0, 0, 0))
    image = render(CAMERA, pose, [(plate, Pose.identity())], 1)
    v, u = np.indices(image.depth.shape)
    points = pose.apply(CAMERA.unproject_pixels(np.stack([u, v], -1), image.depth))
    depth = np.where((points[..., 2] < -1e-4) & dark, 0, image.depth)
    return tsdf(plate_grid(Pose.identity(), SIDE), View(CAMERA, pose, depth), image.body_ids == 1, threads=1)


@pytest.mark.parametrize("polar_deg", [25, 45, 60])
def test_the_rims_of_a_cavity_lie_where_its_plate_ends(polar_deg: float) -> None:
    cavity = find_cavity(plate_seen_from(polar_deg), Pose.identity(), NOISE)
    assert cavity is not None
    rims = cavity.points[np.isclose(cavity.points[:, 2], -RIM)]
    near, far = rims[rims[:, 0] < -0.8 * HALF[0]], rims[rims[:, 0] > 0.8 * HALF[0]]
    assert len(near) > 20
    assert abs(np.median(near[:, 0]) + HALF[0]) < 0.75 * VOXEL  # a jump taken for the face is off by up to 2.6 mm
    assert abs(np.median(far[:, 0]) - HALF[0]) < 0.75 * VOXEL
    for sign in (-1, 1):
        side = rims[(sign * rims[:, 1] > 0.8 * HALF[1]) & (np.abs(rims[:, 0]) < 0.7 * HALF[0])]
        assert abs(np.median(side[:, 1]) - sign * HALF[1]) < 0.75 * VOXEL


def test_a_cavity_without_any_return_is_none() -> None:
    assert find_cavity(plate_seen_from(30, dark=True), Pose.identity(), NOISE) is None


def test_an_oblique_face_is_seen() -> None:
    volume = plate_seen_from(60)
    seen = seen_face(volume, CUT)
    axis = (np.arange(len(seen)) - (len(seen) - 1) / 2) * VOXEL
    x, y = np.meshgrid(axis, axis, indexing="ij")
    inside = (np.abs(x) < 0.036) & (np.abs(y) < 0.042) & ((np.abs(x) > HALF[0] + 3e-3) | (np.abs(y) > HALF[1] + 3e-3))
    assert seen[inside].mean() > 0.99
