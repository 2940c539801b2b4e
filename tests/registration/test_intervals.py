"""Registration by what is certain: contradictions and intervals against closed forms, brute force and known poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt

from kit1000.perception.image_kinds import IDEAL
from kit1000.perception.observed.parts import PartBounds
from kit1000.pose import Pose
from kit1000.registration.contradictions import MOST, TOLERANCE, KitHeights, contradictions
from kit1000.registration.geometry.cavity import BELOW, VOXEL, find_cavity
from kit1000.registration.geometry.sweeps import CELL, envelope_about
from kit1000.registration.refine import (
    MAX_RESIDUAL,
    IntervalProblem,
    clipped_rms,
    floor_is_seen,
    refine_within,
    sweeps_of,
)
from kit1000.voxels import Volume
from tests.samples.registration_cases import CASES, CLEARANCE, Case, case, known_cavity, known_shape, perturbed

SCALES = (4e-3, 2e-3, 1e-3, 0.5e-3)  # [m] of robust weights


def exact(volume: Volume) -> PartBounds:
    """Bounds that leave nothing unknown."""
    return PartBounds(volume, volume, volume)


def unknown(volume: Volume) -> PartBounds:
    """Bounds that make nothing certain: no voxel is surely solid, all are possible."""
    nothing, all_of_it = np.ones(volume.values.shape, np.float32), -np.ones(volume.values.shape, np.float32)
    return PartBounds(volume, Volume(volume.grid, nothing), Volume(volume.grid, all_of_it))


# contradictions


def contradictions_at(known: Case, motion: Pose, bounds: PartBounds | None = None) -> tuple[float, float]:
    """[mm] free space in the part and part in the kit, the part moved in the plate's frame from its goal."""
    pose = motion @ known.candidate(known.goal).plate_from_now
    kit = KitHeights.of(known.cavity, CLEARANCE)
    found = contradictions(known_shape(known.part, known.pivot, bounds), kit, pose)
    return found.free_in_part * 1e3, found.part_in_kit * 1e3


@pytest.mark.parametrize("name", CASES)
def test_nothing_contradicts_the_goal(name: str) -> None:
    free, inside = contradictions_at(case(name), Pose.identity())
    assert (free < 0.02, inside < 0.02) == (True, True)


@pytest.mark.parametrize("name", CASES)
def test_a_part_beside_its_cavity_contradicts(name: str) -> None:
    for shift in ((8e-3, 0, 0), (0, -8e-3, 0)):
        free, inside = contradictions_at(case(name), Pose.from_translation(shift))
        assert free > 0.1
        assert inside > 0.1


@pytest.mark.parametrize("name", CASES)
def test_a_part_too_low_is_in_the_kit_and_one_too_high_leaves_it_empty(name: str) -> None:
    free, inside = contradictions_at(case(name), Pose.from_translation((0, 0, -4e-3)))
    assert inside > 0.2
    free, inside = contradictions_at(case(name), Pose.from_translation((0, 0, 4e-3)))
    assert free > 0.5
    assert inside < 0.02


def test_what_is_unknown_contradicts_nothing() -> None:
    known = case("an L")
    free, _ = contradictions_at(known, Pose.from_translation((8e-3, 0, 0)), unknown(known.part))
    assert free == 0
    n = known.cavity.heights.shape
    hidden = replace(known.cavity, certain_heights=np.full(n, np.nan), certain_free=np.full(n, 4e-3))
    kit = KitHeights.of(hidden, CLEARANCE)
    pose = Pose.from_translation((8e-3, 0, 0)) @ known.candidate(known.goal).plate_from_now
    found = contradictions(known_shape(known.part, known.pivot), kit, pose)
    assert found.part_in_kit < 0.1e-3  # the region may be as deep as it is, the rest deeper
    assert found.free_in_part == 0


@given(st.integers(0, 2**32 - 1))
def test_the_depth_of_points_in_the_kit_is_that_of_brute_force(seed: int) -> None:
    rng = np.random.default_rng(seed)
    heights = np.where(rng.random((20, 20)) < 0.5, 0.0, rng.uniform(-0.01, -0.003, (20, 20)))
    kit = KitHeights.of(known_cavity(heights), CLEARANCE)
    points = rng.uniform(-0.012, 0.012, (40, 3))
    volume = case("an L").part
    found = contradictions(replace(known_shape(volume, np.zeros(3)), points=points), kit, Pose.identity()).part_in_kit
    total = 0.0
    for x, y, z in points:
        i, j = round(x / 1e-3 + 9.5), round(y / 1e-3 + 9.5)
        if max(abs(x), abs(y)) <= 9.5e-3:
            total += min(max(heights[i, j] - z - TOLERANCE, 0), MOST)
    assert found == pytest.approx(total / len(points), abs=1e-15)


