"""Inputs and targets of the networks: frames, residuals and volumes against brute force, metrics and meshes."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from baselines.catalog import all_methods, all_networks, weight_paths
from baselines.snapnet import query_volumes as volumes_module
from baselines.snapnet.candidate_rotations import candidates
from baselines.snapnet.config import PositionConfig, RotationConfig, Source
from baselines.snapnet.examples import QuerySample, QuerySampler, query_sample, residual_of
from baselines.snapnet.query_volumes import QueryVolumes, grid_about
from baselines.snapnet.task import HARD, PositionTask, RotationTask, training_candidates
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.metrics import Targets, pose_errors
from kit1000.perception.completion.kits import KitCompleter
from kit1000.perception.observed.kits import ObservedKits
from kit1000.perception.observed.parts import ObservedPart
from kit1000.perception.restoration import restored_query
from kit1000.perception.sensor_facts import simulated_sensor
from kit1000.pose import Pose, quaternion_angle
from kit1000.queries.guesses import MAX_OFFSET
from kit1000.queries.motions import apply_error, goal_motion
from kit1000.rng import stream
from kit1000.testing import moved_geometry, moved_query, moved_truth
from kit1000.values import FIRST_PART_LABEL, FreeAxis, Query
from kit1000.voxels import resample, tsdf
from kit1000.weights import WEIGHTS

VOXEL, CELLS = 2e-3, (40, 44, 48)
POSITION = PositionConfig(VOXEL, (32, 32, 32), CELLS, (8, 8, 8))
ROTATION = RotationConfig(VOXEL, (32, 32, 32), CELLS, "inside", 300, 400, training_candidates=9, jitter=0.0)
WORLD_MOTION = Pose.from_rotvec((0, 0, 2.0), (0.4, -0.3, 0.0))
YAWED = Pose.from_rotvec((0, 0, 0.7))
NO_NETWORK: Any = None


def sampler(data: Dataset, source: Source = "truth") -> QuerySampler:
    return QuerySampler(data, "train", source)


def position_task(queries: QuerySampler, config: PositionConfig = POSITION) -> PositionTask:
    """Examples alone, without a network."""
    return PositionTask(queries, queries, config, NO_NETWORK)


def rotation_task(queries: QuerySampler, config: RotationConfig = ROTATION) -> RotationTask:
    return RotationTask(queries, queries, config, NO_NETWORK)


def drawn(data: Dataset, seed: int = 0, source: Source = "truth") -> QuerySample:
    return sampler(data, source).draw(stream(seed))


def corrected(sample: QuerySample, goal: int | None = None) -> Pose:
    """The motion that a method predicts with the correct offset and rotation."""
    residual, axes = sample.residual, Pose(sample.world_from_work.wxyz, np.zeros(3))
    rotvec = residual.rotations[residual.nearest if goal is None else goal].rotvec()
    return apply_error(sample.guess, sample.volumes.query.pivot, axes.rotate(residual.offset), axes.rotate(rotvec))


def errors_of(data: Dataset, sample: QuerySample, motion: Pose) -> tuple[float, float]:
    """[m], [rad] by the metrics."""
    truth = data.truth_of(sample.volumes.query)
    targets = Targets.of([truth], lambda part: data.geometry.part(part).mesh.vertices)
    errors = pose_errors(Pose.stack([motion]), targets)
    return float(errors.position[0]), float(errors.rotation[0])


# residuals


def test_the_residual_takes_a_guess_to_a_goal(data: Dataset) -> None:
    examples = sampler(data)
    samples = [examples.draw(stream(1, k)) for k in range(8)] + [examples.stored(key) for key in examples.keys(9)]
    for sample in samples:
        assert errors_of(data, sample, corrected(sample)) == pytest.approx((0, 0), abs=1e-9)
        for goal in range(len(sample.residual.rotations)):
            assert errors_of(data, sample, corrected(sample, goal))[1] == pytest.approx(0, abs=1e-9)


def test_errors_fill_the_cube_along_the_working_axes(data: Dataset) -> None:
    examples = sampler(data)
    offsets = np.array([examples.draw(stream(2, k)).residual.offset for k in range(200)])
    largest = np.abs(offsets).max(0)
    assert np.all(largest > 0.9 * MAX_OFFSET)
    assert np.all(largest < MAX_OFFSET + 1e-3)  # at a goal nearer than the drawn one the pivot is elsewhere


@pytest.mark.parametrize("free", [False, True], ids=["goals", "free axis"])
def test_the_offset_is_that_of_the_goal_nearest_in_rotation(data: Dataset, free: bool) -> None:
    query = drawn(data).volumes.query
    truth, pivot = data.truth_of(query), query.pivot
    rng = stream(3)
    goals = Pose.from_rotvec(rng.normal(size=(3, 3)), rng.uniform(-0.05, 0.05, (3, 3)))
    direction = np.array([0.6, 0.0, 0.8])
    line = FreeAxis(np.array([0.01, -0.02, 0.03]), direction) if free else None
    truth = replace(truth, slot=replace(truth.slot, goals=goals, free_axis=line))
    guess = Pose.from_rotvec(rng.normal(size=3), rng.uniform(-0.3, 0.3, 3))
    residual = residual_of(truth, pivot, guess, YAWED)

    angles = np.arange(0, 2 * np.pi, 1e-3) if free else np.zeros(1)
    about = Pose.from_rotvec(angles[:, None] * direction)
    point = np.zeros(3) if line is None else line.point
    rotated = Pose(about.wxyz, point - about.rotate(point))[:, None] @ goals
    every = goal_motion(truth.world_from_part, truth.world_from_kit, rotated)
    angle = quaternion_angle(every.wxyz, guess.wxyz)
    nearest, goal = np.unravel_index(angle.argmin(), angle.shape)
    assert residual.nearest == goal
    assert residual.rotations[residual.nearest].angle() == pytest.approx(angle.min(), abs=1e-3)
    offset = every.apply(pivot)[nearest, goal] - guess.apply(pivot)
    np.testing.assert_allclose(YAWED.rotate(residual.offset), offset, atol=1e-3)
    assert (residual.axis is not None) == free
    if residual.axis is not None:
        np.testing.assert_allclose(YAWED.rotate(residual.axis), truth.world_from_kit.rotate(direction), atol=1e-12)


# volumes


def differing(a: np.ndarray, b: np.ndarray) -> float:
    """Share of voxels."""
    return float((np.abs(a - b) > 1e-4).mean())


def missed_by(data: Dataset, sample: QuerySample, offset: np.ndarray) -> QuerySample:
    """The same query, its first goal missed by an offset (3,) [voxels] along the working axes and by no rotation."""
    truth, pivot = data.truth_of(sample.volumes.query), sample.volumes.query.pivot
    goal = goal_motion(truth.world_from_part, truth.world_from_kit, truth.slot.goals[0])
    guess = apply_error(goal, pivot, YAWED.rotate(offset * VOXEL), np.zeros(3))
    return query_sample(sample.volumes, truth, guess, YAWED)


@pytest.mark.parametrize("seed", range(3))
def test_the_part_moved_by_its_offset_fills_the_cavity_without_overlap(data: Dataset, seed: int) -> None:
    shift = np.array([3, -2, 1])
    sample = missed_by(data, drawn(data, seed), shift)
    part = sample.volumes.part_volume(sample.guess, sample.world_from_work, CELLS, VOXEL)
    kit = sample.volumes.kit_volume(sample.world_from_work, CELLS, VOXEL)
    np.testing.assert_allclose(sample.residual.offset, -shift * VOXEL, atol=1e-9)

    part = np.roll(part, -shift, (0, 1, 2))  # the border of the volume is free
    assert not np.any((part < -1e-3) & (kit < -1e-3))
    truth = data.truth_of(sample.volumes.query)
    points_in_kit = truth.world_from_kit.inverse().apply(grid_about(sample.world_from_work, CELLS, VOXEL).centres())
    design = truth.slot.kit_from_part.apply(data.geometry.part(truth.part_id).mesh.vertices)
    below = (points_in_kit[..., 2] < 0) & (points_in_kit[..., 2] > -truth.slot.depth)
    inside = below & ((points_in_kit > design.min(0)) & (points_in_kit < design.max(0))).all(-1) & (kit > 0)
    assert inside.sum() > 100
    assert (part[inside] < 0).mean() > 0.5
    assert (part[inside] < 0.2 + truth.slot.clearance / (5 * VOXEL)).mean() > 0.7


@pytest.mark.parametrize("seed", range(3))
def test_points_of_the_correctly_rotated_part_lie_clear_of_the_kits(data: Dataset, seed: int) -> None:
    points, sample = rotation_task(sampler(data)).example(stream(seed))["part_points"], drawn(data, seed)
    work = sample.world_from_work @ Pose.from_translation(sample.residual.offset)
    kit = sample.volumes.kit_volume(work, CELLS, VOXEL)

    def deepest(rotation: Pose) -> float:
        index = np.rint(rotation.rotate(points) / VOXEL).astype(int) + np.array(CELLS) // 2
        return float(kit[tuple(index.T)].min())

    correct = sample.residual.rotations[sample.residual.nearest]
    assert deepest(correct) > -0.2  # a voxel
    wrong = Pose.from_rotvec(((0.6, 0, 0), (-0.6, 0, 0), (0, 0.6, 0), (0, -0.6, 0)))
    assert min(deepest(error @ correct) for error in wrong) < -0.4


@pytest.mark.parametrize("source", ["truth", "depth"])
def test_volumes_are_the_same_in_a_moved_world_along_moved_axes(data: Dataset, source: Source) -> None:
    sample = drawn(data, 5, source)
    here, truth = replace(sample.volumes, cache=None), data.truth_of(sample.volumes.query)
    geometry = here.geometry and moved_geometry(here.geometry, WORLD_MOTION)
    there = replace(here, query=moved_query(here.query, WORLD_MOTION), geometry=geometry)
    work, guess = WORLD_MOTION @ sample.world_from_work, WORLD_MOTION @ sample.guess @ WORLD_MOTION.inverse()
    part = here.part_volume(sample.guess, sample.world_from_work, CELLS, VOXEL)
    kit = here.kit_volume(sample.world_from_work, CELLS, VOXEL)
    moved_part = there.part_volume(guess, work, CELLS, VOXEL)
    assert differing(kit, there.kit_volume(work, CELLS, VOXEL)) < 1e-4  # a pixel or a sign may tip over by rounding
    if source == "truth":
        assert differing(part, moved_part) < 1e-4
    else:  # its own voxels are along the axes of the world
        assert np.abs(part - moved_part)[part < 1].mean() < 0.1
        assert (part < 0).sum() == pytest.approx((moved_part < 0).sum(), rel=0.03)
    assert part.min() < 0
    assert kit.min() < 0
    pivot = there.query.pivot
    before, after = sample.residual, residual_of(moved_truth(truth, WORLD_MOTION), pivot, guess, work)
    np.testing.assert_allclose(after.offset, before.offset, atol=1e-9)
    np.testing.assert_allclose(after.rotations.rotvec(), before.rotations.rotvec(), atol=1e-9)


@pytest.mark.parametrize("track", ["snap", "snap-d415"])
def test_cropped_images_give_the_volumes_of_the_whole_image(data: Dataset, track: str) -> None:
    recorded = next(data.split("train").queries(track))
    query, volumes, guess = restored_query(recorded), QueryVolumes(recorded, "depth"), recorded.guess
    assert guess is not None
    work = Pose(YAWED.wxyz, guess.apply(query.pivot))
    grid = grid_about(guess.inverse() @ work, CELLS, VOXEL)
    observed = ObservedPart(query.image, FIRST_PART_LABEL + query.part, query.pivot)
    whole = resample(observed.volume(VOXEL), grid, threads=1)
    part = volumes.part_volume(guess, work, CELLS, VOXEL)
    np.testing.assert_allclose(part, whole.filled(1.0), atol=1e-6)
    assert (part < 0).any()

    grid, view, mask = grid_about(work, CELLS, VOXEL), query.view, query.kit_region
    kit = volumes.kit_volume(work, CELLS, VOXEL)
    assert differing(kit, tsdf(grid, view, mask, threads=1).filled(1)) < 1e-4
    whole = ObservedKits(query.image, simulated_sensor(query.sensor).kind.noise, query.scene_id).volume(work.xyz, VOXEL)
    columns = volumes.kit_volume(work, CELLS, VOXEL, columns=True)
    assert differing(columns, resample(whole, grid, threads=1).filled(1)) < 1e-2
    assert (columns < 0).sum() > (kit < 0).sum()


def test_without_the_cache_the_volumes_are_the_same(data: Dataset) -> None:
    for source in ("truth", "depth"):
        sample = drawn(data, 7, source)
        alone = QueryVolumes(sample.volumes.query, source, sample.volumes.geometry)
        for shared, own in zip(volumes_of(sample, sample.volumes), volumes_of(sample, alone), strict=True):
            np.testing.assert_array_equal(shared, own)


def volumes_of(sample: QuerySample, volumes: QueryVolumes) -> tuple[np.ndarray, np.ndarray]:
    """Of part and kits."""
    work = sample.world_from_work
    return volumes.part_volume(sample.guess, work, CELLS, VOXEL), volumes.kit_volume(work, CELLS, VOXEL)


def test_a_part_that_is_not_observed_has_an_empty_volume(data: Dataset) -> None:
    sample = drawn(data, 0, "depth")
    volumes = replace(sample.volumes, query=replace(sample.volumes.query, part=200))
    assert np.all(volumes.part_volume(Pose.identity(), YAWED, CELLS, VOXEL) == 1)


def test_without_a_guess_the_pivot_goes_to_the_centre_of_the_kits(data: Dataset) -> None:
    query = next(data.split("train").queries("place"))
    guess = QueryVolumes(query, "depth").initial_guess()
    view, mask = query.view, query.kit_region & (query.view.depth > 0)
    v, u = np.nonzero(mask)
    points = view.world_from_camera.apply(view.camera.unproject_pixels(np.stack([u, v], -1), view.depth[mask]))
    np.testing.assert_allclose(guess.apply(query.pivot), (points.min(0) + points.max(0)) / 2, atol=1e-9)
    assert guess.angle() == 0
    unlabelled = replace(query.image, labels=np.zeros_like(query.image.labels))
    with pytest.raises(InputError, match="nothing of the kits"):
        QueryVolumes(replace(query, read_image=lambda: unlabelled), "depth").initial_guess()


# examples


@pytest.mark.parametrize("source", ["truth", "depth"])
@pytest.mark.parametrize("made", [position_task, rotation_task])
def test_the_same_generator_gives_the_same_bytes(data: Dataset, made: Callable, source: Source) -> None:
    examples = made(sampler(data, source))
    first = examples.example(stream(1))
    examples.example(stream(2))
    sent = pickle.loads(pickle.dumps(examples))
    for other in (examples, sent):
        again = other.example(stream(1))
        assert {name: array.tobytes() for name, array in again.items()} == {
            name: array.tobytes() for name, array in first.items()
        }
    assert all(isinstance(array, np.ndarray) and array.flags.writeable for array in first.values())
    assert len(pickle.dumps(examples)) < 1e5
    assert examples.validation_example(examples.validation_keys()[0]).keys() == first.keys()


def test_position_examples_have_the_sizes_of_their_config_and_flag_offsets_outside(data: Dataset) -> None:
    examples = position_task(sampler(data), replace(POSITION, window=(10, 8, 6)))
    for seed in range(6):
        example = examples.example(stream(seed))
        assert example["part"].shape == POSITION.part_cells
        assert example["kit"].shape == CELLS
        steps = np.rint(example["offset"] / (2 * VOXEL)) + (5, 4, 3)
        assert bool(example["inside"]) == bool(np.all((steps >= 0) & (steps < (10, 8, 6))))


def test_the_nearest_candidate_is_that_to_any_correct_rotation(data: Dataset) -> None:
    queries = QuerySampler(data, "val", "truth")
    examples, key = rotation_task(queries), queries.keys(1)[0]
    every, some = examples.validation_example(key), examples.example(stream(1))
    assert len(every["rotations"]) == len(candidates("ball"))
    assert some["rotations"].shape == (9, 4)
    for example in (every, some):
        assert example["angles"].argmin() == example["nearest"]
    residual = queries.stored(key).residual
    if residual.axis is None:
        angles = quaternion_angle(every["rotations"][:, None], residual.rotations.wxyz).min(1)
        np.testing.assert_allclose(every["angles"], angles, atol=1e-6)


def test_the_nearest_candidate_appears_once_at_any_index() -> None:
    indices, angles = set(), np.roll(np.arange(20.0), 4)
    for seed in range(60):
        chosen = training_candidates(stream(seed), angles, most=6)
        assert len(set(chosen.tolist())) == 6
        indices.update(np.flatnonzero(chosen == 4).tolist())
    assert indices == set(range(6))
    assert sorted(training_candidates(stream(1), np.arange(5.0), 9, 0.5).tolist()) == list(range(5))


def test_hard_negatives_are_drawn_more_often() -> None:
    angles = stream(0).permutation(391).astype(float)
    uniform, hard = (training_candidates(stream(seed), angles, 25, share) for seed, share in ((1, 0), (2, 1)))
    assert np.mean(angles[uniform] <= HARD) < 0.5
    assert np.mean(angles[hard] <= HARD) == 1


def test_keys_are_drawn_targets_spread_evenly(data: Dataset) -> None:
    examples = sampler(data)
    every = [query.id for query in data.split("train").queries("snap") if query.drawn]
    assert examples.keys(100) == every
    assert examples.keys(1) == every[:1]
    sample = examples.stored(every[-1])
    assert sample.guess is sample.volumes.query.guess
    assert sample.world_from_work.angle() == 0


def test_the_image_cache_is_bounded(data: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(volumes_module, "SCENES", 1)
    monkeypatch.setattr(volumes_module, "PARTS", 2)
    examples = sampler(data, "depth")
    for seed in range(6):
        sample = examples.draw(stream(seed))
        sample.volumes.kit_volume(sample.world_from_work, (4, 4, 4), VOXEL)
        sample.volumes.part_volume(sample.guess, sample.world_from_work, (4, 4, 4), VOXEL)
        assert len(examples.images.crops) == 1
        assert 1 <= len(examples.images.parts) <= 2
        assert "image" not in vars(sample.volumes.query)


def test_bad_input_is_refused(data: Dataset) -> None:
    query = drawn(data).volumes.query
    with pytest.raises(InputError, match=f"{query.id}: exact volumes need the true geometry"):
        QueryVolumes(query, "truth")
    with pytest.raises(InputError, match="no query"):
        sampler(data).stored("train-s0000-p9-snap")
    with pytest.raises(InputError, match="train"):
        sampler(data).stored("nothing")


# images


@pytest.fixture(scope="module")
def query(data: Dataset) -> Query:
    return next(iter(data.split("train").queries("snap")))


def test_a_prediction_reads_the_image_of_its_query_once(query: Query) -> None:
    reads = []
    volumes = QueryVolumes(replace(query, read_image=lambda: reads.append(1) or query.read_image()), "depth")
    volumes.part_volume(Pose.identity(), YAWED, CELLS, VOXEL)
    volumes.kit_volume(YAWED, CELLS, VOXEL)
    assert (volumes.query.image.labels.any(), len(reads)) == (True, 1)


# kits that a network completes


@pytest.fixture(scope="module")
def samplers(data: Dataset) -> tuple[QuerySampler, QuerySampler]:
    """By columns, and by the network."""
    network = KitCompleter(WEIGHTS / "kit-completion")
    return QuerySampler(data, "train", "depth"), QuerySampler(data, "train", "depth", kit_completer=network)


@pytest.mark.parametrize("seed", range(3))
def test_a_network_fills_more_of_the_kits_and_frees_nothing(
    samplers: tuple[QuerySampler, QuerySampler], seed: int
) -> None:
    config = replace(ROTATION, kit_distance=True)
    columns, network = (rotation_task(each, config).example(stream(seed))["kit_volume"] for each in samplers)
    assert ((columns < 0) & (network >= 0)).mean() < 1e-3  # but for distances that are rounded elsewhere
    assert ((network < 0) & (columns >= 0)).mean() > 1e-3


def test_the_position_is_read_from_what_is_seen(samplers: tuple[QuerySampler, QuerySampler]) -> None:
    columns, network = (position_task(each).example(stream(1)) for each in samplers)
    assert {name: array.tobytes() for name, array in columns.items()} == {
        name: array.tobytes() for name, array in network.items()
    }


def test_another_process_completes_kits_to_the_same_bytes(samplers: tuple[QuerySampler, QuerySampler]) -> None:
    examples = rotation_task(samplers[1])
    sent = pickle.loads(pickle.dumps(examples))
    here, there = (each.example(stream(2)) for each in (examples, sent))
    assert all(here[name].tobytes() == there[name].tobytes() for name in here)


def test_the_rotation_network_learns_from_kits_as_the_method_completes_them() -> None:
    method, network = all_methods()["snapnet-kits"], all_networks()["snapnet-kits-rotation"]
    assert weight_paths(network.weights) == {name: method.weights[name] for name in ("completion", "kit_completion")}
