"""Which candidates registration refines and how their fits are ranked: distinct ones, and on faces that are hidden."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from kit1000.mesh import mesh_from_solid
from kit1000.perception.image_kinds import D415, IDEAL, PHOTONEO, RESTORED, ImageKind
from kit1000.perception.observed.parts import HALF_WIDTH
from kit1000.pose import Pose
from kit1000.queries.guesses import MAX_ANGLE
from kit1000.queries.motions import apply_error
from kit1000.registration.geometry.faces import squared
from kit1000.registration.method import MOST_TRIED, FitSearch, PartRegistration
from kit1000.registration.prepared_image import RestoredImage
from kit1000.registration.rank import SAME_PLACE, Features, Fit, confidence, same_place, score_of, weights_of
from kit1000.registration.search import DOWN, LIES, NEAR_GUESS, SLACK_ANGLE, Candidate, faces_down
from kit1000.voxels import Grid, signed_distance
from tests.samples.registration_cases import CASES, CLEARANCE, Case, case, cuboid, known_shape, perturbed, volume_of
from tests.samples.shapes import box, standing


def part_of(known: Case, kind: ImageKind = IDEAL, image: RestoredImage | None = None) -> PartRegistration:
    """A part whose shape is known exactly."""
    query = SimpleNamespace(guess=None, pivot=known.pivot)
    scene: Any = SimpleNamespace(query=query, kits=None, camera=None, kind=kind)
    return PartRegistration(scene, known_shape(known.part, known.pivot), image, CLEARANCE)


def fits_of(known: Case, candidates: list[Candidate], most: int, more: bool = True) -> list[Fit]:
    """The fits of some candidates."""
    part: Any = part_of(known)
    part.candidates = lambda: candidates
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("kit1000.registration.method.REFINED_WITHOUT_GUESS", most)
        search = FitSearch(part)
    search.first_fits()
    if more:
        search.all_fits()
    return search.fits


def test_candidates_that_end_in_one_pose_are_refined_further_only_once() -> None:
    known = case("a keyed block")
    turned = known.candidate(apply_error(known.goal, known.pivot, np.zeros(3), np.array([0, 0, np.pi])))
    near = [perturbed(known, seed) for seed in range(3)]
    kept = fits_of(known, [*near, turned], 4)
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
    assert part_of(known).fitted(right).score > 2 > part_of(known).fitted(turned).score
    doubtful = fits_of(known, [turned, right], 1)
    assert [known.error_of(fit.candidate.plate_from_now)[1] < 1 for fit in doubtful] == [False, True]
    assert len(fits_of(known, [right, turned], 1)) == 1  # sure already
    assert len(fits_of(known, [turned, right], 1, more=False)) == 1
    one_too_many = fits_of(known, [turned] * MOST_TRIED + [right], 1)
    assert all(known.error_of(fit.candidate.plate_from_now)[1] > 20 for fit in one_too_many)


VOLUME = Features(outside=0.2, filled=0.5, contradicted=0.1, camera=0.0)
IMAGE = VOLUME._replace(misfit=0.01, spread=0.1)


@pytest.mark.parametrize("kind", [IDEAL, PHOTONEO, RESTORED, D415])
@pytest.mark.parametrize("features", [VOLUME, IMAGE])
def test_no_feature_speaks_for_a_fit(kind: ImageKind, features: Features) -> None:
    if features.misfit is not None and not kind.refinement.noise_px:
        assert set(weights_of(kind.ranking)) == {"volume"}  # no fit is refined in such an image
        return
    before = score_of(features, kind.ranking)
    worse = [features._replace(**{name: value + 1}) for name, value in features._asdict().items() if value is not None]
    assert all(score_of(each, kind.ranking) <= before for each in worse)
    assert score_of(features._replace(filled=features.filled + 1), kind.ranking) < before


def at(known: Case, shift: float = 0.0, angle: float = 0.0, score: float = 0.0) -> Fit:
    """A fit of a known part, moved across the plate [m] and rotated [rad] at its goal."""
    plate_from_now = apply_error(known.goal, known.pivot, np.array([0, shift, 0]), np.array([0, 0, angle]))
    motion, shape = known.cavity.world_from_plate @ plate_from_now, known_shape(known.part, known.pivot)
    return Fit(motion, score, cast(Candidate, None), shape, VOLUME)


def test_places_are_one_if_the_part_fills_the_same_space() -> None:
    shape = known_shape(volume_of(cuboid()), np.zeros(3))

    def same(shift: float, rotvec: tuple[float, float, float]) -> bool:
        there = Pose.from_rotvec(rotvec, (shift, 0.0, 0.0))
        one, other = (Fit(motion, 0.0, cast(Candidate, None), shape, VOLUME) for motion in (Pose.identity(), there))
        assert same_place(one, other) == same_place(other, one)
        return same_place(one, other)

    assert same(0.0, (0, 0, 0))
    assert same(0.9 * SAME_PLACE, (0, 0, 0))
    assert same(0.0, (0, 0, np.pi))  # a symmetry of a cuboid
    assert not same(3e-3, (0, 0, 0))
    assert not same(0.0, (0, 0, np.pi / 2))


SCORES = st.floats(-30, 30)


@given(own=SCORES, more=st.floats(0, 10), rival=SCORES)
def test_confidence_rises_with_the_score_and_falls_with_that_of_a_rival(own: float, more: float, rival: float) -> None:
    known = case("a keyed block")
    low, high, other = at(known, score=own), at(known, score=own + more), at(known, angle=np.pi, score=rival)
    assert 0 <= confidence(low, [low, other]) <= confidence(high, [high, other]) <= confidence(high, [high]) <= 1
    twin = at(known, shift=1e-5, score=own)
    assert confidence(low, [low, twin, other]) == confidence(low, [low, other])
    shares = [confidence(fit, [low, other]) for fit in (low, other)]
    assert sum(shares) == pytest.approx(1 - 1 / (1 + np.exp(own) + np.exp(rival)), abs=1e-8)


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
    assert raised.score == fit.score


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
    tried = [normal for faces in found for normal in faces.normals]
    assert max(float(top @ normal) for normal in tried) > np.cos(np.radians(1))


@given(tilt_deg=st.floats(0, 180), turn=st.floats(-3, 3), yaw=st.floats(-3, 3))
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
