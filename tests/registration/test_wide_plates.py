"""Plates wider than a map: each of their holes is found, and a small plate is read as ever."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from kit1000.camera import look_at
from kit1000.dataset.reader import Dataset
from kit1000.kits.cavity import insertion_depth
from kit1000.mesh import Mesh, mesh_from_solid
from kit1000.perception.observed.plates import Plane, plane_frame
from kit1000.pose import Pose
from kit1000.queries.motions import goal_motion
from kit1000.queries.pivots import part_pivots
from kit1000.registration.kit_volume import MOST_HOLES, TrueKits, plate_frames
from kit1000.registration.predictor import Registration
from kit1000.registration.search import LEAST_SIDE
from kit1000.sim.cameras import CAMERA
from kit1000.sim.layout import table
from kit1000.sim.render import render
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, LabelledDepth, Query, TrueGeometry, View
from tests.samples.registration_cases import CLEARANCE, bar, keyed
from tests.samples.shapes import box, cylinder

MM, TOP = 1e-3, 40e-3  # [m] the height of a box
WORLD_FROM_KIT = Pose.from_rotvec((0.12, 0.05, 0.3), (0.0, 0.16, 0.02))
UP = WORLD_FROM_KIT.rotate((0.0, 0.0, 1.0))


def block(width: float, length: float, holes: Sequence[tuple[float, float]], diameter: float = 30) -> Mesh:
    """[m] a block of this size [mm] on z = 0 with round holes [mm] in its top."""
    solid = box(width, length, 40)
    for x, y in holes:
        solid -= cylinder(diameter, 30).translate((x, y, 30))
    return mesh_from_solid(solid).scaled(MM)


def frames_of(kit: Mesh) -> tuple[Plane, list[Pose]]:
    """The top of a block and the frames of its maps."""
    part = mesh_from_solid(box(20, 20, 20)).scaled(MM)
    kits = TrueKits(TrueGeometry(part, Pose.from_translation((0, -0.2, 0)), kit, WORLD_FROM_KIT))
    points, normals, _ = kits.oriented_points(None)
    area = float(np.prod(np.ptp(kit.bounds, axis=0)[:2]))
    plane = Plane(UP, WORLD_FROM_KIT.apply(np.array([0.0, 0.0, TOP])), area)
    return plane, plate_frames(kits, plane, points, normals, LEAST_SIDE)


def test_each_hole_of_a_wide_plate_has_a_frame_over_its_middle() -> None:
    holes = [(x, y) for x in (-100.0, 0.0, 100.0) for y in (-45.0, 45.0)]
    _, frames = frames_of(block(290, 180, holes))
    found = np.array([WORLD_FROM_KIT.inverse().apply(frame.xyz) for frame in frames]) / MM
    assert len(frames) == len(holes)
    for x, y in holes:
        apart = np.linalg.norm(found - (x, y, 40), axis=1)
        assert apart.min() < 2
    assert all(np.abs(frame.rotate((0.0, 0.0, 1.0)) - UP).max() < 1e-9 for frame in frames)


@pytest.mark.parametrize("holes", [[], [(0.0, 0.0)], [(-25.0, 0.0), (25.0, 0.0)]])
@pytest.mark.parametrize("length", [100, 198])  # one plate, and two in one plane
def test_a_plate_of_the_usual_size_has_one_frame_about_its_middle(
    length: float, holes: list[tuple[float, float]]
) -> None:
    plane, (frame,) = frames_of(block(length, 119, holes))
    assert np.array_equal(frame.matrix(), plane_frame(plane, plane.point).matrix())


def test_a_wide_plate_without_a_hole_has_one_frame_and_specks_count_for_nothing() -> None:
    for kit in (block(260, 200, []), block(260, 200, [(60.0, 50.0), (-60.0, 50.0)], diameter=8)):
        _, frames = frames_of(kit)
        assert len(frames) == 1


def test_the_largest_holes_of_many_are_taken() -> None:
    holes = [(x, y) for x in range(-120, 121, 40) for y in (-60, -20, 20, 60)]
    _, frames = frames_of(block(300, 180, holes, diameter=24))
    assert len(holes) > MOST_HOLES == len(frames)


PARTS = (keyed, bar)


@cache
def seen() -> tuple[LabelledDepth, list[Pose], list[Pose]]:
    """A block of 26 cm with a cavity for each of two parts, the image, where they lie and where they belong."""
    solid, lying, goals = box(260, 130, 40), [], []
    for number, (make, x) in enumerate(zip(PARTS, (-80.0, 80.0), strict=True)):
        shape, yaw = make(), 30.0 - 70 * number
        depth = insertion_depth(14e-3 if make is keyed else 12e-3) / MM
        hole = shape.project().offset(CLEARANCE / MM).extrude(50)
        solid -= hole.rotate((0, 0, yaw)).translate((x, 0, 40 - depth))
        kit_from_part = Pose.from_rotvec((0, 0, np.radians(yaw)), (x * MM, 0, TOP - depth * MM))
        lying.append(Pose.from_rotvec((0, 0, 1.0 + number), (-0.1 + 0.2 * number, -0.12, 0.0)))
        goals.append(goal_motion(lying[-1], WORLD_FROM_KIT, kit_from_part))
    meshes = [mesh_from_solid(make()).scaled(MM) for make in PARTS]
    pose = look_at((0.1, -0.5, 0.75), (0.0, 0.04, 0.0))
    kit = (mesh_from_solid(solid).scaled(MM), WORLD_FROM_KIT)
    image = render(CAMERA, pose, [(table(), Pose.identity()), kit, *zip(meshes, lying, strict=True)], threads=1)
    labels = np.select(
        [image.body_ids == 2, image.body_ids > 2], [ASSEMBLY_LABEL, image.body_ids - 3 + FIRST_PART_LABEL], 0
    )
    return LabelledDepth(View(CAMERA, pose, image.depth), labels.astype(np.uint8)), lying, goals


@pytest.mark.parametrize("part", [0, 1])
@pytest.mark.parametrize(
    "config", [{"clearance": CLEARANCE}, pytest.param({}, marks=pytest.mark.slow)], ids=["stated", "unknown"]
)
def test_a_part_finds_its_cavity_in_a_wide_plate_without_a_guess(part: int, config: dict[str, float]) -> None:
    image, lying, goals = seen()
    pivot = part_pivots(image.view, image.labels)[part]
    query = Query("test-s0000-p0-place", "test-s0000", "place", "ideal", part, True, pivot, None, lambda: image)
    dataset: Any = SimpleNamespace(summary={"config": config}, root="own")
    predicted = Registration(cast(Dataset, dataset))(query)
    apart = predicted.goal_from_now @ goals[part].inverse()
    middle = goals[part].apply(lying[part].xyz)
    assert np.linalg.norm(apart.apply(middle) - middle) < 2e-3
    assert np.degrees(apart.angle()) < 4
