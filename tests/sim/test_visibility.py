"""Visibility of parts and cavities, compared with larger images and with areas summed over pixels."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kit1000.camera import Camera, look_at
from kit1000.mesh import Mesh, mesh_from_solid
from kit1000.pose import Pose, random_quaternions
from kit1000.sim.cameras import CAMERA
from kit1000.sim.render import RenderedImage, render
from kit1000.sim.visibility import (
    CAVITY_SAMPLES,
    MAX_SLOT_ANGLE,
    MIN_CAVITY_SHARE,
    MIN_PART_PIXELS,
    MIN_PART_SHARE,
    RIM_MARGIN,
    SIDE_MARGIN,
    PartVisibility,
    SlotVisibility,
    cavity_labels,
    cavity_surface,
    part_visibility,
    silhouette_pixels,
    slot_visibility,
    view_redraw_reason,
)
from kit1000.values import Kit
from tests.samples.kits import QUICK, sample_kit, sample_part
from tests.samples.shapes import box, seated

IDENTITY = Pose.identity()
DEPTH = 8e-3  # [m] of the cavity of `trough`


@cache
def trough() -> Kit:
    """The cavity of a block of 30 x 20 mm, 2.5 mm around it, corners round."""
    return seated(box(30, 20, 14), depth=DEPTH).kit()


def slab(x: float, y: float, z: float) -> Mesh:
    return mesh_from_solid(box(x, y, z))


def camera_around(rng: np.random.Generator, target: np.ndarray, max_polar: float = 1.2) -> Pose:
    """A camera 0.6 to 1 m from a target above the horizon."""
    polar, azimuth, radius = rng.uniform(0.05, max_polar), rng.uniform(0, 2 * np.pi), rng.uniform(0.6, 1)
    direction = np.array([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])
    return look_at(target + radius * direction, target)


def larger(camera: Camera, rim: int) -> Camera:
    """The same view with `rim` more pixels on every side."""
    return Camera(
        camera.width + 2 * rim, camera.height + 2 * rim, camera.fx, camera.fy, camera.cx + rim, camera.cy + rim
    )


@given(st.integers(0, 2**32 - 1))
def test_a_part_alone_shows_its_whole_silhouette_to_the_pixel(seed: int):
    """Also where the image truncates it: the share refers to a larger image."""
    rng = np.random.default_rng(seed)
    mesh = sample_part(str(rng.choice(QUICK))).mesh
    pose = Pose(random_quaternions(rng, 1)[0], rng.uniform(-0.2, 0.2, 3))
    view = camera_around(rng, np.zeros(3))
    image, larger_image = render(CAMERA, view, [(mesh, pose)]), render(larger(CAMERA, 700), view, [(mesh, pose)])
    visibility = part_visibility(image, 0, CAMERA, view, mesh, pose)
    whole = np.count_nonzero(larger_image.body_ids)
    assert silhouette_pixels(CAMERA, view, mesh, pose) == whole
    assert visibility.pixels == np.count_nonzero(image.body_ids)
    assert visibility.share == visibility.pixels / whole


def test_a_part_half_behind_a_wall_is_half_visible():
    camera, part = Camera(200, 150, 200.0, 200.0, 99.5, 74.5), slab(0.2, 0.2, 0.2)
    wall, in_front = slab(1, 1, 0.01), Pose.from_translation((0.5, 0, 0.5))  # occludes the right half of the image
    bodies = [(wall, in_front), (part, Pose.from_translation((0, 0, 1)))]
    visibility = part_visibility(render(camera, IDENTITY, bodies), 1, camera, IDENTITY, *bodies[1])
    assert visibility.share == 0.5
    assert visibility.pixels == 20 * 40


@pytest.mark.parametrize("tilt", [0.0, 0.3, 1.0, 1.6, 3.1])
def test_the_angle_of_a_slot_is_its_tilt_from_the_line_of_sight(tilt: float):
    view = look_at((0, 0, 0.8), (0, 0, 0), up=(0, 1, 0))
    pose = Pose.from_rotvec((tilt, 0, 0))
    depth = np.zeros((720, 1280), np.float32)
    visibility = slot_visibility(depth, CAMERA, view, trough(), pose)
    assert visibility.angle == pytest.approx(tilt, abs=1e-12)
    assert visibility.share == 0


def cavity_faces(kit: Kit) -> np.ndarray:
    """(m,) bool: the faces whose three corners are on no common plane of the plate."""
    x, y, z = np.moveaxis(kit.mesh.triangles, -1, 0)
    half_x, half_y, thickness = kit.extent * (0.5, 0.5, 1)
    planes = (abs(x - half_x), abs(x + half_x), abs(y - half_y), abs(y + half_y), abs(z), abs(z + thickness))
    return ~np.any([(gap < 1e-7).all(1) for gap in planes], axis=0)


def on_cavity(image: RenderedImage, index: int, kit: Kit) -> np.ndarray:
    """(H, W) bool: the pixels of the cavity of the kit that is body `index`."""
    on_kit = image.body_ids == index + 1
    return on_kit & cavity_faces(kit)[np.where(on_kit, image.face_ids, 0)]


def visible_area(image: RenderedImage, index: int, camera: Camera, view: Pose, kit: Kit, pose: Pose) -> float:
    """[m^2] of a kit's cavity, summed over pixels: each covers z^2 / (fx fy |n . r|) of the surface behind it."""
    on_kit = on_cavity(image, index, kit)
    v, u = np.nonzero(on_kit)
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(len(u))], axis=1)
    normals = (view.inverse() @ pose).rotate(kit.mesh.normals[image.face_ids[on_kit]])
    z = image.depth[on_kit].astype(float)
    return float((z**2 / (camera.fx * camera.fy * np.abs((normals * rays).sum(1)))).sum())


