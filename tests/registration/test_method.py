"""Registration from query to prediction: its errors, its conformance, and what it does when nothing is observed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest

from baselines.catalog import method_of
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.mesh import Mesh
from kit1000.metrics import Targets, pose_errors, seatings
from kit1000.perception.image_kinds import D415, IDEAL, PHOTONEO
from kit1000.perception.sensor_facts import simulated_sensor
from kit1000.pose import Pose
from kit1000.prediction.making import make_predictor
from kit1000.predictor import PredictedMotion
from kit1000.registration.geometry.cavity import VOXEL, Cavity, find_cavity, plate_grid
from kit1000.registration.kit_volume import DEEPER, LEAST_REGION, TRUE_NOISE, WIDER, TrueKits, find_cavities
from kit1000.registration.predictor import Registration
from kit1000.registration.prepared_image import Networks
from kit1000.registration.rank import difference
from kit1000.registration.search import LEAST_SIDE
from kit1000.rng import stream
from kit1000.sim.sensors import SENSORS, sense
from kit1000.testing import check_predictor
from kit1000.values import LabelledDepth, Query, TrueGeometry, Truth
from kit1000.voxels import Grid, Volume


@pytest.fixture(scope="module")
def data(mini: Path) -> Dataset:
    return Dataset(mini)


BESIDE = Pose.from_translation((0.5, 0.0, 0.0))
QueryTruths = list[tuple[Query, Truth]]


def queries_of(data: Dataset, split: str, track: str) -> QueryTruths:
    scenes = data.split(split, truth=True)
    return [(query, scene.truth_of(query.id)) for scene in scenes for query in scene.queries if query.track == track]


@pytest.fixture(scope="module")
def snaps(data: Dataset) -> QueryTruths:
    return queries_of(data, "train", "snap")


def errors_of(data: Dataset, motions: list[Pose], queries: QueryTruths) -> tuple[np.ndarray, np.ndarray]:
    """(n,) [mm] and (n,) [degrees] from the nearest goals."""
    targets = Targets.of([truth for _, truth in queries], lambda part: data.geometry.part(part).mesh.vertices)
    errors = pose_errors(Pose.stack(motions), targets)
    return errors.position * 1e3, np.degrees(errors.rotation)


def predicted(data: Dataset, method: Registration, queries: QueryTruths) -> list[PredictedMotion]:
    true = method.uses_true_geometry
    return [method(query, data.geometry.true_geometry(truth) if true else None) for query, truth in queries]


def check_exact(data: Dataset, queries: QueryTruths, most_deg: float = 3) -> None:
    """With true volumes every part reaches its goal, and is seated."""
    assert queries
    motions = predicted(data, Registration(data, "truth"), queries)
    goals = [motion.goal_from_now for motion in motions]
    distance, angle = errors_of(data, goals, queries)
    errors = [f"{q.id}: {d:.2f} mm, {t:.2f} degrees" for (q, _), d, t in zip(queries, distance, angle, strict=True)]
    assert (distance < 1.5).all(), errors
    assert (angle < most_deg).all(), errors
    assert seatings(Pose.stack(goals), [truth for _, truth in queries], data.geometry).seated.all(), errors
    assert all(motion.confidence > 0.5 for motion in motions)


def test_with_true_volumes_parts_reach_their_goals(data: Dataset, snaps: QueryTruths) -> None:
    check_exact(data, snaps)


@pytest.mark.slow
@pytest.mark.parametrize("track", ["snap", "snap-tilt", "place"])
def test_with_true_volumes_all_parts_reach_their_goals(data: Dataset, track: str) -> None:
    splits = ("train", "val", "test-all") if track != "place" else ("train",)
    oblique = 5 if track == "snap-tilt" else 3  # to the floor: the face that the search takes for the lowest
    check_exact(data, [pair for split in splits for pair in queries_of(data, split, track)], oblique)


def check_better_than_the_guess(data: Dataset, queries: QueryTruths) -> None:
    motions = [motion.goal_from_now for motion in predicted(data, Registration(data), queries)]
    guesses = [query.guess for query, _ in queries if query.guess is not None]
    (distance, angle), (distance_before, angle_before) = (errors_of(data, some, queries) for some in (motions, guesses))
    assert distance.mean() < 0.5 * distance_before.mean()
    assert angle.mean() < angle_before.mean()


def test_one_image_is_better_than_the_guess(data: Dataset, snaps: QueryTruths) -> None:
    check_better_than_the_guess(data, snaps)


@pytest.mark.slow
def test_one_image_is_better_than_the_guess_on_all_tracks(data: Dataset) -> None:
    tracks = ("snap", "snap-tilt", "snap-d415")
    pairs = [queries_of(data, split, track) for split in ("train", "val", "test-all") for track in tracks]
    check_better_than_the_guess(data, [pair for some in pairs for pair in some])


def without_free_axis(data: Dataset, split: str) -> QueryTruths:
    """Snap queries of a split whose slot has no free axis: about one, any rotation is as good."""
    return [pair for pair in queries_of(data, split, "snap") if pair[1].slot.free_axis is None]


def geometries_of(data: Dataset, queries: QueryTruths) -> list[TrueGeometry]:
    return [data.geometry.true_geometry(truth) for _, truth in queries]


def test_one_image_conforms(data: Dataset) -> None:
    """Except in the moved world: completion depends on the axes of its grid."""
    check_predictor(Registration(data), [query for query, _ in without_free_axis(data, "val")], moves=False)


def test_true_volumes_conform_in_a_moved_world_too(data: Dataset) -> None:
    pairs = without_free_axis(data, "val")
    queries, geometries = [query for query, _ in pairs], geometries_of(data, pairs)
    check_predictor(Registration(data, "truth"), queries, geometries, moved_mm=0.5, moved_deg=3.0)


@pytest.mark.slow
@pytest.mark.parametrize("source", ["depth", "truth"])
def test_all_tracks_conform(data: Dataset, source: str) -> None:
    splits, tracks = ("train", "val", "test-all"), ("snap", "snap-d415", "place")
    pairs = [pair for split in splits for track in tracks for pair in queries_of(data, split, track)]
    geometries = geometries_of(data, pairs) if source == "truth" else None
    check_predictor(Registration(data, source), [query for query, _ in pairs], geometries, moves=False)


def test_true_volumes_need_the_true_geometry(data: Dataset, snaps: QueryTruths) -> None:
    method = Registration(data, "truth")
    assert method.uses_true_geometry
    assert not Registration(data).uses_true_geometry
    with pytest.raises(InputError, match=f"{snaps[0][0].id}: registration from true volumes needs the true geometry"):
        method(snaps[0][0], None)


def test_noisy_images_are_completed_by_a_network_of_their_own(data: Dataset) -> None:
    method = make_predictor(method_of("registration-completed"), data, 0)
    assert isinstance(method, Registration)
    exact, scanned, noisy = (method.networks(kind) for kind in (IDEAL, PHOTONEO, D415))
    assert exact.completer is scanned.completer is not None
    assert None is not noisy.completer is not exact.completer
    assert method.networks(D415).completer is noisy.completer  # loaded once
    assert [networks.restorer is None for networks in (exact, scanned, noisy)] == [True, True, False]
    assert [networks.filler is None for networks in (exact, scanned, noisy)] == [True, False, True]
    assert [networks.placer is None for networks in (exact, scanned, noisy)] == [True, True, False]
    of_both = Registration(data, completion=method.completion)
    assert of_both.networks(D415).completer is of_both.networks(IDEAL).completer is not None
    assert Registration(data).networks(D415) == Networks()


def test_a_new_sensor_is_one_value(data: Dataset, snaps: QueryTruths, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(SENSORS, "zed", replace(SENSORS["d415"], baseline=0.12, amplitude_px=(0.05, 0.15)))
    query, _ = snaps[0]
    view = sense("zed", query.view, stream(0, "zed"))
    image = LabelledDepth(view, query.image.labels)
    predicted = Registration(data)(replace(query, sensor="zed", read_image=lambda: image))
    assert predicted.confidence > 0
    assert simulated_sensor("zed").kind is D415


def test_an_unknown_source_is_refused(data: Dataset) -> None:
    with pytest.raises(InputError, match="source 'guess': expected one of depth, columns, truth"):
        Registration(data, "guess")


def without(query: Query, mask: np.ndarray) -> Query:
    """The query with some pixels removed from its masks; the depth image is unchanged."""
    image = LabelledDepth(query.view, np.where(mask, 0, query.image.labels).astype(np.uint8))
    return replace(query, read_image=lambda: image)


def without_depth(query: Query) -> Query:
    """The query with an image that has no return anywhere."""
    view = replace(query.view, depth=np.zeros_like(query.view.depth))
    return replace(query, read_image=lambda: LabelledDepth(view, query.image.labels))


NOTHING_OBSERVED: dict[str, Callable[[Query], Query]] = {
    "no part": lambda query: without(query, query.part_mask),
    "no kits": lambda query: without(query, query.kit_region),
    "no depth": without_depth,
    "a guess far away": lambda query: replace(query, guess=Pose.from_translation((0.0, 0.0, 3.0))),
}


@pytest.mark.parametrize("what", NOTHING_OBSERVED)
@pytest.mark.parametrize("sensor", ["ideal", "d415"])  # a noisy image is restored first
def test_where_nothing_is_observed_the_guess_stays_with_confidence_0(
    what: str, sensor: str, snaps: QueryTruths, data: Dataset
) -> None:
    query = replace(NOTHING_OBSERVED[what](snaps[0][0]), sensor=sensor)
    assert Registration(data)(query) == (query.guess, 0.0)


@pytest.mark.parametrize("source", ["columns", "truth"])
def test_where_no_plate_is_near_the_guess_it_stays(source: str, snaps: QueryTruths, data: Dataset) -> None:
    known, truth = snaps[0]
    query = NOTHING_OBSERVED["a guess far away"](known)
    assert Registration(data, source)(query, data.geometry.true_geometry(truth)) == (query.guess, 0.0)


def test_a_cavity_that_the_border_cuts_is_found_in_a_wider_relief(snaps: QueryTruths, data: Dataset) -> None:
    known, truth = snaps[0]
    query = replace(known, guess=truth.goal_drawn)
    source = TrueKits(data.geometry.true_geometry(truth))
    whole = min(find_cavities(source, query, LEAST_SIDE), key=lambda cavity: cavity.depth)
    cells = np.argwhere(whole.region) - (len(whole.region) - 1) / 2
    cut = 1.8 * VOXEL * float(np.abs(cells).max())  # nine tenths of what holds it
    found = min(find_cavities(source, query, cut), key=lambda cavity: cavity.depth)
    assert len(found.region) == round(WIDER * cut / VOXEL)
    assert found.depth == pytest.approx(whole.depth, abs=0.1e-3)
    assert found.region.sum() == pytest.approx(whole.region.sum(), rel=0.01)


@dataclass(frozen=True, eq=False)
class FurrowedKits(TrueKits):
    """Kits with a furrow from the origin of a plate outwards, 2.2 mm deep and 6 mm wide, as noise may bend a rim."""

    world_from_plate: Pose = field(default_factory=Pose.identity)
    width: float = 6e-3
    depth: float = 2.2e-3

    def volume(self, grid: Grid) -> Volume:
        """The kits, exact but for the furrow."""
        volume = super().volume(grid)
        x, y, z = np.moveaxis(self.world_from_plate.inverse().apply(grid.centres()), -1, 0)
        furrow = (np.abs(x) < self.width / 2) & (y > 0) & (z > -self.depth)
        return Volume(grid, np.where(furrow, np.maximum(volume.values, np.float32(0.2)), volume.values))


def test_a_cavity_that_runs_out_over_its_rim_is_found_by_a_deeper_cut(snaps: QueryTruths, data: Dataset) -> None:
    known, truth = snaps[0]
    query = replace(known, guess=truth.goal_drawn)
    geometry = data.geometry.true_geometry(truth)
    whole = min(find_cavities(TrueKits(geometry), query, LEAST_SIDE), key=lambda cavity: cavity.depth)
    source = FurrowedKits(geometry, world_from_plate=whole.world_from_plate)
    frame, noise = whole.world_from_plate, source.noise
    furrowed = source.volume(plate_grid(frame, WIDER * LEAST_SIDE))
    assert find_cavity(furrowed, frame, noise) is None
    found = min(find_cavities(source, query, LEAST_SIDE), key=lambda cavity: cavity.depth)
    assert found.depth == pytest.approx(whole.depth, abs=0.1e-3)
    assert found.region.sum() == pytest.approx(whole.region.sum(), rel=0.1)


@pytest.fixture(scope="module")
def twin_plates(snaps: QueryTruths, data: Dataset) -> tuple[Query, TrueGeometry]:
    """A query without a guess, and its scene with a second assembly half a metre from the first."""
    known, truth = snaps[0]
    geometry = data.geometry.true_geometry(truth)
    first = geometry.assembly
    second = first.moved(geometry.world_from_assembly.inverse() @ BESIDE @ geometry.world_from_assembly)
    faces = np.concatenate([first.faces, second.faces + len(first.vertices)])
    both = Mesh(np.concatenate([first.vertices, second.vertices]), faces)
    return replace(known, guess=None), replace(geometry, assembly=both)


@pytest.mark.parametrize("wavy", [False, True])
def test_where_rims_may_be_wavy_each_plate_is_cut_deeper_by_itself(
    wavy: bool, twin_plates: tuple[Query, TrueGeometry]
) -> None:
    query, geometry = twin_plates
    whole = [cavity for cavity in find_cavities(TrueKits(geometry), query, LEAST_SIDE) if is_large(cavity)]
    assert len(whole) == 2
    frame = whole[0].world_from_plate
    source = FurrowedKits(geometry, TRUE_NOISE._replace(wavy_rims=wavy), frame)
    found = [cavity for cavity in find_cavities(source, query, LEAST_SIDE) if is_large(cavity)]
    assert len(found) == 1 + wavy
    for cavity in found:
        assert cavity.region.sum() == pytest.approx(whole[0].region.sum(), rel=0.1)


@dataclass(frozen=True, eq=False)
class PittedKits(TrueKits):
    """Kits of which one plate has a pit of 8 mm x 8 mm in place of its cavity."""

    world_from_plate: Pose = field(default_factory=Pose.identity)

    def volume(self, grid: Grid) -> Volume:
        """The kits, exact but for that plate."""
        volume = super().volume(grid)
        x, y, z = np.moveaxis(self.world_from_plate.inverse().apply(grid.centres()), -1, 0)
        wide = np.maximum(np.abs(x), np.abs(y))
        filled = np.where((wide < 40e-3) & (np.abs(z) < 20e-3), z / (5 * grid.voxel_size), volume.values)
        pitted = np.where((wide < 4e-3) & (z > -5e-3), np.maximum(filled, 0.2), filled)
        return Volume(grid, np.clip(pitted, -1, 1).astype(np.float32))


@pytest.mark.parametrize("wavy", [False, True])
def test_where_rims_may_be_wavy_small_holes_are_left_out_beside_a_cavity(
    wavy: bool, twin_plates: tuple[Query, TrueGeometry]
) -> None:
    query, geometry = twin_plates
    plates = [cavity.world_from_plate for cavity in find_cavities(TrueKits(geometry), query, LEAST_SIDE)]
    found = find_cavities(PittedKits(geometry, TRUE_NOISE._replace(wavy_rims=wavy), plates[0]), query, LEAST_SIDE)
    assert [is_large(cavity) for cavity in found].count(True) == 1
    assert [is_large(cavity) for cavity in found].count(False) == (not wavy)


def is_large(cavity: Cavity) -> bool:
    return cavity.region.sum() * VOXEL**2 > LEAST_REGION


def test_cracks_are_closed_in_deeper_cuts(snaps: QueryTruths, data: Dataset) -> None:
    known, truth = snaps[0]
    query, geometry = replace(known, guess=truth.goal_drawn), data.geometry.true_geometry(truth)
    whole = min(find_cavities(TrueKits(geometry), query, LEAST_SIDE), key=lambda cavity: cavity.depth)
    source = FurrowedKits(geometry, world_from_plate=whole.world_from_plate, width=2.2e-3, depth=6e-3)
    plate = source.volume(plate_grid(whole.world_from_plate, LEAST_SIDE))
    assert find_cavity(plate, whole.world_from_plate, source.noise) is None
    found = find_cavity(plate, whole.world_from_plate, source.noise, DEEPER[0])
    assert found is not None
    assert found.region.sum() == pytest.approx(whole.region.sum(), rel=0.1)


@pytest.mark.parametrize("what", ["no part", "no kits", "no depth"])
def test_without_a_guess_nothing_observed_is_no_motion(what: str, snaps: QueryTruths, data: Dataset) -> None:
    motion, confidence = Registration(data)(replace(NOTHING_OBSERVED[what](snaps[0][0]), guess=None))
    assert confidence == 0.0
    np.testing.assert_array_equal(motion.matrix(), np.eye(4))


@pytest.mark.parametrize("pixels", [1, 5])
def test_a_few_pixels_of_a_part_are_enough_for_a_prediction(pixels: int, snaps: QueryTruths, data: Dataset) -> None:
    query = snaps[0][0]
    v, u = np.nonzero(query.part_mask)
    keep = np.zeros_like(query.part_mask)
    keep[v[len(v) // 2], u[len(u) // 2] : u[len(u) // 2] + pixels] = True
    predicted = Registration(data)(without(query, query.part_mask & ~keep))
    assert 0 <= predicted.confidence <= 1


def check_same(one: PredictedMotion, other: PredictedMotion) -> None:
    """Two predictions are equal to the last digit."""
    np.testing.assert_array_equal(one.goal_from_now.matrix(), other.goal_from_now.matrix())
    assert one.confidence == other.confidence


def test_an_image_seen_twice_answers_as_once(data: Dataset, snaps: QueryTruths) -> None:
    query, _ = snaps[0]
    method = Registration(data)
    alone, twice = method(query), method.together([query, query])
    assert difference(alone.goal_from_now, twice.goal_from_now, query.pivot) < 1e-9
    check_same(method.together([query]), alone)
    assert twice.confidence > alone.confidence


def test_a_scene_seen_from_two_places_is_answered_by_both(
    data: Dataset, snaps: QueryTruths, monkeypatch: pytest.MonkeyPatch
) -> None:
    query, _ = snaps[0]
    method, other = Registration(data), replace(query)
    expected = method.together([query, other])
    monkeypatch.setattr("kit1000.registration.predictor.from_elsewhere", lambda *_: [other])
    check_same(method(query), expected)
