"""The network that tells parts apart: what it reads and learns from, how votes gather, and what its weights find."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from baselines.training.tasks.segmentation import CROPS, CentresTask, centres_task
from kit1000.dataset.reader import Dataset
from kit1000.metrics.segmentation import mean_iou
from kit1000.perception.restoration.restorer import Restorer
from kit1000.perception.segmentation.instances import find_bodies, segmented
from kit1000.perception.segmentation.part_finder import (
    MIDDLES_APART,
    PartFinder,
    Votes,
    gathered,
    inputs_of,
)
from kit1000.perception.segmentation.predicted_masks import MASKS_WEIGHTS
from kit1000.perception.sensor_facts import simulated_sensor
from kit1000.pose import Pose
from kit1000.values import FIRST_PART_LABEL, LabelledDepth
from kit1000.weights import WEIGHTS

D415 = simulated_sensor("d415")
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
@settings(max_examples=30, deadline=None)
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


def test_fresh_views_are_the_same_whoever_makes_them(mini: Path, task: CentresTask) -> None:
    again = centres_task(Dataset(mini), "small", UNMASKED)
    for index in (0, CROPS - 1, CROPS):
        crop, same = task.training[index], again.training[index]
        assert all(np.array_equal(crop[name], same[name]) for name in crop)
        assert not crop["across"][~crop["part"]].any()
    assert len(task.training) == CROPS * 2500
    with pytest.raises(IndexError):
        task.training[len(task.training)]


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


def test_noisy_parts_are_told_apart(mini: Path, restorer: Restorer) -> None:
    finder, scores = PartFinder(FINDER), []
    for scene in Dataset(mini).split("train"):
        if "d415" in scene.sensors:
            image = scene.labelled_depth("d415")
            scores.append(mean_iou(segmented(image.view, D415, 1.0, restorer, finder), image.labels))
    assert np.mean(scores) > 0.75


def test_noise_beside_bodies_is_no_part(image: LabelledDepth, restorer: Restorer) -> None:
    finder, bodies = PartFinder(FINDER), find_bodies(image.view, D415, restorer)
    found = finder(bodies)
    number = int(np.bincount(found[found > 0]).argmax())
    hidden = finder(bodies._replace(parts=bodies.parts & (found != number)))
    assert not hidden[found == number].any()


def test_two_runs_agree_to_the_bit_and_the_input_stays(image: LabelledDepth, restorer: Restorer) -> None:
    finder, before = PartFinder(FINDER), image.view.depth.tobytes()
    one, two = (segmented(image.view, D415, 1.0, restorer, finder) for _ in range(2))
    assert one.tobytes() == two.tobytes()
    assert image.view.depth.tobytes() == before
    firsts = [np.argmax(one == number) for number in range(FIRST_PART_LABEL, int(one.max()) + 1)]
    assert firsts == sorted(firsts)
