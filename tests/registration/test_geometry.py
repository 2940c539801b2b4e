"""The parts of registration against closed forms, brute force and known poses: cavities, faces, candidates."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kit1000.mesh import Mesh, solid_from_mesh
from kit1000.perception.image_kinds import IDEAL
from kit1000.perception.observed.plates import Plane, find_planes, plane_frame
from kit1000.pose import Pose
from kit1000.queries.guesses import MAX_ANGLE, MAX_OFFSET
from kit1000.queries.motions import apply_error
from kit1000.registration.geometry.cavity import VOXEL, find_cavity, plate_grid
from kit1000.registration.geometry.faces import standing_faces
from kit1000.registration.search import (
    DEPTH_TOLERANCE,
    DUPLICATE_DISTANCE,
    YAW_STEP,
    Candidate,
    OrientedPart,
    SearchWindow,
    without_duplicates,
)
from kit1000.voxels import Volume, signed_distance
from tests.samples.registration_cases import SIZE, columns, cuboid, volume_of
from tests.samples.shapes import Seated, ell, gaps, seated
from tests.samples.strategies import poses

IDENTITY = Pose.identity()
TILTED = Pose.from_rotvec((0.5, 0.3, 0.9), (0.2, -0.1, 0.3))
UP = np.array([0.0, 0.0, 1.0])


# plates and cavities


@cache
def ell_kit() -> Seated:
    """An L and its kit, with straight walls."""
    return seated(ell())


def on_a_plate(mesh: Mesh, world_from_kit: Pose, side: float = 0.12, offset: Pose = IDENTITY) -> tuple[Volume, Pose]:
    """The volume of a plate on the grid aligned with it, and world_from_plate."""
    world_from_plate = world_from_kit @ offset
    return signed_distance(plate_grid(world_from_plate, side), [(mesh, world_from_kit)], threads=1), world_from_plate


def walls_of(mesh: Mesh, height: float, points: np.ndarray) -> np.ndarray:
    """(n,) [m] horizontal distance from points (n, 2) to the solid at a height; negative inside it."""
    return gaps(points, solid_from_mesh(mesh).slice(height))


@pytest.mark.parametrize("pose", [IDENTITY, TILTED], ids=["identity", "tilted"])
def test_a_cavity_is_found_in_its_place_and_shape(pose: Pose) -> None:
    kit = ell_kit().kit()
    volume, world_from_plate = on_a_plate(kit.mesh, pose)
    cavity = find_cavity(volume, world_from_plate, IDEAL.noise)
    assert cavity is not None
    assert cavity.depth == pytest.approx(kit.slot.depth, abs=0.1e-3)
    cells = columns(VOXEL, len(cavity.region))
    on_plate = (np.abs(cells) < kit.extent[:2] / 2).all(-1)
    gap = walls_of(kit.mesh, -kit.slot.depth / 2, cells[on_plate])
    assert cavity.region[on_plate][gap > VOXEL].all()
    assert not cavity.region[on_plate][gap < -VOXEL].any()
    assert not cavity.region[~on_plate].any()
    np.testing.assert_allclose(cavity.heights[on_plate][gap > VOXEL], -kit.slot.depth, atol=0.05e-3)
    np.testing.assert_allclose(cavity.heights[on_plate][gap < -VOXEL], 0, atol=0.05e-3)


def test_points_of_a_cavity_lie_on_its_walls_and_floor() -> None:
    kit = ell_kit().kit()
    cavity = find_cavity(*on_a_plate(kit.mesh, TILTED), IDEAL.noise)
    assert cavity is not None
    beside = np.abs(walls_of(kit.mesh, -kit.slot.depth / 2, cavity.points[:, :2]))
    beneath = np.abs(cavity.points[:, 2] + kit.slot.depth)
    assert (cavity.points[:, 2] < 0).all()
    assert np.minimum(beside, beneath).max() < VOXEL
    assert np.median(np.minimum(beside, beneath)) < 0.1 * VOXEL
    assert min((beside < 0.1 * VOXEL).sum(), (beneath < 0.1 * VOXEL).sum()) > 500


def test_a_plate_without_a_cavity_has_none() -> None:
    plate = cuboid(np.array([99e-3, 99e-3, 22e-3]))
    assert find_cavity(*on_a_plate(plate, IDENTITY, offset=Pose.from_translation((0, 0, 11e-3))), IDEAL.noise) is None


def test_a_hidden_part_of_the_face_is_no_cavity() -> None:
    plate = cuboid(np.array([99e-3, 99e-3, 22e-3]))
    volume, world_from_plate = on_a_plate(plate, IDENTITY, offset=Pose.from_translation((0, 0, 11e-3)))
    values = volume.values.copy()
    values[40:60, 50:80, :26] = np.nan
    assert find_cavity(Volume(volume.grid, values), world_from_plate, IDEAL.noise) is None


def test_a_cavity_with_a_hidden_floor_is_as_large_and_as_deep() -> None:
    """Everything from 5 mm down is hidden in half of the columns."""
    kit = ell_kit().kit()
    volume, world_from_plate = on_a_plate(kit.mesh, TILTED)
    whole = find_cavity(volume, world_from_plate, IDEAL.noise)
    values = volume.values.copy()
    values[:60, :, :20] = np.nan
    half = find_cavity(Volume(volume.grid, values), world_from_plate, IDEAL.noise)
    assert whole is not None
    assert half is not None
    hidden = half.region & (np.arange(len(half.region)) < 60)[:, None]
    assert np.isnan(half.heights[hidden & whole.region]).all()
    np.testing.assert_allclose(half.free[hidden], -4e-3, atol=VOXEL)  # free down to there
    np.testing.assert_array_equal(half.region, whole.region)
    np.testing.assert_array_equal(half.heights[60:], whole.heights[60:])
    assert half.depth == pytest.approx(whole.depth, abs=0.1e-3)


def patch(pose: Pose, wide: float, rng: np.random.Generator, spacing: float = 1e-3, noise: float = 0.15e-3):
    """Noisy points and normals of a square in the xy plane of a pose, one point a square of the spacing."""
    n = round((wide / spacing) ** 2)
    flat = np.column_stack([rng.uniform(-wide / 2, wide / 2, (n, 2)), rng.normal(0, noise, n)])
    tilt = rng.normal(0, np.radians(1), (n, 2))
    normals = np.column_stack([tilt, np.ones(n)])
    return pose.apply(flat), pose.rotate(normals / np.linalg.norm(normals, axis=1, keepdims=True))


PLATES = [
    Pose.from_translation((0, 0, 0.1)),
    Pose.from_rotvec((np.radians(40), 0, 0), (0.1, 0, 0.12)),
    Pose.from_rotvec((0, np.radians(-25), 0.3), (-0.02, 0.12, 0.09)),
]


@pytest.mark.parametrize("seed", range(3))
def test_planes_are_plates_and_neither_floors_nor_walls(seed: int) -> None:
    rng = np.random.default_rng(seed)
    wall = Pose.from_rotvec((np.pi / 2, 0, 0), (0.2, 0, 0.1))
    under = PLATES[0] @ Pose.from_translation((0.0, 0.0, -0.02)) @ Pose.from_rotvec((np.pi, 0, 0))
    floors = [PLATES[i] @ Pose.from_translation((0.01, 0.0, -0.01)) for i in (0, 1)]
    patches = [patch(pose, 0.09, rng) for pose in [*PLATES, wall, under]] + [patch(pose, 0.03, rng) for pose in floors]
    points, normals = (np.concatenate(both) for both in zip(*patches, strict=True))
    planes = find_planes(points, normals, 1e-6, IDEAL.noise, rng)
    assert len(planes) == len(PLATES)
    for pose in PLATES:
        up = pose.rotate(np.array([0.0, 0.0, 1.0]))
        plane = max(planes, key=lambda plane: float(plane.normal @ up))
        assert np.degrees(np.arccos(min(plane.normal @ up, 1))) < 0.3
        assert abs(up @ (plane.point - pose.xyz)) < 0.1e-3
        assert plane.area == pytest.approx(0.09**2, rel=0.1)


@given(tilt=st.floats(0, 0.8), azimuth=st.floats(0, 6.3), above=st.tuples(*[st.floats(-0.2, 0.2)] * 3))
def test_the_origin_of_a_plane_frame_is_the_projection_of_the_point(
    tilt: float, azimuth: float, above: tuple[float, ...]
) -> None:
    normal = np.array([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)])
    plane, point = Plane(normal, np.array([0.1, 0.2, 0.3]), 1.0), np.array(above)
    frame = plane_frame(plane, point)
    np.testing.assert_allclose(frame.rotate(np.array([0.0, 0.0, 1.0])), normal, atol=1e-12)
    assert abs(normal @ (frame.xyz - plane.point)) < 1e-12
    np.testing.assert_allclose(frame.inverse().apply(point)[:2], 0, atol=1e-12)


# faces


def corner_points(size: np.ndarray, pose: Pose) -> np.ndarray:
    return pose.apply(np.array(list(product((-0.5, 0.5), repeat=3))) * size)


def axes_of(pose: Pose) -> np.ndarray:
    """(6, 3) outward normals of a box: x, y, z, -x, -y, -z."""
    axes = pose.rotation_matrix().T
    return np.concatenate([axes, -axes])


@given(size=st.tuples(*[st.floats(5e-3, 50e-3)] * 3), pose=poses())
def test_a_box_stands_on_its_six_faces(size: tuple[float, ...], pose: Pose) -> None:
    faces = standing_faces(corner_points(np.array(size), pose), pose.xyz, np.radians(4))
    x, y, z = size
    assert len(faces) == 6
    np.testing.assert_allclose(sorted(face.area for face in faces), sorted([y * z, x * z, x * y] * 2), rtol=1e-6)
    for normal in axes_of(pose):
        assert max(float(face.normal @ normal) for face in faces) == pytest.approx(1, abs=1e-9)
    assert [face.area for face in faces] == sorted((face.area for face in faces), reverse=True)


@given(pose=poses(), beyond=st.floats(1.2e-3, 5e-3), axis=st.integers(0, 2))
def test_a_box_with_its_middle_outside_a_face_stands_on_two_faces(pose: Pose, beyond: float, axis: int) -> None:
    """The middle is moved out through one face: it projects onto this face and its opposite only."""
    middle = np.zeros(3)
    middle[axis] = SIZE[axis] / 2 + beyond
    faces = standing_faces(corner_points(SIZE, pose), pose.apply(middle), np.radians(4))
    assert len(faces) == 2
    for face in faces:
        assert abs(face.normal @ axes_of(pose)[axis]) == pytest.approx(1, abs=1e-9)


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.zeros((3, 3)), np.outer(np.arange(9), [1e-3, 2e-3, 0])])
def test_points_without_extent_have_no_face(points: np.ndarray) -> None:
    assert standing_faces(points, np.zeros(3), np.radians(4)) == []


# rotations and duplicates


@given(now=poses(), plate=poses(), guess=poses(), angle=st.floats(0.01, MAX_ANGLE))
def test_every_rotation_near_the_guess_is_near_a_searched_one(
    now: Pose, plate: Pose, guess: Pose, angle: float
) -> None:
    rotations = OrientedPart(volume_of(cuboid()), np.zeros(3), now.rotate(UP)).rotations
    inside = SearchWindow(np.zeros(3), guess, angle, MAX_OFFSET).rotations_inside(rotations, plate)

    def between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        cosines = (np.einsum("aij,bij->ab", a, b) - 1) / 2
        return np.arccos(np.clip(cosines, -1, 1))

    guessed = (plate @ guess).rotation_matrix()[None]
    assert (between(rotations.rotation_matrix()[inside], guessed) <= angle + YAW_STEP / 2 + 1e-6).all()
    about = Pose.from_rotvec(np.linspace(0, 2 * np.pi, 500)[:, None] * UP)
    every = (about @ Pose(rotations.wxyz[0], np.zeros(3))).rotation_matrix()
    near = every[between(every, guessed)[:, 0] < angle - 1e-6]
    assert (between(near, rotations.rotation_matrix()[inside]).min(1, initial=np.pi) <= YAW_STEP / 2 + 1e-6).all()


@given(now=poses())
def test_without_a_guess_all_yaws_are_searched(now: Pose) -> None:
    """All of them turn the chosen face down."""
    down = now.rotate(UP)
    rotations = OrientedPart(volume_of(cuboid()), np.zeros(3), down).rotations
    assert SearchWindow(np.zeros(3), None, MAX_ANGLE, MAX_OFFSET).rotations_inside(rotations, IDENTITY).all()
    np.testing.assert_allclose(rotations.rotate(down), np.broadcast_to(-UP, (len(rotations), 3)), atol=1e-9)
    beside = rotations.rotate(now.rotate(np.array([1.0, 0, 0])))
    around = np.sort(np.arctan2(beside[:, 1], beside[:, 0]))
    np.testing.assert_allclose(np.diff(np.append(around, around[0] + 2 * np.pi)), YAW_STEP, atol=1e-6)


@given(seed=st.integers(0, 50), most=st.integers(1, 6))
def test_kept_candidates_are_no_duplicates_and_the_others_are(seed: int, most: int) -> None:
    rng = np.random.default_rng(seed)
    plate = find_cavity(*on_a_plate(ell_kit().kit().mesh, IDENTITY), IDEAL.noise)
    assert plate is not None
    cavities = [plate, replace(plate, depth=plate.depth + 4e-3)]
    pivot = np.array([0.3, 0.2, 0.1])
    found = []
    for k in range(25):
        error = apply_error(IDENTITY, pivot, rng.uniform(-4e-3, 4e-3, 3), rng.normal(0, 0.08, 3))
        found.append(Candidate(cavities[rng.integers(2)], error, UP, float(k)))
    kept = without_duplicates(found, pivot, most)

    def near(a: Candidate, b: Candidate) -> bool:
        shift = np.linalg.norm(a.plate_from_now.apply(pivot) - b.plate_from_now.apply(pivot))
        cosine = (np.trace(a.plate_from_now.rotation_matrix().T @ b.plate_from_now.rotation_matrix()) - 1) / 2
        angle = np.arccos(np.clip(cosine, -1, 1))
        return bool(
            shift <= DUPLICATE_DISTANCE
            and angle < 1.5 * YAW_STEP
            and abs(a.cavity.depth - b.cavity.depth) <= DEPTH_TOLERANCE
        )

    assert kept[0] is found[0]
    assert len(kept) <= most
    assert [c.cost for c in kept] == sorted(c.cost for c in kept)
    for i, one in enumerate(kept):
        assert not any(near(one, other) for other in kept[:i])
    if len(kept) < most:
        assert all(any(near(one, other) for other in kept) for one in found)
