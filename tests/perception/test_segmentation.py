"""Segmentation: bodies that touch are told apart by rules and by votes, the same wherever the world begins."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt, label

from baselines.catalog import all_methods, method_of, run_config
from baselines.training.tasks.segmentation import CentresTask, centres_task, crop_places
from kit1000.camera import Camera, look_at
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.mesh import Mesh
from kit1000.metrics.segmentation import mean_iou
from kit1000.perception.image_kinds import IDEAL
from kit1000.perception.restoration.restorer import Restorer
from kit1000.perception.segmentation.instances import OF_LARGEST, find_bodies, segmented, world_points
from kit1000.perception.segmentation.part_finder import MIDDLES_APART, PartFinder, Votes, gathered, inputs_of
from kit1000.perception.segmentation.pieces import (
    MOST_PIECES,
    best_pairs,
    connected,
    find_pieces,
    gap_between,
    outline_of,
)
from kit1000.perception.segmentation.predicted_masks import MASKS_WEIGHTS, with_predicted_masks
from kit1000.perception.sensor_facts import simulated_sensor
from kit1000.pose import Pose
from kit1000.prediction.making import PREDICTED_MASKS, source_hash
from kit1000.prediction.predict import predict
from kit1000.sim.layout import table
from kit1000.sim.render import render
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, LabelledDepth, View
from kit1000.weights import WEIGHTS

CAMERA = Camera(480, 360, 460.0, 460.0, 239.5, 179.5)
EYE = look_at((0.45, -0.1, 0.5), (0.0, -0.05, 0.02))
BOX = table().vertices / (1.2, 1.6, 0.04) + (0, 0, 1)  # 1 m wide, on z = 0

D415 = simulated_sensor("d415")


def box(x: float, y: float, size: tuple[float, float, float]) -> tuple[Mesh, Pose]:
    return Mesh(BOX * size, table().faces), Pose.from_translation([x, y, 0.0])


def scene(*bodies: tuple[Mesh, Pose]) -> LabelledDepth:
    """The first body is a kit, the others are parts."""
    image = render(CAMERA, EYE, [(table(), Pose.identity()), *bodies])
    labels = np.maximum(image.body_ids - 1, 0).astype(np.uint8)  # the table is the first body
    return LabelledDepth(View(CAMERA, EYE, image.depth), labels)


KIT = box(0.0, 0.09, (0.15, 0.12, 0.05))


def test_boxes_that_touch_are_told_apart_and_one_box_is_one() -> None:
    low, high = box(0.0, -0.10, (0.03, 0.04, 0.02)), box(-0.0351, -0.105, (0.04, 0.06, 0.045))
    side = box(0.005, -0.1451, (0.03, 0.05, 0.03))
    for parts in ((low,), (high,), (low, high), (low, side), (low, high, side)):
        image = scene(KIT, *parts)
        found = segmented(image.view)
        assert mean_iou(found, image.labels) > 0.97, len(parts)
        assert found.max() == image.labels.max()


def test_a_part_in_two_pieces_behind_another_is_one() -> None:
    """A bar lies behind a post, which hides its middle."""
    image = scene(KIT, box(-0.02, -0.12, (0.02, 0.06, 0.02)), box(0.03, -0.12, (0.012, 0.012, 0.05)))
    assert mean_iou(segmented(image.view), image.labels) > 0.97


def test_in_a_restored_image_a_body_is_what_the_sensor_saw_and_the_kits_are_one() -> None:
    part, ghost = box(0.0, -0.10, (0.03, 0.04, 0.02)), box(0.05, -0.18, (0.04, 0.04, 0.04))
    crumb = box(0.0, 0.2, (0.02, 0.02, 0.02))
    image = scene(KIT, part, ghost, crumb)
    is_kit, is_part, is_ghost, is_crumb = (image.labels == 1 + k for k in range(4))
    assert 50 < is_crumb.sum() < OF_LARGEST * is_kit.sum()
    exact = SimpleNamespace(without_masks=lambda measured, sensor: image.view)  # a network that restores all of it
    measured = replace(image.view, depth=np.where(is_ghost, np.float32(0), image.view.depth))
    found = find_bodies(measured, D415, cast(Restorer, exact))
    assert found.parts[is_part].mean() > 0.95
    assert found.kits[is_kit].mean() > 0.95
    assert not (found.kits | found.parts)[is_ghost | is_crumb].any()
    seen = find_bodies(image.view, D415, cast(Restorer, exact))
    assert seen.parts[is_ghost].mean() > 0.95


def test_masks_do_not_depend_on_where_along_the_table_the_world_begins(mini: Path) -> None:
    view = next(iter(Dataset(mini).split("test"))).view()
    moved = View(view.camera, Pose.from_translation([0.2, 0.0, 0.0]) @ view.world_from_camera, view.depth)
    assert (segmented(moved) == segmented(view)).mean() > 0.9999


def test_instances_are_counted_in_the_order_of_their_first_pixels(mini: Path) -> None:
    for scene_ in list(Dataset(mini).split("train"))[:3]:
        labels = segmented(scene_.view())
        firsts = [np.argmax(labels == number) for number in range(FIRST_PART_LABEL, int(labels.max()) + 1)]
        assert firsts == sorted(firsts)
        assert (labels[world_points(scene_.view())[..., 1] < 0] != ASSEMBLY_LABEL).all()


def test_scenes_are_segmented_as_well_as_stated(mini: Path) -> None:
    scenes = [*Dataset(mini).split("train"), *Dataset(mini).split("test")][:8]
    for sensor, least in (("ideal", 0.95), ("d415", 0.3)):
        images = [scene_.labelled_depth(sensor) for scene_ in scenes if sensor in scene_.sensors]
        assert (
            np.mean([mean_iou(segmented(image.view, simulated_sensor(sensor)), image.labels) for image in images])
            > least
        )


def test_a_gap_is_the_largest_distance_from_the_line_of_an_edge() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        a, b = (outline_of(rng.normal(size=(9, 2)) + shift) for shift in (0, rng.normal(scale=3, size=2)))
        distances = []
        for one, other in ((a, b), (b, a)):
            edges = np.roll(one, -1, axis=0) - one
            right = np.column_stack([edges[:, 1], -edges[:, 0]]) / np.linalg.norm(edges, axis=1)[:, None]
            distances += [((other - corner) @ normal).min() for corner, normal in zip(one, right, strict=True)]
        assert gap_between(a, b) == pytest.approx(max(distances), abs=1e-12)


@pytest.mark.parametrize("sensor", ["ideal", "d415"])
def test_images_that_show_nothing_have_no_instance(sensor: str) -> None:
    noise = np.random.default_rng(0).uniform(0, 2, (360, 480)).astype(np.float32)
    empty = render(CAMERA, EYE, [(table(), Pose.identity())]).depth
    for depth in (np.zeros((360, 480), np.float32), empty, np.full((360, 480), 1e-6, np.float32), noise):
        labels = segmented(View(CAMERA, EYE, depth), simulated_sensor(sensor))
        assert labels.dtype == np.uint8
        assert labels.shape == depth.shape
        assert depth is not empty or not labels.any()


def test_of_very_many_pieces_the_largest_are_kept_in_their_order() -> None:
    depth = np.ones((30, 60))
    depth[:, ::2] = 2.0  # every column is a piece of its own
    mask = np.ones(depth.shape, bool)
    mask[15, :30] = False  # which halves half of them
    labels, joined = find_pieces(depth, mask, IDEAL.segmentation)
    assert labels.max() == 90
    assert (np.unique(labels[mask]) == np.arange(1, 91)).all()
    assert not joined[1].any()
    rows = np.repeat(np.arange(3 * MOST_PIECES)[:, None], 13, axis=1)
    many, _ = find_pieces(1.0 + rows % 2, rows >= 0, IDEAL.segmentation)
    assert many.max() == MOST_PIECES
    assert (np.diff(many[many > 0]) >= 0).all()


@given(st.integers(0, 2**32 - 1))
def test_components_without_any_step_are_those_of_scipy(seed: int) -> None:
    mask = np.random.default_rng(seed).random((9, 12)) < 0.6
    everywhere = [np.ones((8, 12), bool), np.ones((9, 11), bool)]
    expected, count = label(mask)  # type: ignore[misc]
    assert np.array_equal(connected(mask, everywhere), expected)
    assert len(np.unique(connected(mask, [~edge for edge in everywhere]))) == mask.sum() + (not mask.all())
    assert count == expected.max()


@given(st.lists(st.integers(-3, 3), min_size=6, max_size=6))
def test_the_pairs_that_merge_are_each_others_best(scores: list[int]) -> None:
    pairs = [(i, j) for i in range(4) for j in range(i + 1, 4)]
    chosen = best_pairs(pairs, np.array(scores, float))
    labels = [label_ for pair in chosen for label_ in pair]
    assert len(labels) == len(set(labels))
    for pair in chosen:
        rivals = [score for other, score in zip(pairs, scores, strict=True) if {*other} & {*pair}]
        assert scores[pairs.index(pair)] == max(rivals) > 0
    assert bool(chosen) == (max(scores) > 0)


def test_a_query_gets_its_part_by_the_pivot_and_never_reads_the_masks(mini: Path) -> None:
    queries = [query for query in Dataset(mini).split("test").queries() if query.sensor == "ideal"][:6]
    for query in queries:
        predicted = with_predicted_masks(query)
        assert (predicted.part_mask & query.part_mask).sum() > 0.8 * (predicted.part_mask | query.part_mask).sum()
        assert (predicted.kit_region & query.kit_region).sum() > 0.95 * query.kit_region.sum()
        nothing = LabelledDepth(query.view, np.zeros_like(query.image.labels))
        blind = replace(query, part=3 - query.part, read_image=lambda nothing=nothing: nothing)
        assert np.array_equal(with_predicted_masks(blind).part_mask, predicted.part_mask)


def test_a_part_that_is_not_found_is_looked_for_at_the_pivot(mini: Path) -> None:
    query = next(Dataset(mini).split("test").queries())
    kits = query.image.labels
    view = query.view
    depth = np.where(kits > ASSEMBLY_LABEL, 0, view.depth).astype(np.float32)
    hidden = LabelledDepth(View(view.camera, view.world_from_camera, depth), np.zeros_like(kits))
    predicted = with_predicted_masks(replace(query, read_image=lambda: hidden))
    assert predicted.part_mask.sum() <= 21 * 21


def test_a_run_on_predicted_masks_says_so_and_is_another_method(mini: Path, tmp_path: Path) -> None:
    name = "registration" + PREDICTED_MASKS
    manifest = predict(run_config(name, ("test",), ("snap",), limit=1), mini, tmp_path / "out", 1).manifest
    assert (manifest.method, manifest.masks) == (name, "predicted")
    assert "predict registration --split test --masks predicted" in manifest.reproduce
    assert predict(run_config("guess", ("test",), ("snap",)), mini, tmp_path / "guess", 1).manifest.masks == "given"
    assert source_hash(method_of(name)) != source_hash(all_methods()["registration"])
    for refused in ("truth", "registration-gtvol"):
        with pytest.raises(InputError, match="--masks given"):
            method_of(refused + PREDICTED_MASKS)


UNMASKED, FINDER = (WEIGHTS / stem for stem in MASKS_WEIGHTS)


@pytest.fixture(scope="module")
def restorer() -> Restorer:
    return Restorer(UNMASKED)


@pytest.fixture(scope="module")
def image(mini: Path) -> LabelledDepth:
    """A recorded image."""
    return next(iter(Dataset(mini).split("val"))).labelled_depth("d415")


@pytest.fixture(scope="module")
def task(mini: Path) -> CentresTask:
    return centres_task(Dataset(mini), "small", UNMASKED)


@given(st.integers(0, 2**32 - 1))
def test_exact_votes_tell_parts_apart(seed: int) -> None:
    """Also of parts that touch, or that others cut into pieces; the more so with noise of a few pixels."""
    rng = np.random.default_rng(seed)
    places = np.stack(np.meshgrid(*[np.arange(20, 120, 2 * MIDDLES_APART)] * 2), -1).reshape(-1, 2)
    middles = rng.permutation(places)[:6]
    rows, columns = np.indices((140, 140))
    away = np.square(rows[..., None] - middles[:, 0]) + np.square(columns[..., None] - middles[:, 1])
    truth = np.where(away.min(-1) < 12**2, 1 + away.argmin(-1), 0)
    truth = truth * (rng.random(truth.shape) < 0.8)
    places = np.stack([np.take(np.append(0, middles[:, axis]), truth) for axis in (0, 1)]).astype(float)
    for noise in (0.0, 1.5):
        found = gathered(places + noise * rng.normal(size=places.shape), truth > 0)
        assert ((found > 0) == (truth > 0)).all()
        pairs = {(int(a), int(b)) for a, b in zip(found[truth > 0], truth[truth > 0], strict=True)}
        assert len(pairs) == len(middles) == found.max()


def test_too_few_votes_are_no_part() -> None:
    part = np.zeros((60, 60), bool)
    assert not gathered(np.indices(part.shape).astype(float), part).any()
    part[10:14, 10:14] = True
    assert not gathered(np.full((2, 60, 60), 12.0), part).any()
    outside = gathered(np.full((2, 60, 60), -50.0), np.ones((60, 60), bool))
    assert (outside == 1).all()  # votes beyond the border count at it


def test_a_scene_of_another_size_looks_alike_from_a_distance_in_proportion(mini: Path, restorer: Restorer) -> None:
    view = next(iter(Dataset(mini).split("val"))).view()
    bodies = find_bodies(view, simulated_sensor("ideal"))
    pose = view.world_from_camera
    larger = replace(view, depth=view.depth * np.float32(1.6), world_from_camera=Pose(pose.wxyz, 1.6 * pose.xyz))
    one, other = (inputs_of(bodies._replace(view=each, measured=each)) for each in (view, larger))
    for name, values in one.items():
        np.testing.assert_allclose(values, other[name], atol=2e-3)
    table = bodies.view.depth > 0
    table &= ~bodies.kits & ~bodies.parts
    assert np.abs(one["restored"][table]).max() < 1.0


def test_crops_show_what_is_mistaken() -> None:
    low, high = box(0.0, -0.10, (0.03, 0.04, 0.02)), box(-0.036, -0.105, (0.04, 0.06, 0.045))
    image = scene(KIT, low, high, box(0.12, -0.12, (0.05, 0.05, 0.003)))
    ripple = image.labels == image.labels.max()
    labels = np.where(ripple, 0, image.labels)
    places = crop_places(labels, image.view)
    assert not (places["table"] & ~ripple).any()
    assert places["table"].sum() > 0.9 * ripple.sum()
    away = np.array([distance_transform_edt(labels != FIRST_PART_LABEL + i) for i in range(2)])
    assert places["touching"].any()
    assert away.max(0)[places["touching"][0]].max() < 12
    one = scene(KIT, low)
    alone = crop_places(one.labels, one.view)
    assert all(np.array_equal(alone[kind], alone["parts"]) for kind in ("touching", "table"))


def test_the_truth_measures_zero(task: CentresTask) -> None:
    keys = task.validation_keys()
    assert task.validation_keys() == keys
    batch = {name: torch.from_numpy(value)[None] for name, value in task.validation_example(keys[0]).items()}
    sure = torch.where(batch["part"], 40.0, -40.0)
    offset = torch.stack([batch["across"], batch["down"]], 1)
    forward = task.model.forward
    task.model.forward = lambda *_: Votes(offset, sure)  # type: ignore[method-assign]
    assert all(float(value) == 0 for value in task.measure(batch).values())
    assert float(task.loss(batch)) == pytest.approx(0, abs=1e-6)
    task.model.forward = lambda *_: Votes(offset + torch.tensor([3.0, 4.0]).view(1, 2, 1, 1), -sure)  # type: ignore[method-assign]
    assert [float(value) for value in task.measure(batch).values()] == pytest.approx([5.0, 1.0])
    task.model.forward = forward  # type: ignore[method-assign]


def test_the_true_votes_of_an_image_are_its_masks(task: CentresTask) -> None:
    example = task.validation_example(task.validation_keys()[0])
    rows, columns = np.indices(example["part"].shape)
    found = gathered(np.stack([rows + example["down"], columns + example["across"]]), example["part"])
    assert found.max() >= 1
    assert ((found > 0) == example["part"]).all()


def test_restored_images_are_segmented_better_and_votes_tell_parts_apart(mini: Path, restorer: Restorer) -> None:
    scores = []
    for scene_ in Dataset(mini).split("train"):
        if "d415" in scene_.sensors:
            image = scene_.labelled_depth("d415")
            ways = ((None, None), (restorer, None), (restorer, PartFinder(FINDER)))
            scores.append([mean_iou(segmented(image.view, D415, 1.0, *way), image.labels) for way in ways])
    plain, restored, voted = np.mean(scores, axis=0)
    assert restored > plain + 0.03
    assert voted > 0.75


def test_noise_beside_bodies_is_no_part(image: LabelledDepth, restorer: Restorer) -> None:
    finder, bodies = PartFinder(FINDER), find_bodies(image.view, D415, restorer)
    found = finder(bodies)
    number = int(np.bincount(found[found > 0]).argmax())
    hidden = finder(bodies._replace(parts=bodies.parts & (found != number)))
    assert not hidden[found == number].any()