def cavity_area(kit: Kit) -> float:
    a, b, c = np.moveaxis(kit.mesh.triangles[cavity_faces(kit)], 1, 0)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def test_the_visible_share_of_a_cavity_is_the_area_its_pixels_cover():
    """Kits at many tilts, a part hovering in front of them, from all around.

    The sum is over a finer image, because walls seen edge on have few pixels of much area each; there the two may
    differ by the resolution of the coarser image, but have the same mean.
    """
    fine, differences = CAMERA.scaled(2), []
    for seed in range(16):
        rng = np.random.default_rng(seed)
        kit = sample_kit(str(rng.choice(QUICK)))
        pose = Pose.from_rotvec(rng.uniform(-0.5, 0.5, 3), rng.uniform(-0.05, 0.05, 3))
        view = camera_around(rng, pose.xyz)
        hovering = pose.xyz + rng.uniform((-0.06, -0.06, 0.03), (0.06, 0.06, 0.1))
        bodies = [(sample_part("tee").mesh, Pose(random_quaternions(rng, 1)[0], hovering)), (kit.mesh, pose)]
        visibility = slot_visibility(render(CAMERA, view, bodies).depth, CAMERA, view, kit, pose)
        summed = visible_area(render(fine, view, bodies), 1, fine, view, kit, pose) / cavity_area(kit)
        differences.append(visibility.share - summed)
    assert np.abs(differences).max() < 0.05
    assert abs(np.mean(differences)) < 0.01


@pytest.mark.parametrize(("tilt", "azimuth"), [(0.3, 0.8), (0.6, 0.5), (0.8, 2.2), (1.0, 4.0)])
def test_from_far_away_a_box_shows_two_walls_and_the_floor_that_its_rim_leaves_visible(tilt: float, azimuth: float):
    """At depth s the rim occludes s tan(tilt) sideways: a strip of the floor and two triangles are hidden."""
    (width, breadth, depth), plate = (0.04, 0.03, 0.01), trough().extent
    hole = box(width, breadth, 2 * depth, (0, 0, -depth))
    kit = replace(trough(), mesh=mesh_from_solid(box(*plate, at=(0, 0, -plate[2])) - hole))
    towards = np.array([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)])
    camera, view = Camera(600, 600, 1e6, 1e6, 299.5, 299.5), look_at(200 * towards, (0, 0, 0))
    along_x, along_y = depth * abs(towards[:2]) / towards[2]
    floor = (width - along_x) * (breadth - along_y)
    walls = depth * (breadth - along_y / 2) + depth * (width - along_x / 2)
    visibility = slot_visibility(render(camera, view, [(kit.mesh, IDENTITY)]).depth, camera, view, kit, IDENTITY)
    assert visibility.angle == pytest.approx(tilt)
    assert visibility.share == pytest.approx(
        (floor + walls) / (width * breadth + 2 * depth * (width + breadth)), abs=0.01
    )


def test_a_cavity_outside_the_image_or_behind_the_camera_is_invisible():
    kit, depth = trough(), np.ones((720, 1280), np.float32)
    beside = look_at((0, 0, 0.8), (1, 0, 0.4))
    behind = look_at((0, 0, 0.8), (0, 0, 1.6), up=(0, 1, 0))
    for view in (beside, behind):
        assert slot_visibility(depth, CAMERA, view, kit, IDENTITY).share == 0


@pytest.mark.parametrize("family", QUICK)
def test_samples_are_uniform_over_the_area_of_the_cavity(family: str):
    kit = sample_kit(family)
    points, normals = cavity_surface(kit)
    assert points.shape == normals.shape == (CAVITY_SAMPLES, 3)
    assert (abs(points[:, :2]) < kit.extent[:2] / 2).all()
    assert (points[:, 2] <= 0).all()
    triangles, faces = kit.mesh.triangles[cavity_faces(kit)], kit.mesh.normals[cavity_faces(kit)]
    areas = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1) / 2
    for towards in (*np.eye(3), *-np.eye(3)):  # first moment of each side of the cavity: area and centre at once
        weights = areas * np.clip(faces @ towards, 0, None) / areas.sum()
        found = (np.clip(normals @ towards, 0, None)[:, None] * points).mean(0)
        np.testing.assert_allclose(found, weights @ triangles.mean(1), atol=1e-4)
    plane = np.abs(((points[:, None] - triangles[:, 0]) * faces).sum(-1))
    assert (plane.min(1) < 1e-9).all()


