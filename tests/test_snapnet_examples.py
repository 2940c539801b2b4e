"""What the networks see and learn from: frames, residuals and volumes against brute force, metrics and meshes."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from baselines.completion import SeenKits, SeenPart
from baselines.completion.pixels import noise_of
from baselines.snapnet import volumes
from baselines.snapnet.config import Kind, PositionConfig, RotationConfig
from baselines.snapnet.examples import (
    NEAR,
    Guesses,
    PositionExamples,
    RotationExamples,
    Sensor,
    Situation,
    Situations,
    residual_of,
    shown,
    situation,
)
from baselines.snapnet.volumes import Looks, cut_out, grid_about
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.guesses import MAX_OFFSET
from kit1000.metrics import Targets, pose_errors
from kit1000.motions import apply_error, goal_motion
from kit1000.pose import Pose, quaternion_angle
from kit1000.rng import stream
from kit1000.testing import moved_query, moved_truth
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, FreeAxis
from kit1000.voxels import resample, tsdf

VOXEL, CELLS = 2e-3, (40, 44, 48)
POSITION = PositionConfig(VOXEL, (32, 32, 32), CELLS, (8, 8, 8))
ROTATION = RotationConfig(VOXEL, (32, 32, 32), CELLS, "inside", 300, 400, shown=9, jitter=0.0)
ELSEWHERE = Pose.from_rotvec((0, 0, 2.0), (0.4, -0.3, 0.0))
LEVEL = Pose.from_rotvec((0, 0, 0.7))


@pytest.fixture(scope="module")
def data(mini: Path) -> Dataset:
    return Dataset(mini)


def asked(data: Dataset, kind: Kind = "truth", guesses: Guesses = "ball", sensor: Sensor = "ideal") -> Situations:
    return Situations(data, "train", kind, guesses, sensor)


def drawn(data: Dataset, seed: int = 0, kind: Kind = "truth", guesses: Guesses = "ball") -> Situation:
    return asked(data, kind, guesses).draw(stream(seed))


def finished(told: Situation, turn: int | None = None) -> Pose:
    """The motion that a method answers with, were its offset and its turn right."""
    residual, axes = told.residual, Pose(told.world_from_work.wxyz, np.zeros(3))
    rotvec = residual.turns[residual.nearest if turn is None else turn].rotvec()
    return apply_error(told.guess, told.looks.query.pivot, axes.rotate(residual.offset), axes.rotate(rotvec))


def errors_of(told: Situation, motion: Pose) -> tuple[float, float]:
    """[m], [rad] by the metrics."""
    truth = told.looks.truth
    assert truth is not None
    targets = Targets.of([truth], lambda part: told.looks.dataset.geometry.part(part).mesh.vertices)
    errors = pose_errors(Pose.stack([motion]), targets)
    return float(errors.position[0]), float(errors.rotation[0])


# residuals


@pytest.mark.parametrize("guesses", ["ball", "tilt", "place"])
def test_what_a_guess_lacks_takes_it_to_a_goal(data: Dataset, guesses: Guesses) -> None:
    examples = asked(data, guesses=guesses)
    told = [examples.draw(stream(1, k)) for k in range(8)] + [examples.stored(key) for key in examples.keys(9)]
    for each in told:
        assert errors_of(each, finished(each)) == pytest.approx((0, 0), abs=1e-9)
        for turn in range(len(each.residual.turns)):
            assert errors_of(each, finished(each, turn))[1] == pytest.approx(0, abs=1e-9)


def test_errors_fill_the_cube_along_the_working_axes(data: Dataset) -> None:
    examples = asked(data)
    offsets = np.array([examples.draw(stream(2, k)).residual.offset for k in range(200)])
    largest = np.abs(offsets).max(0)
    assert np.all(largest > 0.9 * MAX_OFFSET)
    assert np.all(largest < MAX_OFFSET + 1e-3)  # a goal nearer than the drawn one has its pivot elsewhere


@pytest.mark.parametrize("free", [False, True], ids=["goals", "free axis"])
def test_the_offset_is_that_of_the_goal_nearest_in_rotation(data: Dataset, free: bool) -> None:
    looks = drawn(data).looks
    truth, pivot = looks.truth, looks.query.pivot
    assert truth is not None
    rng = stream(3)
    goals = Pose.from_rotvec(rng.normal(size=(3, 3)), rng.uniform(-0.05, 0.05, (3, 3)))
    direction = np.array([0.6, 0.0, 0.8])
    line = FreeAxis(np.array([0.01, -0.02, 0.03]), direction) if free else None
    truth = replace(truth, slot=replace(truth.slot, goals=goals, free_axis=line))
    guess = Pose.from_rotvec(rng.normal(size=3), rng.uniform(-0.3, 0.3, 3))
    residual = residual_of(truth, pivot, guess, LEVEL)

    angles = np.arange(0, 2 * np.pi, 1e-3) if free else np.zeros(1)
    about = Pose.from_rotvec(angles[:, None] * direction)
    point = np.zeros(3) if line is None else line.point
    turned = Pose(about.wxyz, point - about.rotate(point))[:, None] @ goals
    every = goal_motion(truth.world_from_part, truth.world_from_kit, turned)
    apart = quaternion_angle(every.wxyz, guess.wxyz)
    turn, goal = np.unravel_index(apart.argmin(), apart.shape)
    assert residual.nearest == goal
    assert residual.turns[residual.nearest].angle() == pytest.approx(apart.min(), abs=1e-3)
    lacks = every.apply(pivot)[turn, goal] - guess.apply(pivot)
    np.testing.assert_allclose(LEVEL.rotate(residual.offset), lacks, atol=1e-3)
    assert (residual.axis is not None) == free
    if residual.axis is not None:
        np.testing.assert_allclose(LEVEL.rotate(residual.axis), truth.world_from_kit.rotate(direction), atol=1e-12)


# volumes


def differing(a: np.ndarray, b: np.ndarray) -> float:
    """Share of voxels."""
    return float((np.abs(a - b) > 1e-4).mean())


def laid(told: Situation, offset: np.ndarray) -> Situation:
    """The same query, its first goal missed by an offset (3,) [voxels] along the working axes and by no turn."""
    truth, pivot = told.looks.truth, told.looks.query.pivot
    assert truth is not None
    home = goal_motion(truth.world_from_part, truth.world_from_kit, truth.slot.goals[0])
    return situation(told.looks, apply_error(home, pivot, LEVEL.rotate(offset * VOXEL), np.zeros(3)), LEVEL)


@pytest.mark.parametrize("seed", range(3))
def test_the_part_laid_by_its_offset_fills_the_cavity_and_meets_nothing(data: Dataset, seed: int) -> None:
    shift = np.array([3, -2, 1])
    told = laid(drawn(data, seed), shift)
    part = told.looks.part_volume(told.guess, told.world_from_work, CELLS, VOXEL)
    kit = told.looks.kit_volume(told.world_from_work, CELLS, VOXEL)
    np.testing.assert_allclose(told.residual.offset, -shift * VOXEL, atol=1e-9)

    part = np.roll(part, -shift, (0, 1, 2))  # it is free on all sides of it
    assert not np.any((part < -1e-3) & (kit < -1e-3))
    truth = told.looks.truth
    assert truth is not None
    places = truth.world_from_kit.inverse().apply(grid_about(told.world_from_work, CELLS, VOXEL).centres())
    design = truth.slot.kit_from_part.apply(data.geometry.part(truth.part_id).mesh.vertices)
    below = (places[..., 2] < 0) & (places[..., 2] > -truth.slot.depth)
    inside = below & ((places > design.min(0)) & (places < design.max(0))).all(-1) & (kit > 0)
    assert inside.sum() > 100
    assert (part[inside] < 0).mean() > 0.5
    assert (part[inside] < 0.2 + truth.slot.clearance / (5 * VOXEL)).mean() > 0.7


@pytest.mark.parametrize("seed", range(3))
def test_points_of_the_part_turned_aright_lie_clear_of_the_kits(data: Dataset, seed: int) -> None:
    examples = RotationExamples(asked(data), ROTATION)
    points, told = examples.draw(stream(seed))["part_points"], examples.situations.draw(stream(seed))
    place = told.world_from_work @ Pose.from_translation(told.residual.offset)
    kit = told.looks.kit_volume(place, CELLS, VOXEL)

    def deepest(turn: Pose) -> float:
        index = np.rint(turn.rotate(points) / VOXEL).astype(int) + np.array(CELLS) // 2
        return float(kit[tuple(index.T)].min())

    right = told.residual.turns[told.residual.nearest]
    assert deepest(right) > -0.2  # a voxel
    wrong = Pose.from_rotvec(((0.6, 0, 0), (-0.6, 0, 0), (0, 0.6, 0), (0, -0.6, 0)))
    assert min(deepest(turn @ right) for turn in wrong) < -0.4


@pytest.mark.parametrize("kind", ["truth", "partial"])
def test_a_world_moved_and_turned_looks_the_same_along_axes_turned_with_it(data: Dataset, kind: Kind) -> None:
    told = drawn(data, 5, kind)
    looks = replace(told.looks, kept=None)
    assert looks.truth is not None
    there = replace(looks, query=moved_query(looks.query, ELSEWHERE), truth=moved_truth(looks.truth, ELSEWHERE))
    work, guess = ELSEWHERE @ told.world_from_work, ELSEWHERE @ told.guess @ ELSEWHERE.inverse()
    part = looks.part_volume(told.guess, told.world_from_work, CELLS, VOXEL)
    kit = looks.kit_volume(told.world_from_work, CELLS, VOXEL)
    moved_part = there.part_volume(guess, work, CELLS, VOXEL)
    assert differing(kit, there.kit_volume(work, CELLS, VOXEL)) < 1e-4  # a pixel or a sign may tip over by rounding
    if kind == "truth":
        assert differing(part, moved_part) < 1e-4
    else:  # its own voxels stand along the axes of the world
        assert np.abs(part - moved_part)[part < 1].mean() < 0.1
        assert (part < 0).sum() == pytest.approx((moved_part < 0).sum(), rel=0.03)
    assert part.min() < 0
    assert kit.min() < 0
    pivot = there.query.pivot
    before, after = told.residual, residual_of(there._known, pivot, guess, work)
    np.testing.assert_allclose(after.offset, before.offset, atol=1e-9)
    np.testing.assert_allclose(after.turns.rotvec(), before.turns.rotvec(), atol=1e-9)


@pytest.mark.parametrize("sensor", ["ideal", "d415"])
def test_what_is_cut_out_says_what_the_whole_image_says(data: Dataset, sensor: Sensor) -> None:
    told = asked(data, "partial", sensor=sensor).draw(stream(6))
    query, work = told.looks.query, told.world_from_work
    assert query.sensor == sensor
    grid = grid_about(told.guess.inverse() @ work, CELLS, VOXEL)
    whole = resample(SeenPart(query.image, FIRST_PART_LABEL + query.part, query.pivot).volume(VOXEL), grid, threads=1)
    part = told.looks.part_volume(told.guess, work, CELLS, VOXEL)
    np.testing.assert_allclose(part, whole.filled(1.0), atol=1e-6)
    assert (part < 0).any()

    grid, view, mask = grid_about(work, CELLS, VOXEL), query.view, query.kit_region
    kit = told.looks.kit_volume(work, CELLS, VOXEL)
    assert differing(kit, tsdf(grid, view, mask, threads=1).filled(1)) < 1e-4
    whole = SeenKits(query.image, noise_of(sensor), query.scene_id).volume(work.xyz, VOXEL)
    columns = told.looks.kit_volume(work, CELLS, VOXEL, columns=True)
    assert differing(columns, resample(whole, grid, threads=1).filled(1)) < 1e-2
    assert (columns < 0).sum() > (kit < 0).sum()


@pytest.mark.parametrize("seed", range(3))
def test_what_is_filled_under_an_image_is_nearly_the_kit(data: Dataset, seed: int) -> None:
    told = drawn(data, seed, "partial")
    true = replace(told.looks, kind="truth")
    place = told.world_from_work @ Pose.from_translation(told.residual.offset)
    exact = true.kit_volume(place, (24, 24, 24), VOXEL) < 0
    alone = told.looks.kit_volume(place, (24, 24, 24), VOXEL) < 0
    filled = told.looks.kit_volume(place, (24, 24, 24), VOXEL, columns=True) < 0
    assert (filled == exact).mean() > max(0.85, (alone == exact).mean())


def test_without_the_memory_the_volumes_are_the_same(data: Dataset) -> None:
    for kind in ("truth", "partial"):
        told = drawn(data, 7, kind)
        alone = Looks(told.looks.query, told.looks.truth, kind, data)
        for looks in (told.looks, alone):
            again = looks.part_volume(told.guess, told.world_from_work, CELLS, VOXEL)
            np.testing.assert_array_equal(again, told.looks.part_volume(told.guess, told.world_from_work, CELLS, VOXEL))
        np.testing.assert_array_equal(
            alone.kit_volume(told.world_from_work, CELLS, VOXEL),
            told.looks.kit_volume(told.world_from_work, CELLS, VOXEL),
        )


def test_an_answer_reads_the_image_of_its_query_once(data: Dataset) -> None:
    query, read = drawn(data, 7, "partial").looks.query, []
    looks = Looks(replace(query, read_image=lambda: read.append(1) or query.read_image()), None, "partial", data)
    looks.part_volume(Pose.identity(), LEVEL, CELLS, VOXEL)
    looks.kit_volume(LEVEL, CELLS, VOXEL)
    assert (looks.query.image.labels.any(), len(read)) == (True, 1)


def test_a_part_that_is_not_seen_leaves_a_volume_of_nothing(data: Dataset) -> None:
    looks = replace(drawn(data, 0, "partial").looks, query=replace(drawn(data).looks.query, part=200))
    assert np.all(looks.part_volume(Pose.identity(), LEVEL, CELLS, VOXEL) == 1)


def test_without_a_guess_the_pivot_goes_to_the_middle_of_the_kits(data: Dataset) -> None:
    examples = asked(data, guesses="place")
    told = examples.stored(examples.keys(1)[0])
    query = told.looks.query
    assert query.guess is None
    view, mask = query.view, query.kit_region & (query.view.depth > 0)
    v, u = np.nonzero(mask)
    points = view.world_from_camera.apply(view.camera.unproject_pixels(np.stack([u, v], -1), view.depth[mask]))
    np.testing.assert_allclose(told.world_from_work.xyz, (points.min(0) + points.max(0)) / 2, atol=1e-9)
    assert told.guess.angle() == 0
    nothing = replace(query.image, labels=np.zeros_like(query.image.labels))
    with pytest.raises(InputError, match="nothing of the kits"):
        Looks(replace(query, read_image=lambda: nothing), None, "partial", data).start()


# examples


def position(data: Dataset, kind: Kind) -> PositionExamples:
    return PositionExamples(asked(data, kind), POSITION)


def rotation(data: Dataset, kind: Kind) -> RotationExamples:
    return RotationExamples(asked(data, kind), replace(ROTATION, jitter=2e-3))


@pytest.mark.parametrize("kind", ["truth", "partial"])
@pytest.mark.parametrize("made", [position, rotation])
def test_the_same_generator_gives_the_same_bytes(data: Dataset, made: Callable, kind: Kind) -> None:
    examples = made(data, kind)
    first = examples.draw(stream(1))
    examples.draw(stream(2))
    sent = pickle.loads(pickle.dumps(examples))
    for other in (examples, sent):
        again = other.draw(stream(1))
        assert {name: array.tobytes() for name, array in again.items()} == {
            name: array.tobytes() for name, array in first.items()
        }
    assert all(isinstance(array, np.ndarray) and array.flags.writeable for array in first.values())
    assert len(pickle.dumps(examples)) < 1e5
    assert examples.check(examples.keys(1)[0]).keys() == first.keys()


def test_position_examples_have_the_sizes_of_their_config_and_flag_what_is_outside(data: Dataset) -> None:
    examples = PositionExamples(asked(data), replace(POSITION, window=(10, 8, 6)))
    for seed in range(6):
        example = examples.draw(stream(seed))
        assert example["part"].shape == POSITION.part_cells
        assert example["kit"].shape == CELLS
        steps = np.rint(example["offset"] / (2 * VOXEL)) + (5, 4, 3)
        assert bool(example["inside"]) == bool(np.all((steps >= 0) & (steps < (10, 8, 6))))


def test_the_right_candidate_is_the_nearest_to_any_right_turn(data: Dataset) -> None:
    examples = RotationExamples(Situations(data, "val", "truth"), ROTATION)
    key = examples.keys(1)[0]
    every, some = examples.check(key, every=True), examples.check(key)
    assert len(every["turns"]) == len(examples.candidates)
    assert some["turns"].shape == (9, 4)
    for example in (every, some):
        assert example["distances"].argmin() == example["nearest"]
    np.testing.assert_array_equal(some["turns"][some["nearest"]], every["turns"][every["nearest"]])
    residual = examples.situations.stored(key).residual
    if residual.axis is None:
        apart = quaternion_angle(every["turns"][:, None], residual.turns.wxyz).min(1)
        np.testing.assert_allclose(every["distances"], apart, atol=1e-6)


def test_the_right_candidate_is_shown_once_among_others_at_any_place() -> None:
    places, distances = set(), np.roll(np.arange(20.0), 4)
    for seed in range(60):
        chosen = shown(stream(seed), distances, most=6)
        assert len(set(chosen.tolist())) == 6
        places.update(np.flatnonzero(chosen == 4).tolist())
    assert places == set(range(6))
    assert sorted(shown(stream(1), np.arange(5.0), 9, 0.5).tolist()) == list(range(5))


def test_hard_candidates_are_shown_more_often() -> None:
    distances = stream(0).permutation(391).astype(float)
    share = [np.mean(distances[shown(stream(seed), distances, 25, hard)] <= NEAR) for seed, hard in ((1, 0), (2, 1))]
    assert share[0] < 0.5
    assert share[1] == 1


def test_keys_are_those_of_drawn_queries_spread_evenly(data: Dataset) -> None:
    examples = asked(data)
    every = [query.id for query in data.split("train").queries("snap") if query.drawn]
    assert examples.keys(100) == every
    assert examples.keys(1) == every[:1]
    told = examples.stored(every[-1])
    assert told.guess is told.looks.query.guess
    assert told.world_from_work.angle() == 0


def test_no_more_is_kept_of_images_than_allowed(data: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(volumes, "SCENES", 1)
    monkeypatch.setattr(volumes, "PARTS", 2)
    examples = asked(data, "partial")
    for seed in range(6):
        told = examples.draw(stream(seed))
        told.looks.kit_volume(told.world_from_work, (4, 4, 4), VOXEL)
        told.looks.part_volume(told.guess, told.world_from_work, (4, 4, 4), VOXEL)
        assert len(examples._kept._seen) == 1
        assert 1 <= len(examples._kept._parts) <= 2
        assert "seen" not in vars(told.looks.query)


def test_cut_images_hold_every_masked_depth(data: Dataset) -> None:
    query = drawn(data).looks.query
    look = query.read_image()
    seen = cut_out(look, query)
    assert {FIRST_PART_LABEL + part for part in seen.parts} == set(np.unique(look.labels).tolist()) - {
        0,
        ASSEMBLY_LABEL,
    }
    assert seen.kits is not None
    windows = {FIRST_PART_LABEL + part: window for part, window in seen.parts.items()} | {
        ASSEMBLY_LABEL: seen.kits.look
    }
    for label, window in windows.items():
        depth = window.view.depth[window.labels == label]
        np.testing.assert_array_equal(depth, look.view.depth[look.labels == label])


def test_what_cannot_be_is_refused(data: Dataset) -> None:
    query = drawn(data).looks.query
    with pytest.raises(InputError, match="want the truth"):
        Looks(query, None, "truth", data)
    with pytest.raises(InputError, match="there are ball, tilt, place"):
        asked(data, guesses="bowl")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="no track snap-tilt-d415"):
        asked(data, guesses="tilt", sensor="d415")
    with pytest.raises(InputError, match="not made for them"):
        RotationExamples(asked(data, guesses="place"), ROTATION)
    with pytest.raises(InputError, match="no query"):
        asked(data).stored("train-s0000-p9-snap")
    with pytest.raises(InputError, match="train"):
        asked(data).stored("nothing")
