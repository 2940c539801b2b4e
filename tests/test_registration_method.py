"""How registration decides: the search against brute force, refinement from near a known pose, and whole answers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from manifold3d import Manifold
from shapes import Seated, box, cylinder, ell, seated

from baselines.registration import Registration
from baselines.registration.cavity import Cavity, find_cavity, plate_grid
from baselines.registration.outline import expected
from baselines.registration.refine import CELL as SLICE_CELL
from baselines.registration.refine import Problem, Sweep, refine
from baselines.registration.relief import grown
from baselines.registration.search import (
    CELL,
    TURN_STEP,
    Candidate,
    KitImage,
    Window,
    coarse_search,
    places,
)
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.guesses import MAX_ANGLE, MAX_OFFSET
from kit1000.metrics import Targets, pose_errors
from kit1000.motions import apply_error, goal_motion
from kit1000.pose import Pose
from kit1000.predictor import PredictedMotion
from kit1000.testing import check_predictor, moved_query, moved_truth
from kit1000.testing.predictors import ELSEWHERE
from kit1000.values import LabelledDepth, Query, Truth
from kit1000.voxels import Grid, Volume, signed_distance

CLEARANCE = 2.5e-3
HOME = Pose.identity()
UP = np.array([0.0, 0.0, 1.0])
WORLD_FROM_KIT = Pose.from_rotvec((0.4, 0.2, 0.9), (0.3, -0.1, 0.15))
WORLD_FROM_PART = Pose.from_rotvec((1.2, -0.4, 2.0), (-0.1, 0.2, 0.03))


def bare(cavity_relief: np.ndarray, world_from_plate: Pose = HOME, depth: float = 0.01) -> Cavity:
    """A cavity whose relief is all known."""
    known = np.ones(cavity_relief.shape, bool)
    points = np.zeros((0, 3))
    return Cavity(world_from_plate, cavity_relief, cavity_relief, known, cavity_relief < 0, depth, points)


# search


def pitted(seed: int, hidden: bool = False) -> Cavity:
    """A small plate with a pit of random heights, its middle seen or not."""
    rng = np.random.default_rng(seed)
    relief = np.zeros((40, 40))
    relief[10:30, 12:28] = rng.uniform(-0.01, -0.003, (20, 16))
    cavity = bare(relief, depth=0.01)
    if not hidden:
        return cavity
    unseen = relief.copy()
    unseen[12:20, 14:20] = np.nan
    return replace(cavity, relief=unseen)


def lumps(seed: int, n: int = 20) -> np.ndarray:
    """(n, n) [m]: the lower envelope of something uneven."""
    rng = np.random.default_rng(seed)
    heights = np.full((n, n), np.inf)
    heights[5:14, 4:15] = rng.uniform(-0.02, -0.004, (9, 11))
    return heights


def brute_misfits(cavity: Cavity, kit: KitImage, envelope: np.ndarray) -> np.ndarray:
    """(size, size): the misfit at every whole shift, cell by cell; what leaves the plate counts for nothing."""
    picks = np.rint((np.arange(kit.cells) - (kit.cells - 1) / 2) * CELL / 1e-3 + (len(cavity.relief) - 1) / 2)
    relief, trust = (image[np.ix_(picks.astype(int), picks.astype(int))] for image in expected(cavity))
    sunk = np.minimum(grown(envelope, CELL, CLEARANCE) - envelope.min() - cavity.depth, 0)
    m, n = len(sunk), kit.cells
    misfits = np.ones((kit.size, kit.size))  # off the plate a part explains nothing
    for s in range(-m, n + 1):
        for t in range(-m, n + 1):
            image = np.zeros((n + 2 * m, n + 2 * m))
            image[s + m : s + 2 * m, t + m : t + 2 * m] = sunk
            inside = image[m : m + n, m : m + n]
            misfits[s, t] = (trust * (relief - inside) ** 2).sum() / (trust * relief**2).sum()
    return misfits


@pytest.mark.parametrize(("seed", "hidden"), [(0, False), (1, False), (2, True)])
def test_the_best_places_are_those_of_a_sum_of_squares_over_all_shifts(seed: int, hidden: bool) -> None:
    cavity, envelope = pitted(seed, hidden), lumps(seed)
    kit = KitImage.of(cavity)
    every = brute_misfits(cavity, kit, envelope)
    anywhere = Window(np.zeros(3), None, MAX_ANGLE, MAX_OFFSET)
    found = list(places(kit, grown(envelope, CELL, CLEARANCE), cavity, anywhere, np.zeros(3)))
    assert found[0][1] == pytest.approx(every.min(), abs=1e-9)
    assert [misfit for _, misfit in found] == sorted(misfit for _, misfit in found)
    for place, misfit in found:
        np.testing.assert_allclose(place[2], -cavity.depth - envelope.min(), atol=1e-12)  # down on the floor
        # Cell i of the envelope comes to lie on cell i + s of the plate.
        s, t = np.rint(place[:2] / CELL + (kit.cells - len(envelope)) / 2).astype(int)
        np.testing.assert_allclose((np.array([s, t]) - (kit.cells - len(envelope)) / 2) * CELL, place[:2], atol=1e-12)
        assert misfit == pytest.approx(every[s, t], abs=1e-9)


def test_no_place_is_farther_from_the_guess_than_allowed() -> None:
    """And the best of those within is the best that brute force finds there."""
    cavity, envelope = replace(pitted(0), world_from_plate=WORLD_FROM_KIT), lumps(0)
    kit = KitImage.of(cavity)
    every = brute_misfits(cavity, kit, envelope)
    z = -cavity.depth - envelope.min()
    pivot = np.array([3e-3, -2e-3, 1e-3])  # where it is before it is shifted
    home = WORLD_FROM_KIT.apply(pivot + [0.006, -0.008, z])
    window = Window(np.zeros(3), Pose.from_translation(home), MAX_ANGLE, 4e-3)
    found = list(places(kit, grown(envelope, CELL, CLEARANCE), cavity, window, pivot))
    assert found
    for place, _ in found:
        assert np.abs(WORLD_FROM_KIT.apply(pivot + place) - home).max() <= 4e-3 + 1e-12
    steps = np.arange(kit.size)
    axis = (np.where(steps > kit.size // 2, steps - kit.size, steps) - (kit.cells - len(envelope)) / 2) * CELL
    at = np.stack(np.broadcast_arrays(axis[:, None], axis[None], z), axis=-1)
    allowed = (np.abs(WORLD_FROM_KIT.apply(pivot + at) - home) <= 4e-3).all(-1)
    assert found[0][1] == pytest.approx(every[allowed].min(), abs=1e-9)


# a part and its kit where they are known to stand


class Case:
    """A part somewhere, its kit elsewhere, as exact volumes."""

    def __init__(self, known: Seated) -> None:
        self.goal = goal_motion(WORLD_FROM_PART, WORLD_FROM_KIT, known.kit_from_part)
        self.pivot = WORLD_FROM_PART.xyz + [1e-3, -2e-3, 1.5e-3]  # a pivot is nowhere special in the part
        around = Grid.centred(Pose.from_translation(self.pivot), (84, 84, 84), 1e-3)
        self.part: Volume = signed_distance(around, [(known.part.mesh, WORLD_FROM_PART)], threads=1)
        plate = WORLD_FROM_KIT @ Pose.from_rotvec((0, 0, 0.3), (5e-3, -3e-3, 0))
        grid = plate_grid(plate, 0.144)
        volume = signed_distance(grid, [(known.kit().mesh, WORLD_FROM_KIT)], threads=1)
        cavity = find_cavity(volume, plate, 0.5e-3)
        assert cavity is not None
        self.cavity = cavity
        self.down = self.goal.inverse().rotate(-WORLD_FROM_KIT.rotate(UP))

    def candidate(self, goal_from_now: Pose) -> Candidate:
        return Candidate(self.cavity, self.cavity.world_from_plate.inverse() @ goal_from_now, self.down, 0.0, 0.0)

    def missed(self, plate_from_now: Pose) -> tuple[float, float]:
        """[mm] at the pivot and [degrees] from the goal."""
        error = self.cavity.world_from_plate @ plate_from_now @ self.goal.inverse()
        home = self.goal.apply(self.pivot)
        return float(np.linalg.norm(error.apply(home) - home)) * 1e3, float(np.degrees(error.angle()))


def keyed() -> Manifold:
    return box(34, 22, 14) + box(10, 8, 14, (-6, 14, 0)) - box(8, 8, 40, (13, -9, -10))


def bar() -> Manifold:
    return box(44, 14, 12) + box(6, 6, 12, (-17, 8, 0))


def lever() -> Manifold:
    """A narrow web between eyes of two sizes."""
    eyes = cylinder(18, 12) + cylinder(10, 12).translate((26, 0, 0))
    return (eyes + box(26, 7, 12, (13, 0, 0))).translate((-10, 0, 0))


CASES = {"an L": ell, "a keyed block": keyed, "a bar": bar, "a lever": lever}


@cache
def case(name: str) -> Case:
    return Case(seated(CASES[name]()))


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("guessed", [True, False])
def test_the_search_ranks_the_truth_first(name: str, guessed: bool) -> None:
    """Among all places and turns near a bad guess, or all there are, on every face that a box about the part has."""
    known = case(name)
    guess = apply_error(known.goal, known.pivot, np.array([20e-3, -15e-3, 10e-3]), np.array([0.1, -0.2, 0.3]))
    window = Window(known.pivot, guess if guessed else None, MAX_ANGLE, MAX_OFFSET)
    found = coarse_search(known.part, WORLD_FROM_PART.xyz, [known.down, -known.down], [known.cavity], CLEARANCE, window)
    assert [each.misfit for each in found] == sorted(each.misfit for each in found)
    distance, turn = known.missed(found[0].plate_from_now)
    assert distance < 1.5e3 * CELL
    assert turn <= np.degrees(TURN_STEP)
    np.testing.assert_array_equal(found[0].down, known.down)


def perturbed(known: Case, seed: int) -> Candidate:
    """1.5 mm and 3 degrees beside the goal."""
    rng = np.random.default_rng(seed)
    shift, axis = (v / np.linalg.norm(v) for v in rng.standard_normal((2, 3)))
    return known.candidate(apply_error(known.goal, known.pivot, 1.5e-3 * shift, np.radians(3) * axis))


def residuals_at(known: Case, goal_from_now: Pose, clearance: float = CLEARANCE) -> np.ndarray:
    """(n,) [m] of the points of the cavity, the lean left out."""
    pose = known.candidate(goal_from_now).plate_from_now
    rotation = Pose(pose.wxyz, np.zeros(3))
    sweep = Sweep.of(known.part, known.pivot, rotation, known.cavity.depth, clearance)
    problem = Problem(known.cavity.points, sweep, rotation.rotate(known.down), clearance, 1.0)
    residuals = problem.residuals(np.concatenate([np.zeros(3), pose.apply(known.pivot)]))
    np.testing.assert_allclose(residuals[-2:], 0, atol=1e-9)  # the face lies flat
    return residuals[:-2]


@pytest.mark.parametrize("name", CASES)
def test_at_the_truth_every_point_lies_on_a_wall_or_the_floor(name: str) -> None:
    misses = np.abs(residuals_at(case(name), case(name).goal))
    assert np.median(misses) < 0.25 * SLICE_CELL
    assert np.percentile(misses, 99) < 1.5 * SLICE_CELL


@pytest.mark.parametrize("name", CASES)
def test_refinement_ends_at_the_truth(name: str) -> None:
    known = case(name)
    for seed in range(4):
        pose, rest = refine(known.part, known.pivot, perturbed(known, seed), CLEARANCE, 1.0)
        distance, turn = known.missed(pose)
        assert (distance < 0.3, turn < 0.6) == (True, True), f"{distance:.2f} mm, {turn:.2f} degrees from {seed}"
        assert rest < SLICE_CELL


def test_walls_stand_off_by_the_clearance() -> None:
    """A part that is thought to touch the walls ends leaning on some of them."""
    known = case("a keyed block")
    ends = [
        [refine(known.part, known.pivot, perturbed(known, seed), c, 1.0) for seed in range(4)] for c in (0, CLEARANCE)
    ]
    touching, clear = (np.mean([known.missed(pose)[0] for pose, _ in each]) for each in ends)
    assert clear < 0.5 * touching
    assert np.mean([rest for _, rest in ends[1]]) < 0.5 * np.mean([rest for _, rest in ends[0]])


# whole answers


@pytest.fixture(scope="module")
def data(mini: Path) -> Dataset:
    return Dataset(mini)


Asked = list[tuple[Query, Truth]]


def asked_of(data: Dataset, split: str, track: str) -> Asked:
    scenes = data.split(split, truth=True)
    return [(query, scene.truth_of(query.id)) for scene in scenes for query in scene.queries if query.track == track]


@pytest.fixture(scope="module")
def snaps(data: Dataset) -> Asked:
    return asked_of(data, "train", "snap")


def missed(data: Dataset, answers: list[Pose], asked: Asked) -> tuple[np.ndarray, np.ndarray]:
    """(n,) [mm] and (n,) [degrees] from the goals that judge."""
    targets = Targets.of([truth for _, truth in asked], lambda part: data.geometry.part(part).mesh.vertices)
    errors = pose_errors(Pose.stack(answers), targets)
    return errors.position * 1e3, np.degrees(errors.rotation)


def answered(method: Registration, asked: Asked) -> list[PredictedMotion]:
    return [method(query, truth if method.uses_true_geometry else None) for query, truth in asked]


def check_home(data: Dataset, asked: Asked) -> None:
    """With true volumes every part comes home."""
    assert asked
    answers = answered(Registration(data, "truth"), asked)
    distance, turn = missed(data, [answer.goal_from_now for answer in answers], asked)
    told = [f"{q.id}: {d:.2f} mm, {t:.2f} degrees" for (q, _), d, t in zip(asked, distance, turn, strict=True)]
    assert (distance < 1.5).all(), told
    assert (turn < 3).all(), told
    assert all(answer.confidence > 0.5 for answer in answers)


def test_with_true_volumes_parts_come_home(data: Dataset, snaps: Asked) -> None:
    check_home(data, snaps)


@pytest.mark.slow
@pytest.mark.parametrize("track", ["snap", "snap-tilt", "place"])
def test_with_true_volumes_all_parts_come_home(data: Dataset, track: str) -> None:
    splits = ("train", "val", "test-all") if track != "place" else ("train",)
    check_home(data, [pair for split in splits for pair in asked_of(data, split, track)])


def check_better_than_the_guess(data: Dataset, asked: Asked) -> None:
    answers = [answer.goal_from_now for answer in answered(Registration(data), asked)]
    guesses = [query.guess for query, _ in asked if query.guess is not None]
    (distance, turn), (before, turn_before) = missed(data, answers, asked), missed(data, guesses, asked)
    assert distance.mean() < 0.5 * before.mean()
    assert turn.mean() < turn_before.mean()


def test_one_image_is_better_than_the_guess(data: Dataset, snaps: Asked) -> None:
    check_better_than_the_guess(data, snaps)


@pytest.mark.slow
def test_one_image_is_better_than_the_guess_on_all_tracks(data: Dataset) -> None:
    tracks = ("snap", "snap-tilt", "snap-d415")
    pairs = [asked_of(data, split, track) for split in ("train", "val", "test-all") for track in tracks]
    check_better_than_the_guess(data, [pair for some in pairs for pair in some])


def settled(data: Dataset, split: str) -> Asked:
    """Queries of a split whose part fits in one turn only: of free turns each answer may name another."""
    return [pair for pair in asked_of(data, split, "snap") if pair[1].slot.free_axis is None]


def test_one_image_conforms(data: Dataset) -> None:
    """But for the law of the moved world: what is unseen may be filled in otherwise on grids that lie otherwise."""
    check_predictor(Registration(data), [query for query, _ in settled(data, "val")], moves=False)


def test_true_volumes_conform_in_a_moved_world_too(data: Dataset) -> None:
    queries, truths = zip(*settled(data, "val"), strict=True)
    check_predictor(Registration(data, "truth"), queries, truths, moved_mm=0.5, moved_deg=3.0)


@pytest.mark.slow
@pytest.mark.parametrize("source", ["depth", "truth"])
def test_all_tracks_conform(data: Dataset, source: str) -> None:
    splits, tracks = ("train", "val", "test-all"), ("snap", "snap-d415", "place")
    asked = [pair for split in splits for track in tracks for pair in asked_of(data, split, track)]
    truths = [truth for _, truth in asked] if source == "truth" else None
    check_predictor(Registration(data, source), [query for query, _ in asked], truths, moves=False)


@pytest.mark.slow
def test_in_a_moved_world_parts_come_home_too(data: Dataset) -> None:
    asked = [pair for split in ("train", "val", "test-all") for pair in asked_of(data, split, "snap")]
    check_home(data, [(moved_query(query, ELSEWHERE), moved_truth(truth, ELSEWHERE)) for query, truth in asked])


def test_true_volumes_want_the_truth(data: Dataset, snaps: Asked) -> None:
    method = Registration(data, "truth")
    assert method.uses_true_geometry
    assert not Registration(data).uses_true_geometry
    with pytest.raises(InputError, match=f"{snaps[0][0].id}: true volumes want the truth"):
        method(snaps[0][0], None)


def test_an_unknown_source_is_refused(data: Dataset) -> None:
    with pytest.raises(InputError, match="source 'guess': expected one of depth, truth"):
        Registration(data, "guess")


def without(query: Query, mask: np.ndarray) -> Query:
    """The query with some pixels of its masks taken away; the image stays."""
    image = LabelledDepth(query.view, np.where(mask, 0, query.image.labels).astype(np.uint8))
    return replace(query, read_image=lambda: image)


def without_depth(query: Query) -> Query:
    """The query with an image that has no return anywhere."""
    view = replace(query.view, depth=np.zeros_like(query.view.depth))
    return replace(query, read_image=lambda: LabelledDepth(view, query.image.labels))


UNSEEN: dict[str, Callable[[Query], Query]] = {
    "no part": lambda query: without(query, query.part_mask),
    "no kits": lambda query: without(query, query.kit_region),
    "no depth": without_depth,
    "a guess far from all": lambda query: replace(query, guess=Pose.from_translation((0.0, 0.0, 3.0))),
}


@pytest.mark.parametrize("what", UNSEEN)
@pytest.mark.parametrize("sensor", ["ideal", "d415"])  # an image that is noisy is smoothed first
def test_where_nothing_is_seen_the_guess_stays_without_confidence(
    what: str, sensor: str, snaps: Asked, data: Dataset
) -> None:
    query = replace(UNSEEN[what](snaps[0][0]), sensor=sensor)
    assert Registration(data)(query) == (query.guess, 0.0)


@pytest.mark.parametrize("what", ["no part", "no kits", "no depth"])
def test_without_a_guess_nothing_seen_is_no_motion(what: str, snaps: Asked, data: Dataset) -> None:
    motion_, confidence = Registration(data)(replace(UNSEEN[what](snaps[0][0]), guess=None))
    assert confidence == 0.0
    np.testing.assert_array_equal(motion_.matrix(), np.eye(4))


@pytest.mark.parametrize("pixels", [1, 5])
def test_a_few_pixels_of_a_part_are_answered_too(pixels: int, snaps: Asked, data: Dataset) -> None:
    query = snaps[0][0]
    v, u = np.nonzero(query.part_mask)
    keep = np.zeros_like(query.part_mask)
    keep[v[len(v) // 2], u[len(u) // 2] : u[len(u) // 2] + pixels] = True
    answer = Registration(data)(without(query, query.part_mask & ~keep))
    assert 0 <= answer.confidence <= 1