def test_a_shrunk_cavity_lies_one_clearance_within() -> None:
    """Its cells are those farther than the clearance from everything outside, to half a cell."""
    heights = np.zeros((40, 40))
    heights[8:30, 10:34] = -0.01
    kit = KitHeights.of(known_cavity(heights), CLEARANCE)
    cells = np.rint(kit.must_fill[:, :2] / 1e-3 + 19.5).astype(int)
    found = np.zeros(heights.shape, bool)
    found[tuple(cells.T)] = True
    np.testing.assert_array_equal(found, np.asarray(distance_transform_edt(heights < 0)) > 3)
    np.testing.assert_allclose(kit.must_fill[:, 2], -0.01)
    np.testing.assert_array_equal(kit.span, 0)


def test_a_jump_behind_a_near_rim_is_no_certain_surface() -> None:
    """From free to behind the rim within a voxel: the rim hides what is there."""
    known = case("an L")
    whole, volume = known.cavity, known.kit
    np.testing.assert_array_equal(whole.certain_heights, whole.heights)
    np.testing.assert_array_equal(whole.certain_free, whole.free)
    i, j = np.argwhere(whole.region & (whole.heights < -7e-3))[40]
    values = volume.values.copy()
    k = round((BELOW - 4e-3) / VOXEL)  # 4 mm below the plate's face
    values[i, j, : k + 1], values[i, j, k + 1 :] = -0.1, 1.0
    cavity = find_cavity(Volume(volume.grid, values), whole.world_from_plate, IDEAL.noise)
    assert cavity is not None
    assert cavity.heights[i, j] == pytest.approx(-4e-3, abs=VOXEL)
    assert np.isnan(cavity.certain_heights[i, j])
    assert cavity.certain_free[i, j] == pytest.approx(-3e-3, abs=1e-9)


# intervals


def test_the_envelope_from_a_start_is_the_envelope_above_it() -> None:
    """Also where the start is inside the solid; where it is infinite there is nothing."""
    known = case("a keyed block")
    rotation = Pose(known.candidate(known.goal).plate_from_now.wxyz, np.zeros(3))
    whole = envelope_about(known.part, known.pivot, rotation, CLEARANCE)
    assert np.isfinite(whole).sum() > 500
    below = envelope_about(known.part, known.pivot, rotation, CLEARANCE, whole - 1.3e-3)
    solid = np.isfinite(whole)
    differences = np.abs(below[solid] - whole[solid])
    assert (differences < CELL).mean() > 0.99  # except where a ray grazes a wall
    np.testing.assert_array_equal(np.isinf(below), np.isinf(whole))
    assert np.isinf(envelope_about(known.part, known.pivot, rotation, CLEARANCE, np.full(whole.shape, np.inf))).all()
    within = envelope_about(known.part, known.pivot, rotation, CLEARANCE, whole + 2e-3)
    assert (within[np.isfinite(within)] >= whole[np.isfinite(within)]).all()


def problem_at(known: Case, bounds: PartBounds, hold: float = 0.0) -> tuple[IntervalProblem, np.ndarray]:
    """The problem with the part at its goal, and its twist there."""
    pose = known.candidate(known.goal).plate_from_now
    rotation = Pose(pose.wxyz, np.zeros(3))
    sweeps = sweeps_of(bounds, known.pivot, rotation, known.cavity.depth, CLEARANCE)
    middle = pose.apply(known.pivot)
    normal = rotation.rotate(known.down_normal)
    problem = IntervalProblem(known.cavity.points, sweeps, normal, CLEARANCE, 0.1, float(middle[2]), hold)
    return problem, np.concatenate([np.zeros(3), middle])


