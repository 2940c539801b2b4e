"""Seen meshes, plates, lookups and gestures, against closed form: a tilted plate with a cavity, rendered."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kit1000.camera import Camera, look_at
from kit1000.editor.dragging import levelled, slid
from kit1000.editor.pointing import Eye, Pointing
from kit1000.editor.seen import seen_surface, with_skirt
from kit1000.editor.seen_plates import TABLE, Plate, find_plates, plates_of
from kit1000.mesh import Mesh, mesh_from_solid
from kit1000.parts.cad import polygon, prism
from kit1000.perception.image_kinds import IDEAL
from kit1000.pose import Pose, quaternion_between
from kit1000.sim.layout import table
from kit1000.sim.render import render
from kit1000.values import View
from tests.samples.labelled_scenes import sample_kits

CAMERA = Camera(640, 360, 460.0, 460.0, 319.5, 179.5)
VIEW_POSE = look_at((0.05, -0.5, 0.6), (0.0, 0.0, 0.03))
TILT = np.radians(20)
WORLD_FROM_PLATE = Pose.from_rotvec((TILT, 0.0, 0.0), (0.0, 0.05, 0.06))  # z = 0 is the plate's face
EYE = Eye(look_at((0.0, -0.7, 0.5), (0.0, 0.0, 0.0)), float(np.radians(45)), 1.5)


def square(half: float) -> list[tuple[float, float]]:
    return [(-half, -half), (half, -half), (half, half), (-half, half)]


@cache
def kit() -> Mesh:
    """A plate of 100 mm with a cavity of 40 mm, its face at z = 0. [m]"""
    solid = prism(polygon(square(50.0)), 18.0).translate((0, 0, -18)) - prism(polygon(square(20.0)), 12.0).translate(
        (0, 0, -12)
    )
    return mesh_from_solid(solid).scaled(1e-3)


@cache
def block() -> Mesh:
    """30 x 30 x 20 mm, standing on z = 0. [m]"""
    return mesh_from_solid(prism(polygon(square(15.0)), 20.0)).scaled(1e-3)


@cache
def pictured() -> tuple[View, np.ndarray]:
    """An image of the kit (1) and of the block (2) on the table, and its labels."""
    bodies = [
        (kit(), WORLD_FROM_PLATE),
        (block(), Pose.from_translation((0.0, -0.15, 0.0))),
        (table(), Pose.identity()),
    ]
    image = render(CAMERA, VIEW_POSE, bodies)
    return View(CAMERA, VIEW_POSE, image.depth), image.body_ids


@cache
def seen() -> tuple[View, Mesh, Mesh]:
    """The image, and what is seen of kit and block."""
    view, labels = pictured()
    return view, seen_surface(view, labels == 1), with_skirt(seen_surface(view, labels == 2))


@cache
def plates_of_kit() -> list[Plate]:
    view, labels = pictured()
    return find_plates(view, labels == 1, IDEAL.noise)


def test_seen_points_are_on_the_true_surface() -> None:
    _, kits, part = seen()
    top = part.vertices[: len(part.vertices) // 2] - (0.0, -0.15, 0.0)
    assert np.abs(np.abs(top).max(0) - (0.015, 0.015, 0.02)).max() < 2e-3
    height = WORLD_FROM_PLATE.inverse().apply(kits.vertices)[:, 2]
    assert height.max() < 1e-5  # nothing above the face


def test_no_triangle_bridges_a_step_in_depth() -> None:
    depth = np.full((60, 80), 1.0, np.float32)
    depth[:, 40:] = 1.3
    camera = Camera(80, 60, 100.0, 100.0, 39.5, 29.5)
    surface = seen_surface(View(camera, Pose.identity(), depth), np.ones(depth.shape, bool))
    assert np.unique(surface.triangles[..., 2].round(6)).tolist() == [1.0, 1.3]
    assert (np.ptp(surface.triangles[..., 2], axis=1) < 1e-6).all()
    assert len(surface.faces) == 2 * 59 * (39 + 39)


def test_where_nothing_is_seen_there_is_no_surface_no_plate_and_no_support() -> None:
    view, labels = pictured()
    blind = View(CAMERA, VIEW_POSE, np.zeros_like(view.depth))
    assert not len(seen_surface(view, labels == 9).faces)
    assert not len(seen_surface(blind, np.ones(labels.shape, bool)).faces)
    assert find_plates(view, labels == 9, IDEAL.noise) == []
    pointing = Pointing(seen()[1], [])
    assert pointing.support(EYE, (0.5, 0.0)) is pointing.support(EYE, (-3.0, 0.5)) is None  # off the table


def test_a_skirt_closes_a_part_down_to_the_table() -> None:
    part = seen()[2]
    edges = np.concatenate([part.faces[:, [0, 1]], part.faces[:, [1, 2]], part.faces[:, [2, 0]]])
    directed = {tuple(edge) for edge in edges.tolist()}
    assert len(directed) == len(edges)
    assert directed == {(b, a) for a, b in directed}  # watertight
    assert part.vertices[:, 2].min() == 0.0


def test_the_plate_is_found_where_it_is_and_its_floor_is_not_one() -> None:
    plates = plates_of_kit()
    assert len(plates) == 1
    normal = WORLD_FROM_PLATE.rotate((0.0, 0.0, 1.0))
    assert np.degrees(np.arccos(min(1.0, float(plates[0].normal @ normal)))) < 0.1
    assert abs(float(plates[0].height(WORLD_FROM_PLATE.xyz))) < 1e-4


def test_two_plates_in_one_plane_are_two() -> None:
    shifted = Pose.from_translation((0.11, 0.0, 0.0))
    bodies = [(kit(), WORLD_FROM_PLATE @ shift) for shift in (shifted, shifted.inverse())]
    image = render(CAMERA, VIEW_POSE, [*bodies, (table(), Pose.identity())])
    plates = find_plates(View(CAMERA, VIEW_POSE, image.depth), np.isin(image.body_ids, (1, 2)), IDEAL.noise)
    assert len(plates) == 2
    assert sorted(round(float(plate.point[0]), 2) for plate in plates) == [-0.11, 0.11]


@pytest.mark.parametrize(("x", "y", "plate"), [(0.035, 0.0, True), (0.0, 0.0, True), (0.0, -0.16, False)])
def test_a_lookup_meets_the_plane_of_what_is_under_the_cursor(x: float, y: float, plate: bool) -> None:
    """Also over the cavity: the part slides over it."""
    plates = plates_of_kit()
    pointing = Pointing(seen()[1], plates)
    point = WORLD_FROM_PLATE.apply((x, y, 0.0)) if plate else np.array([x, y, 0.0])
    support = pointing.support(EYE, EYE.screen(point))
    assert support is not None
    assert support.plate is (plates[0] if plate else TABLE)
    assert np.abs(support.point - point).max() < 3e-4
    assert pointing.below(point + 0.01) is support.plate


def test_a_hole_in_what_is_seen_of_a_plate_is_not_the_table_below_it() -> None:
    """A camera does not see all of a cavity: without a lid a part would fall through the hole while it is dragged."""
    _, kits, _ = seen()
    plates = plates_of_kit()
    local = WORLD_FROM_PLATE.inverse().apply(kits.triangles.mean(1))
    holed = Mesh(kits.vertices, kits.faces[(np.abs(local[:, :2]) > 0.02).any(1)])  # nothing seen of the cavity
    pointing = Pointing(holed, plates)
    for x, y in ((0.0, 0.0), (0.015, -0.015), (-0.015, 0.015)):
        point = WORLD_FROM_PLATE.apply((x, y, 0.0))
        support = pointing.support(EYE, EYE.screen(point))
        assert support is not None
        assert support.plate is plates[0]
        assert np.abs(support.point - point).max() < 3e-4
    beside = pointing.support(EYE, EYE.screen(WORLD_FROM_PLATE.apply((0.055, 0.0, 0.0))))
    assert beside is not None
    assert beside.plate is not plates[0]


@given(st.floats(0, 1), st.floats(0, 1))
def test_a_place_on_the_screen_and_its_ray_agree(x: float, y: float) -> None:
    point = EYE.world_from_camera.xyz + 0.7 * EYE.ray((x, y))
    assert np.allclose(EYE.screen(point), (x, y), atol=1e-9)


angles = st.floats(-3, 3)


def tilted(a: float, b: float) -> Plate:
    normal = Pose.from_rotvec((a / 5, b / 5, 0.0)).rotate((0.0, 0.0, 1.0))
    return Plate(normal, np.array([0.02, 0.1, 0.05]), 0.07)


@given(angles, angles, angles, angles, angles)
def test_a_slid_part_touches_the_surface_and_keeps_its_rotation_to_it(
    a: float, b: float, c: float, d: float, yaw: float
) -> None:
    cloud, pivot, old, new = block().vertices, np.array([0.0, 0.0, 0.01]), tilted(a, b), tilted(c, d)
    motion = Pose.from_rotvec((0.3, yaw, 0.1), (0.01, 0.02, 0.03))
    moved = slid(motion, cloud, pivot, old, new, new.point)
    assert abs(float(new.height(moved.apply(cloud)).min())) < 1e-12
    off = moved.apply(pivot) - new.point
    assert np.abs(off - (off @ new.normal) * new.normal).max() < 1e-12  # the pivot is over the point
    relative = Pose(quaternion_between(old.normal, new.normal), np.zeros(3)) @ motion
    assert float((relative.inverse() @ moved).angle()) < 1e-9


def test_levelling_stands_a_tilted_part_on_its_nearest_side() -> None:
    motion = Pose.from_rotvec((np.radians(70), 0.0, 0.0), (0.0, 0.0, 0.2))
    level = levelled(motion, block().vertices, np.array([0.0, 0.0, 0.01]), TABLE)
    points = level.apply(block().vertices)
    assert np.degrees(float((level.inverse() @ Pose.from_rotvec((np.pi / 2, 0, 0))).angle())) < 1e-6
    assert abs(points[:, 2].min()) < 1e-12
    assert abs(points[:, 2].max() - 0.03) < 1e-9  # 30 mm high on its side


def test_a_known_shape_has_its_plates_and_not_the_floors_of_cavities_or_islands_in_them() -> None:
    island = (
        mesh_from_solid(prism(polygon(square(12.0)), 18.0)).scaled(1e-3).moved(Pose.from_translation((0, 0, -18e-3)))
    )
    both = Mesh(
        np.concatenate([kit().vertices, island.vertices]),
        np.concatenate([kit().faces, island.faces + len(kit().vertices)]),
    )
    (plate,) = plates_of(both.moved(WORLD_FROM_PLATE))
    assert np.allclose(plate.normal, WORLD_FROM_PLATE.rotate((0.0, 0.0, 1.0)), atol=1e-9)
    assert np.allclose(plate.point, WORLD_FROM_PLATE.xyz, atol=1e-6)
    assert plate.radius == pytest.approx(0.05 * np.sqrt(2))
    kits = sample_kits()
    assert len(plates_of(kits.assembly.mesh)) == len(kits.assembly.mounts)
