"""Which candidates registration refines and how their fits are ranked: distinct ones, and on faces that are hidden."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from kit1000.mesh import mesh_from_solid
from kit1000.perception.image_kinds import D415, IDEAL, PHOTONEO, RESTORED, ImageKind
from kit1000.perception.observed.parts import HALF_WIDTH
from kit1000.pose import Pose
from kit1000.queries.guesses import MAX_ANGLE
from kit1000.queries.motions import apply_error
from kit1000.registration.geometry.faces import squared, standing_faces
from kit1000.registration.method import (
    COARSE_WEIGHT,
    MORE_COST,
    MOST_TRIED,
    UNSEEN_CHOICE,
    UNSEEN_COST,
    USUAL_CAMERA_SPREAD,
    FitSearch,
    PartRegistration,
)
from kit1000.registration.prepared_image import RestoredImage
from kit1000.registration.rank import (
    LARGEST_MARGIN,
    SAME_ANGLE,
    SAME_DISTANCE,
    Fit,
    confidence,
    margin,
    ranked,
    same_pose,
)
from kit1000.registration.search import DOWN, LIES, NEAR_GUESS, SLACK_ANGLE, UPRIGHT, Candidate, faces_down, tilted
from kit1000.voxels import Grid, signed_distance, surface_points
from tests.samples.registration_cases import CASES, CLEARANCE, Case, case, known_shape, perturbed
from tests.samples.registration_images import GAIN, image_of, moved
from tests.samples.shapes import box, standing


def part_of(known: Case, kind: ImageKind = IDEAL, image: RestoredImage | None = None) -> PartRegistration:
    """A part whose shape is known exactly."""
    scene: Any = SimpleNamespace(kits=None, camera=None, kind=kind)
    query: Any = SimpleNamespace(guess=None, pivot=known.pivot)
    return PartRegistration(scene, known_shape(known.part, known.pivot), image, query, CLEARANCE)


def fits_of(known: Case, candidates: list[Candidate], most: int, more: bool = True) -> list[Fit]:
    """The fits of some candidates."""
    part: Any = part_of(known)
    part.candidates = lambda: candidates
    search = FitSearch(part)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("kit1000.registration.method.REFINED_WITHOUT_GUESS", most)
        search.first_fits()
        if more:
            search.all_fits()
    return search.fits


def test_candidates_that_end_in_one_pose_are_refined_further_only_once() -> None:
    known = case("a keyed block")
    turned = known.candidate(apply_error(known.goal, known.pivot, np.zeros(3), np.array([0, 0, np.pi])))
    near = [perturbed(known, seed) for seed in range(3)]
    kept = fits_of(known, [*near, turned], 2)
    assert len(kept) == 2
    position, angle = known.error_of(kept[0].candidate.plate_from_now)
    assert position < 0.3
    assert angle < 1
    assert known.error_of(kept[1].candidate.plate_from_now)[1] > 20
    assert len(fits_of(known, near, 3)) == 1
    assert fits_of(known, [], 3) == []


def test_further_candidates_are_refined_only_while_the_best_fit_is_doubtful() -> None:
    known = case("a keyed block")
    right = known.candidate(known.goal)
    turned = known.candidate(apply_error(known.goal, known.pivot, np.zeros(3), np.array([0, 0, np.pi])))
    alone = part_of(known).fitted(turned).cost
    assert part_of(known).fitted(right).cost < IDEAL.refinement.doubtful < alone
    doubtful = fits_of(known, [turned, right], 1)
    assert [known.error_of(fit.candidate.plate_from_now)[1] < 1 for fit in doubtful] == [False, True]
    assert doubtful[1].cost == pytest.approx(fits_of(known, [right], 1)[0].cost + MORE_COST, abs=1e-12)
    assert len(fits_of(known, [right, turned], 1)) == 1  # sure already
    assert len(fits_of(known, [turned, right], 1, more=False)) == 1
    one_too_many = fits_of(known, [turned] * MOST_TRIED + [right], 1)
    assert all(known.error_of(fit.candidate.plate_from_now)[1] > 20 for fit in one_too_many)


def test_a_tilted_candidate_has_another_face_down_and_the_same_middle() -> None:
    known = case("a keyed block")
    angle = np.radians(8)
    candidate = known.candidate(known.goal)
    found = tilted(candidate, known.pivot, angle)
    assert len(found) == 4
    for other in found:
        down = other.plate_from_now.rotate(other.down_normal)
        np.testing.assert_allclose(down, [0, 0, -1], atol=1e-12)
        assert np.arccos(other.down_normal @ candidate.down_normal) == pytest.approx(angle)
        np.testing.assert_allclose(
            other.plate_from_now.apply(known.pivot), candidate.plate_from_now.apply(known.pivot), atol=1e-12
        )
    between = found[0].plate_from_now @ found[1].plate_from_now.inverse()
    assert between.angle() == pytest.approx(2 * angle)
    assert tilted(candidate, known.pivot, 0.0) == []


def test_a_doubtful_fit_on_an_unseen_face_is_tilted_until_it_fits() -> None:
    """Contact with the floor holds a fit to the face that is assumed to lie there, here 8 degrees off."""
    known = case("a keyed block")
    right = known.candidate(known.goal)
    wrong = tilted(right, known.pivot, IDEAL.refinement.tilt)[0]
    assert wrong.down_normal[2] > UPRIGHT
    (alone,) = fits_of(known, [wrong], 1, more=False)
    assert alone.cost > IDEAL.refinement.doubtful
    best = ranked(fits_of(known, [wrong], 1))[0]
    position, angle = known.error_of(best.candidate.plate_from_now)
    assert position < 0.3
    assert angle < 1


def test_poses_are_one_within_a_millimetre_and_three_degrees() -> None:
    known = case("a bar")

    def moved(shift: float, angle: float) -> bool:
        there = apply_error(known.goal, known.pivot, np.array([0, shift, 0]), np.array([0, 0, angle]))
        assert same_pose(known.goal, there, known.pivot) == same_pose(there, known.goal, known.pivot)
        return same_pose(known.goal, there, known.pivot)

    assert moved(0.0, 0.0)
    assert moved(0.9 * SAME_DISTANCE, 0.9 * SAME_ANGLE)
    assert not moved(1.1 * SAME_DISTANCE, 0.0)
    assert not moved(0.0, 1.1 * SAME_ANGLE)


def test_the_margin_of_a_fit_is_over_the_next_in_another_pose() -> None:
    known = case("an L")
    seated = part_of(known).fitted(known.candidate(known.goal))
    beside = apply_error(known.goal, known.pivot, np.array([0.5 * SAME_DISTANCE, 0, 0]), np.zeros(3))
    turned = apply_error(known.goal, known.pivot, np.zeros(3), np.array([0, 0, np.pi]))
    twin = replace(seated, cost=seated.cost + 1e-4, goal_from_now=beside)
    rival = replace(seated, cost=seated.cost + 7e-4, goal_from_now=turned)
    assert margin(seated, [seated], known.pivot) == margin(seated, [seated, twin], known.pivot) == LARGEST_MARGIN
    fits = ranked([rival, twin, seated])
    assert [margin(fit, fits, known.pivot) for fit in fits] == pytest.approx([7e-4, 6e-4, -7e-4])


LENGTHS = st.lists(st.floats(0, 0.05), min_size=2, max_size=2)


@given(uncertainties=LENGTHS, margins=LENGTHS, kind=st.sampled_from([IDEAL, PHOTONEO, D415, RESTORED]))
def test_confidence_falls_with_uncertainty_and_rises_with_the_margin(
    uncertainties: list[float], margins: list[float], kind: ImageKind
) -> None:
    elsewhere = Pose.from_translation((1.0, 0.0, 0.0))

    def sure(uncertainty: float, ahead: float) -> float:
        fits: Any = [
            Fit(Pose.identity(), 0.0, uncertainty, cast(Candidate, None)),
            Fit(elsewhere, ahead, 0.0, cast(Candidate, None)),
        ]
        return confidence(fits[0], fits, np.zeros(3), kind.curve)

    low, high = sorted(uncertainties)
    less, more = sorted(margins)
    assert 1 >= sure(low, more) >= sure(high, more) >= sure(high, less) >= 0


def test_a_fit_beside_the_goal_is_less_certain() -> None:
    known = case("a keyed block")
    seated, turned = (
        part_of(known).fitted(known.candidate(apply_error(known.goal, known.pivot, np.zeros(3), np.array([0, 0, a]))))
        for a in (0.0, np.pi)
    )
    assert seated.uncertainty == seated.cost  # of ideal depth both are one sum
    assert turned.uncertainty > seated.uncertainty + 0.5e-3


def test_an_uncertain_camera_adds_uncertainty_and_no_cost() -> None:
    known = case("a keyed block")
    right = known.candidate(known.goal)

    def fitted(spread: float | None, kind: ImageKind = RESTORED) -> Fit:
        part: Any = part_of(known, kind)
        part.camera = None if spread is None else SimpleNamespace(spread_of=lambda motion, point: spread)
        return part.fitted(right)

    unknown, usual, wide = (fitted(spread) for spread in (None, USUAL_CAMERA_SPREAD, 2 * USUAL_CAMERA_SPREAD))
    assert unknown.uncertainty == pytest.approx(usual.uncertainty, abs=1e-12)
    added = RESTORED.refinement.camera * USUAL_CAMERA_SPREAD
    assert wide.uncertainty == pytest.approx(usual.uncertainty + added, abs=1e-12)
    assert unknown.cost == usual.cost == wide.cost
    assert fitted(1.0, IDEAL).uncertainty == fitted(None, IDEAL).uncertainty  # its camera is exact


def test_a_fit_that_the_image_shows_worse_than_the_best_costs_more() -> None:
    known = case("an L")
    shown = image_of("an L", noise_px=0.3)
    part = part_of(known, RESTORED, RestoredImage(shown, shown, GAIN * RESTORED.refinement.noise_px))
    fits = [part_of(known).fitted(moved(known, *move)) for move in ((0, 0, 0), (8, 8, 40))]
    assert part_of(known, IDEAL, part.image).in_image(fits) == fits
    right, wrong = part.in_image(fits)
    assert right.cost == fits[0].cost
    assert wrong.cost > fits[1].cost + 5e-3
    (alone,) = part.in_image(fits[1:])
    assert alone.cost == fits[1].cost


def test_goals_in_restored_images_are_raised_and_exact_ones_are_not() -> None:
    known = case("an L")
    fit = part_of(known).fitted(known.candidate(known.goal))
    assert part_of(known).raised(fit) is fit
    raised = part_of(known, RESTORED).raised(fit)
    plate_from_world = fit.candidate.cavity.world_from_plate.inverse()
    moved = (plate_from_world @ raised.goal_from_now) @ (plate_from_world @ fit.goal_from_now).inverse()
    height = RESTORED.refinement.raise_goal * HALF_WIDTH
    np.testing.assert_allclose(moved.matrix(), Pose.from_translation((0.0, 0.0, height)).matrix(), atol=1e-12)
    assert 0.2e-3 < height < 1e-3  # a share of the clearance
    there = raised.candidate.cavity.world_from_plate @ raised.candidate.plate_from_now
    np.testing.assert_allclose(there.matrix(), raised.goal_from_now.matrix(), atol=1e-12)
    assert (raised.cost, raised.uncertainty) == (fit.cost, fit.uncertainty)


def test_of_candidates_that_contradict_equally_the_better_coarse_match_is_first() -> None:
    known = case("an L")
    good = replace(known.candidate(known.goal), cost=0.1)
    poor = replace(good, cost=0.6)
    assert part_of(known).least_contradictory([poor, good]) == [good, poor]
    assert COARSE_WEIGHT < 2e-3  # a contradiction of 2 mm outweighs any coarse match


def test_a_face_that_the_part_does_not_show_must_fit_better_than_one_that_it_shows() -> None:
    known = case("a keyed block")
    shown = known.candidate(known.goal)
    hidden = replace(shown, seen=False)
    search = part_of(known)
    assert search.least_contradictory([hidden, shown]) == [shown, hidden]
    worse = replace(shown, cost=2 * UNSEEN_CHOICE / COARSE_WEIGHT)
    assert search.least_contradictory([worse, hidden]) == [hidden, worse]
    assert search.fitted(hidden).cost == pytest.approx(search.fitted(shown).cost + UNSEEN_COST, abs=1e-12)


def normals_down(known: Case, guess: Pose) -> list[np.ndarray]:
    """The normals of the faces that may go into the known cavity."""
    groups = faces_down(known.part, guess, [known.cavity], IDEAL.noise)
    return [normal for faces in groups if faces.cavities for normal in faces.normals]


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("tilt", [5, 25])
def test_where_no_face_explains_the_guess_its_own_direction_is_tried(name: str, tilt: int) -> None:
    known = case(name)
    guess = apply_error(
        known.goal, known.pivot, np.zeros(3), known.cavity.world_from_plate.rotate((np.radians(tilt), 0, 0))
    )
    normals = normals_down(known, guess)
    guessed = guess.inverse().rotate(known.cavity.world_from_plate.rotate((0.0, 0.0, -1.0)))
    own = [guessed, squared(guessed, MAX_ANGLE)]
    others = [normal for normal in normals if all(np.abs(normal - each).max() > 1e-12 for each in own)]
    explained = max((float(guessed @ normal) for normal in others), default=-1.0) > NEAR_GUESS
    assert (max(float(guessed @ normal) for normal in normals) > 1 - 1e-12) == (not explained)
    assert max(float(known.down_normal @ normal) for normal in normals) > np.cos(np.radians(4))  # its face, as ever


@pytest.mark.parametrize("name", CASES)
def test_faces_are_seen_where_the_volume_has_them(name: str) -> None:
    known = case(name)
    guess = apply_error(known.goal, known.pivot, np.zeros(3), known.cavity.world_from_plate.rotate((0.4, 0, 0)))
    middle = known.part.grid.world(np.argwhere(known.part.occupied)).mean(0)
    has = [face.normal for face in standing_faces(surface_points(known.part), middle, IDEAL.noise.angle)]
    for faces in faces_down(known.part, guess, [known.cavity], IDEAL.noise):
        for normal in faces.normals if faces.cavities else []:
            near = max(float(normal @ face) for face in has)
            assert faces.seen == (near > np.cos(IDEAL.noise.angle))


@pytest.mark.parametrize("slope_deg", [5.5, 7.0])
def test_a_top_that_is_nearly_level_is_tried_as_it_is(slope_deg: float) -> None:
    tilted = Pose.from_rotvec((np.radians(slope_deg), 0, 0))
    wedge = box(36, 24, 12).trim_by_plane((0, np.sin(np.radians(slope_deg)), -np.cos(np.radians(slope_deg))), -8)
    grid = Grid.centred(Pose.identity(), (84, 84, 84), 1e-3)
    part = signed_distance(grid, [(mesh_from_solid(standing(wedge)), Pose.identity())], threads=1)
    top = tilted.rotate((0.0, 0.0, 1.0))
    cavity: Any = SimpleNamespace(world_from_plate=Pose.identity())
    guess = Pose.from_rotvec((np.pi - np.radians(slope_deg), 0, 0))
    found = faces_down(part, guess, [cavity], IDEAL.noise)
    tried = [normal for faces in found if faces.seen for normal in faces.normals]
    assert max(float(top @ normal) for normal in tried) > np.cos(np.radians(1))


@given(tilt_deg=st.floats(0, 180), turn=st.floats(-3, 3), yaw=st.floats(-3, 3))
@settings(max_examples=20, deadline=None)
def test_a_part_goes_in_on_the_face_on_which_it_lies_where_the_guess_allows_that(
    tilt_deg: float, turn: float, yaw: float
) -> None:
    known = case("an L")
    tilted = Pose.from_rotvec(np.radians(tilt_deg) * np.array([np.cos(turn), np.sin(turn), 0]))
    guess = known.cavity.world_from_plate @ Pose.from_rotvec((0, 0, yaw)) @ tilted
    normals = normals_down(known, guess)
    assume(abs(tilt_deg - np.degrees(np.arccos(LIES))) > 1e-6)
    lies = tilt_deg < np.degrees(np.arccos(LIES))
    assert (len(normals) == 1 and np.array_equal(normals[0], DOWN)) == lies
    for normal in normals:
        angle = np.degrees(np.arccos(np.clip(tilted.rotate(normal) @ DOWN, -1, 1)))
        assert angle < np.degrees(MAX_ANGLE + SLACK_ANGLE + IDEAL.noise.angle) + 1e-6