def distances_at(problem: IntervalProblem, twist: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n,) [m] twice at one twist (6,): from the intervals, from the filled part."""
    (outside,), (filled,) = problem.distances(twist[None], problem.floors_at(twist))
    return outside, filled


@pytest.mark.parametrize("name", CASES)
def test_where_nothing_is_unknown_intervals_are_distances(name: str) -> None:
    problem, twist = problem_at(case(name), exact(case(name).part))
    for offset in (np.zeros(6), np.array([0.02, 0, -0.03, 1e-3, -2e-3, 1e-3])):
        outside, filled = distances_at(problem, twist + offset)
        differences = np.abs(outside - filled)  # surfaces are traced from different heights
        assert differences.max() < 2 * CELL
        assert differences.mean() < 0.01e-3


@pytest.mark.parametrize("name", CASES)
def test_where_nothing_is_certain_no_point_is_outside(name: str) -> None:
    problem, twist = problem_at(case(name), unknown(case(name).part))
    outside, filled = distances_at(problem, twist + np.array([0, 0, 0, 3e-3, 0, 0]))
    np.testing.assert_array_equal(outside, 0)
    assert np.abs(filled).max() > 1e-3


@pytest.mark.parametrize("name", CASES)
def test_less_certainty_never_puts_a_point_farther_outside(name: str) -> None:
    known = case(name)
    values, grid = known.part.values, known.part.grid
    wider = PartBounds(
        known.part, Volume(grid, np.minimum(values + 0.3, 1)), Volume(grid, np.maximum(values - 0.3, -1))
    )
    (sure, twist), (unsure, _) = (problem_at(known, bounds) for bounds in (exact(known.part), wider))
    for offset in (0, 1e-3, -2e-3):
        at = twist + np.array([0, 0, 0, offset, -offset, offset])
        assert (np.abs(distances_at(unsure, at)[0]) <= np.abs(distances_at(sure, at)[0]) + 1e-9).all()


@pytest.mark.parametrize("name", CASES)
def test_with_certain_volumes_refinement_converges_to_the_goal(name: str) -> None:
    known = case(name)
    for seed in range(2):
        pose, outside, filled = refine_within(
            exact(known.part), known.pivot, perturbed(known, seed), CLEARANCE, 0.1, SCALES
        )
        distance, angle = known.error_of(pose)
        assert (distance < 0.3, angle < 0.6) == (True, True), f"{distance:.2f} mm, {angle:.2f} degrees from {seed}"
        assert max(outside, filled) < CELL


@pytest.mark.parametrize("name", ["an L", "a bar"])
def test_false_material_moves_the_fit_less_where_it_is_known_to_be_uncertain(name: str) -> None:
    """The filled part has 3 mm too much on two sides, within what is possible."""
    known = case(name)
    candidate = known.candidate(known.goal)
    aside = candidate.plate_from_now.inverse().rotate((3e-3, 3e-3, 0.0))
    shift = tuple(np.rint(aside / known.part.grid.voxel_size).astype(int).tolist())
    grown = np.minimum(known.part.values, np.roll(known.part.values, shift, (0, 1, 2)))
    filled = Volume(known.part.grid, grown)
    believed = refine_within(exact(filled), known.pivot, candidate, CLEARANCE, 0.1, SCALES).plate_from_now
    bounds = PartBounds(filled, known.part, filled)
    within = refine_within(bounds, known.pivot, candidate, CLEARANCE, 0.1, SCALES).plate_from_now
    assert known.error_of(within)[0] < 0.7 * known.error_of(believed)[0]


def test_a_floor_is_seen_where_points_lie_on_it() -> None:
    known = case("a bar")
    assert floor_is_seen(known.cavity)
    walls = known.cavity.points[known.cavity.points[:, 2] > -known.cavity.depth / 2]
    n = known.cavity.heights.shape
    assert not floor_is_seen(replace(known.cavity, points=walls, certain_heights=np.full(n, np.nan)))
    assert not floor_is_seen(replace(known.cavity, points=np.zeros((0, 3))))


def test_where_no_floor_is_seen_the_height_is_held() -> None:
    """With walls alone a prism slides along its axis; held, it stays at the height of the search."""
    known = case("a bar")
    walls = known.cavity.points[known.cavity.points[:, 2] > -0.6 * known.cavity.depth]
    n = known.cavity.heights.shape
    hidden = replace(known.cavity, points=walls, certain_heights=np.full(n, np.nan))
    candidate = replace(known.candidate(known.goal), cavity=hidden)
    held, _, _ = refine_within(unknown(known.part), known.pivot, candidate, CLEARANCE, 0.1, SCALES)
    start = candidate.plate_from_now.apply(known.pivot)[2]
    assert abs(held.apply(known.pivot)[2] - start) < 0.5e-3


def test_the_misfit_of_no_residuals_is_the_worst_and_a_number() -> None:
    assert clipped_rms(np.empty(0)) == MAX_RESIDUAL
    assert clipped_rms(np.full(7, 10 * MAX_RESIDUAL)) == pytest.approx(MAX_RESIDUAL, rel=1e-12)