GOOD_PART, GOOD_SLOT = PartVisibility(MIN_PART_PIXELS, MIN_PART_SHARE), SlotVisibility(MAX_SLOT_ANGLE, MIN_CAVITY_SHARE)


def test_a_view_at_all_limits_is_good_enough():
    assert view_redraw_reason(GOOD_PART, GOOD_SLOT) is None


@pytest.mark.parametrize(
    ("part", "slot", "reason"),
    [
        (PartVisibility(MIN_PART_PIXELS - 1, 1.0), GOOD_SLOT, "part small in the image"),
        (PartVisibility(5000, 0.49), GOOD_SLOT, "part mostly hidden"),
        (GOOD_PART, SlotVisibility(MAX_SLOT_ANGLE + 1e-3, 1.0), "slot turned away"),
        (GOOD_PART, SlotVisibility(0.1, 0.149), "cavity mostly hidden"),
    ],
)
def test_each_limit_has_its_reason(part: PartVisibility, slot: SlotVisibility, reason: str):
    assert view_redraw_reason(part, slot) == reason


def tilted_kits(rng: np.random.Generator) -> tuple[list[Kit], Pose]:
    """Five kits side by side, each at its own tilt."""
    kits = [sample_kit(family) for family in QUICK]
    positions = [(x, y, rng.uniform(0, 0.03)) for x, y in ((0, 0), (0.13, 0), (-0.13, 0), (0, 0.13), (0, -0.13))]
    return kits, Pose.stack([Pose.from_rotvec(rng.uniform(-0.4, 0.4, 3), xyz) for xyz in positions])


@settings(max_examples=6)
@given(st.integers(0, 2**32 - 1))
def test_labels_are_the_pixels_of_cavity_faces(seed: int):
    """By the rendered faces; pixels within 1 um of the limit may have either label."""
    rng, camera = np.random.default_rng(seed), CAMERA.scaled(0.4)
    kits, poses = tilted_kits(rng)
    view = camera_around(rng, rng.uniform((-0.3, -0.3, 0), (0.3, 0.3, 0)))
    image = render(camera, view, [(kit.mesh, pose) for kit, pose in zip(kits, poses, strict=True)])
    labels = cavity_labels(image.depth, camera, view, poses, kits)
    points = view.apply(camera.unproject(image.depth))
    for number, (kit, pose) in enumerate(zip(kits, poses, strict=True)):
        in_kit = pose.inverse().apply(points)
        clear = np.abs(in_kit[..., 2] + RIM_MARGIN) > 1e-6
        expected = on_cavity(image, number, kit) & (in_kit[..., 2] < -RIM_MARGIN)
        np.testing.assert_array_equal((labels == number)[clear], expected[clear])


def test_a_seated_part_has_the_cavity_label_below_the_rim():
    family = "bracket"
    kit, part, view = sample_kit(family), sample_part(family), look_at((0.2, 0, 0.6), (0, 0, 0))
    place = Pose.from_rotvec((0.2, -0.1, 1), (0.05, 0.02, 0.01))
    bodies = [(kit.mesh, place), (part.mesh, place @ kit.slot.kit_from_part)]
    image = render(CAMERA, view, bodies)
    height = (place.inverse() @ view).apply(CAMERA.unproject(image.depth))[..., 2]
    labels = cavity_labels(image.depth, CAMERA, view, [place], [kit])
    assert (labels[(image.body_ids == 2) & (height < -RIM_MARGIN - 1e-6)] == 0).all()
    assert (labels[(image.body_ids == 2) & (height > -RIM_MARGIN + 1e-6)] == -1).all()


def test_pixels_without_a_return_and_of_the_table_have_no_label():
    kit, view = trough(), look_at((0, 0, 0.6), (0, 0, 0), up=(0, 1, 0))
    assert (cavity_labels(np.zeros((720, 1280), np.float32), CAMERA, view, [IDENTITY], [kit]) == -1).all()
    table = np.full((720, 1280), 0.6 + kit.extent[2] - SIDE_MARGIN / 2, np.float32)  # just above the plate's underside
    assert (cavity_labels(table, CAMERA, view, [IDENTITY], [kit]) == -1).all()


def test_a_camera_inside_a_plate_gives_correct_labels():
    """A box that extends behind the camera is unbounded in the image: all pixels are tested."""
    kit, view = trough(), Pose.from_rotvec((0, 0.3, 0), (0, 0, -4e-3))
    depth = np.full((720, 1280), 2e-3, np.float32)
    points = view.apply(CAMERA.unproject(depth))
    half = kit.extent[:2] / 2 - SIDE_MARGIN
    inside = (abs(points[..., :2]) <= half).all(-1) & (points[..., 2] <= -RIM_MARGIN)
    assert inside.any()
    np.testing.assert_array_equal(cavity_labels(depth, CAMERA, view, [IDENTITY], [kit]) == 0, inside)
