"""Which candidates registration refines: distinct ones, and in directions that the image does not show."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from kit1000.mesh import mesh_from_solid
from kit1000.perception.observed.parts import HALF_WIDTH, PartEvidence
from kit1000.perception.observed.pixels import IDEAL
from kit1000.pose import Pose
from kit1000.queries.guesses import MAX_ANGLE
from kit1000.queries.motions import apply_error
from kit1000.registration.choice.confidence import CURVES, confidence
from kit1000.registration.choice.fits import LARGEST_LEAD, SAME_ANGLE, SAME_DISTANCE, Fit, lead, ranked, same_pose
from kit1000.registration.choice.from_evidence import (
    COARSE_WEIGHT,
    EXACT,
    FURTHER_MISFIT,
    MOST_TRIED,
    REFINEMENTS,
    RESTORED,
    TYPICAL_CAMERA_SPREAD,
    UNSEEN_CHOICE,
    UNSEEN_MISFIT,
    EvidenceSearch,
)
from kit1000.registration.geometry.faces import squared, standing_faces
from kit1000.registration.search.candidates import DOWN, LIES, NEAR_GUESS, SLACK_ANGLE, faces_down
from kit1000.registration.search.correlation import UPRIGHT, tilted
from kit1000.voxels import Grid, signed_distance, surface_points
from tests.samples.registration_cases import CASES, CLEARANCE, Case, case, perturbed
from tests.samples.registration_images import GAIN, image_of, moved
from tests.samples.shapes import box, standing


def search_for(known: Case, further: bool = True) -> EvidenceSearch:
    """The search with evidence that leaves nothing unknown."""
    told = PartEvidence(known.part, known.part, known.part)
    shown = {"part_points": surface_points(known.part)[::20], "hidden_outline": 0.0}
    kind = {"completer": None, "restored": False, "half_width": HALF_WIDTH}
    source: Any = SimpleNamespace(evidence=told, middle=known.pivot, **kind, **shown)
    return EvidenceSearch(source, SimpleNamespace(guess=None, pivot=known.pivot, sensor="ideal"), CLEARANCE, further)  # type: ignore[arg-type]


def test_candidates_that_end_in_one_pose_are_refined_further_only_once() -> None:
    known = case("a keyed block")
    turned = known.candidate(apply_error(known.goal, known.pivot, np.zeros(3), np.array([0, 0, np.pi])))
    near = [perturbed(known, seed) for seed in range(3)]
    kept = search_for(known).fits([*near, turned], 2)
    assert len(kept) == 2
    position, angle = known.error_of(kept[0].candidate.plate_from_now)
    assert position < 0.3
    assert angle < 1
    assert known.error_of(kept[1].candidate.plate_from_now)[1] > 20
    assert len(search_for(known).fits(near, 3)) == 1
    assert search_for(known).fits([], 3) == []


def test_further_candidates_are_refined_only_while_the_best_fit_is_doubtful() -> None:
    known = case("a keyed block")
    right = known.candidate(known.goal)
    turned = known.candidate(apply_error(known.goal, known.pivot, np.zeros(3), np.array([0, 0, np.pi])))
    alone = search_for(known).fitted(turned).misfit
    assert search_for(known).fitted(right).misfit < EXACT.doubtful < alone
    doubtful = search_for(known).fits([turned, right], 1)
    assert [known.error_of(fit.candidate.plate_from_now)[1] < 1 for fit in doubtful] == [False, True]
    assert doubtful[1].misfit == pytest.approx(search_for(known).fits([right], 1)[0].misfit + FURTHER_MISFIT, abs=1e-12)
    assert len(search_for(known).fits([right, turned], 1)) == 1  # sure already
    assert len(search_for(known, further=False).fits([turned, right], 1)) == 1
    one_too_many = search_for(known).fits([turned] * MOST_TRIED + [right], 1)
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
    wrong = tilted(right, known.pivot, EXACT.tilt)[0]
    assert wrong.down_normal[2] > UPRIGHT
    (alone,) = search_for(known, further=False).fits([wrong], 1)
    assert alone.misfit > EXACT.doubtful
    best = ranked(search_for(known).fits([wrong], 1))[0]
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


def test_a_fit_leads_by_the_misfit_of_the_next_in_another_pose() -> None:
    known = case("an L")
    seated = search_for(known).fitted(known.candidate(known.goal))
    beside = apply_error(known.goal, known.pivot, np.array([0.5 * SAME_DISTANCE, 0, 0]), np.zeros(3))
    turned = apply_error(known.goal, known.pivot, np.zeros(3), np.array([0, 0, np.pi]))
    twin = replace(seated, misfit=seated.misfit + 1e-4, goal_from_now=beside)
    rival = replace(seated, misfit=seated.misfit + 7e-4, goal_from_now=turned)
    assert lead(seated, [seated], known.pivot) == lead(seated, [seated, twin], known.pivot) == LARGEST_LEAD
    fits = ranked([rival, twin, seated])
    assert [lead(fit, fits, known.pivot) for fit in fits] == pytest.approx([7e-4, 6e-4, -7e-4])


LENGTHS = st.lists(st.floats(0, 0.05), min_size=2, max_size=2)


@given(doubts=LENGTHS, leads=LENGTHS, kind=st.sampled_from(sorted(CURVES)))
def test_the_more_doubt_and_the_less_lead_the_less_confidence(
    doubts: list[float], leads: list[float], kind: tuple[str, str]
) -> None:
    low, high = sorted(doubts)
    less, more = sorted(leads)
    assert 1 >= confidence(low, more, *kind) >= confidence(high, more, *kind) >= confidence(high, less, *kind) >= 0


def test_a_fit_beside_the_goal_has_more_doubt() -> None:
    known = case("a keyed block")
    seated, turned = (
        search_for(known).fitted(
            known.candidate(apply_error(known.goal, known.pivot, np.zeros(3), np.array([0, 0, a])))
        )
        for a in (0.0, np.pi)
    )
    assert seated.doubt == seated.misfit  # ideal depth: one sum tells both
    assert turned.doubt > seated.doubt + 0.5e-3


def test_a_camera_that_leaves_more_of_a_motion_open_adds_doubt_and_no_misfit() -> None:
    known = case("a keyed block")
    right = known.candidate(known.goal)

    def fitted(spread: float | None, sensor: str = "d415") -> Fit:
        search = search_for(known)
        search.source.camera = None if spread is None else SimpleNamespace(spread_of=lambda motion, point: spread)  # type: ignore[misc, assignment]
        search.refinement = REFINEMENTS["restored" if sensor == "d415" else sensor]
        return search.fitted(right)

    unknown, typical, open_ = (fitted(spread) for spread in (None, TYPICAL_CAMERA_SPREAD, 2 * TYPICAL_CAMERA_SPREAD))
    assert unknown.doubt == pytest.approx(typical.doubt, abs=1e-12)
    assert open_.doubt == pytest.approx(typical.doubt + RESTORED.camera * TYPICAL_CAMERA_SPREAD, abs=1e-12)
    assert unknown.misfit == typical.misfit == open_.misfit
    assert fitted(1.0, "ideal").doubt == fitted(None, "ideal").doubt  # its camera is exact


def test_what_the_image_shows_worse_than_the_best_fit_adds_misfit() -> None:
    known = case("an L")
    search = search_for(known)
    fits = [search.fitted(moved(known, *move)) for move in ((0, 0, 0), (8, 8, 40))]
    assert search.in_image(fits) == fits  # of ideal depth
    search.refinement = RESTORED
    search.source.query = SimpleNamespace(image=image_of("an L", noise_px=0.3))  # type: ignore[misc, assignment]
    search.source.gain, search.source.placer = GAIN * RESTORED.noise_px, None  # type: ignore[misc, assignment]
    right, wrong = search.in_image(fits)
    assert right.misfit == fits[0].misfit
    assert wrong.misfit > fits[1].misfit + 5e-3
    (alone,) = search.in_image(fits[1:])
    assert alone.misfit == fits[1].misfit


def test_fits_in_restored_images_are_raised_out_of_the_plate_and_exact_ones_are_not() -> None:
    known = case("an L")
    search = search_for(known)
    fit = search.fitted(known.candidate(known.goal))
    assert search.lifted(fit) is fit
    search.refinement = RESTORED
    raised = search.lifted(fit)
    plate_from_world = fit.candidate.cavity.world_from_plate.inverse()
    moved = (plate_from_world @ raised.goal_from_now) @ (plate_from_world @ fit.goal_from_now).inverse()
    height = RESTORED.lift * HALF_WIDTH
    np.testing.assert_allclose(moved.matrix(), Pose.from_translation((0.0, 0.0, height)).matrix(), atol=1e-12)
    assert 0.2e-3 < height < 1e-3  # a share of the clearance
    there = raised.candidate.cavity.world_from_plate @ raised.candidate.plate_from_now
    np.testing.assert_allclose(there.matrix(), raised.goal_from_now.matrix(), atol=1e-12)
    assert (raised.misfit, raised.doubt) == (fit.misfit, fit.doubt)


def test_of_candidates_that_contradict_equally_the_better_coarse_match_is_first() -> None:
    known = case("an L")
    good = replace(known.candidate(known.goal), misfit=0.1)
    poor = replace(good, misfit=0.6)
    assert search_for(known).least_contradictory([poor, good]) == [good, poor]
    assert COARSE_WEIGHT < 2e-3  # a contradiction of 2 mm outweighs any coarse match


def test_a_face_that_the_part_does_not_show_must_fit_better_than_one_that_it_shows() -> None:
    known = case("a keyed block")
    shown = known.candidate(known.goal)
    hidden = replace(shown, seen=False)
    search = search_for(known)
    assert search.least_contradictory([hidden, shown]) == [shown, hidden]
    worse = replace(shown, misfit=2 * UNSEEN_CHOICE / COARSE_WEIGHT)
    assert search.least_contradictory([worse, hidden]) == [hidden, worse]
    assert search.fitted(hidden).misfit == pytest.approx(search.fitted(shown).misfit + UNSEEN_MISFIT, abs=1e-12)


def normals_down(known: Case, guess: Pose, thorough: bool = True) -> list[np.ndarray]:
    """The normals of the faces that may go into the known cavity."""
    query, source = SimpleNamespace(guess=guess), SimpleNamespace(noise=IDEAL)
    groups = faces_down(source, known.part, query, [known.cavity], thorough)  # type: ignore[arg-type]
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
    seen = normals_down(known, guess, thorough=False)
    for tried in (normals, seen):
        assert max(float(known.down_normal @ normal) for normal in tried) > np.cos(np.radians(4))  # its face, as ever


@pytest.mark.parametrize("name", CASES)
def test_faces_are_seen_where_the_volume_has_them(name: str) -> None:
    known = case(name)
    guess = apply_error(known.goal, known.pivot, np.zeros(3), known.cavity.world_from_plate.rotate((0.4, 0, 0)))
    source: Any = SimpleNamespace(noise=IDEAL)
    query: Any = SimpleNamespace(guess=guess)
    middle = known.part.grid.world(np.argwhere(known.part.occupied)).mean(0)
    has = [face.normal for face in standing_faces(surface_points(known.part), middle, IDEAL.angle)]
    for faces in faces_down(source, known.part, query, [known.cavity], True):
        for normal in faces.normals if faces.cavities else []:
            near = max(float(normal @ face) for face in has)
            assert faces.seen == (near > np.cos(IDEAL.angle))


@pytest.mark.parametrize("slope_deg", [5.5, 7.0])
def test_a_top_that_is_nearly_level_is_tried_as_it_is(slope_deg: float) -> None:
    tilted = Pose.from_rotvec((np.radians(slope_deg), 0, 0))
    wedge = box(36, 24, 12).trim_by_plane((0, np.sin(np.radians(slope_deg)), -np.cos(np.radians(slope_deg))), -8)
    grid = Grid.centred(Pose.identity(), (84, 84, 84), 1e-3)
    part = signed_distance(grid, [(mesh_from_solid(standing(wedge)), Pose.identity())], threads=1)
    top = tilted.rotate((0.0, 0.0, 1.0))
    cavity: Any = SimpleNamespace(world_from_plate=Pose.identity())
    guess = Pose.from_rotvec((np.pi - np.radians(slope_deg), 0, 0))
    query: Any = SimpleNamespace(guess=guess)
    source: Any = SimpleNamespace(noise=IDEAL)
    tried = [n for faces in faces_down(source, part, query, [cavity], True) if faces.seen for n in faces.normals]
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
        assert angle < np.degrees(MAX_ANGLE + SLACK_ANGLE + IDEAL.angle) + 1e-6
