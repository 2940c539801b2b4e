"""The network that fills holes of a scanner: what it reads, what it learns from, where it is sure, what never moves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import laplace

from baselines.training.tasks.hole_filling import example_of, hole_filling_task
from baselines.training.tasks.noisy_images import scanned_view
from baselines.training.tasks.restoration import CROPS
from kit1000.dataset.reader import Dataset
from kit1000.perception.restoration.disparity import depths
from kit1000.perception.restoration.restorer import (
    UNIT,
    HoleFiller,
    Mixture,
    RestorationConfig,
    RestorationNet,
    hole_inputs,
    holes,
)
from kit1000.perception.restoration.rules import closed_gaps
from kit1000.perception.sensor_facts import simulated_sensor
from kit1000.registration.predictor import Registration
from kit1000.rng import stream
from kit1000.values import LabelledDepth
from kit1000.weights import WEIGHTS

BODIES = range(1, 12)  # labels
TINY = RestorationConfig(widths=(8, 8, 8, 8))

SCANNER = simulated_sensor("photoneo")


@pytest.fixture(scope="module")
def scanned(exact: LabelledDepth) -> LabelledDepth:
    """The same, by a calibrated scanner."""
    return LabelledDepth(scanned_view(exact.view, stream(0, "scanned")), exact.labels)


@pytest.fixture(scope="module")
def filler() -> HoleFiller:
    return HoleFiller(WEIGHTS / "hole-filling")


def untrained(spread: float) -> HoleFiller:
    """A filler that gives back what it reads, as sure as a spread, the exponent of the first one, makes it."""
    torch.manual_seed(0)
    net = RestorationNet(TINY)
    assert net.head.bias is not None
    with torch.no_grad():
        net.head.bias.zero_().view(5, 4)[2:4] = spread
    return HoleFiller(net)


def test_nothing_but_holes_of_bodies_changes(filler: HoleFiller, scanned: LabelledDepth) -> None:
    before = scanned.view.depth.tobytes()
    filled, empty = filler(scanned, SCANNER, BODIES).view.depth, holes(scanned)
    assert scanned.view.depth.tobytes() == before
    assert 0 < empty.sum() < 0.2 * (scanned.labels > 0).sum()
    np.testing.assert_array_equal(filled[~empty], scanned.view.depth[~empty])
    assert 0.2 < (filled[empty] > 0).mean() < 1  # some stay unknown
    assert filler(scanned, SCANNER, BODIES).view.depth.tobytes() == filled.tobytes()


def test_holes_are_filled_better_than_by_rules(
    filler: HoleFiller, exact: LabelledDepth, scanned: LabelledDepth
) -> None:
    filled, rules = filler(scanned, SCANNER, BODIES).view.depth, closed_gaps(scanned).view.depth
    both = holes(scanned) & (filled > 0) & (rules > 0)
    wrong, by_rules = (np.abs(depth - exact.view.depth)[both] for depth in (filled, rules))
    assert np.median(wrong) < min(1e-3, 0.7 * np.median(by_rules))
    assert wrong.mean() < 0.6 * by_rules.mean()


@pytest.mark.parametrize(("spread", "share"), [(-8.0, 1.0), (4.0, 0.0)])
def test_a_hole_is_filled_where_the_network_is_sure(scanned: LabelledDepth, spread: float, share: float) -> None:
    filled, empty = untrained(spread)(scanned, SCANNER, BODIES).view.depth, holes(scanned)
    assert (filled[empty] > 0).mean() == share
    if share:
        np.testing.assert_allclose(filled[empty], _first_estimate(scanned)[empty], rtol=1e-4)


def _first_estimate(image: LabelledDepth) -> np.ndarray:
    """(H, W) [m] the depths that the network reads."""
    read = hole_inputs(image)["disparity"].astype(np.float64)
    everywhere = (slice(0, read.shape[0]), slice(0, read.shape[1]))
    return depths(read, image.view, everywhere, UNIT)


@given(
    medians=st.tuples(st.floats(-2, 2), st.floats(-2, 2)),
    spreads=st.tuples(st.floats(0.01, 2), st.floats(0.01, 2)),
    share=st.floats(0.01, 0.99),
    at=st.floats(-3, 3),
    reach=st.floats(0.01, 2),
)
def test_the_probability_near_a_disparity_is_that_of_two_laplace_distributions(
    medians: tuple[float, float], spreads: tuple[float, float], share: float, at: float, reach: float
) -> None:
    def pair(values: tuple[float, float]) -> torch.Tensor:
        return torch.tensor(values, dtype=torch.float64)[None, :, None, None]

    mixture = Mixture(pair(medians), pair(spreads), pair((share, 1 - share)).log())
    found = float(mixture.probability_near(torch.full((1, 1, 1), at, dtype=torch.float64), reach))
    first, second = (laplace(m, b).cdf((at - reach, at + reach)) for m, b in zip(medians, spreads, strict=True))
    assert found == pytest.approx(share * np.ptp(first) + (1 - share) * np.ptp(second), abs=1e-12)


def test_examples_count_holes_alone_and_tell_their_true_depth(mini: Path, exact: LabelledDepth) -> None:
    dataset = Dataset(mini)
    task = hole_filling_task(dataset, "small")
    image = LabelledDepth(scanned_view(exact.view, stream(1, "scanned")), exact.labels)
    whole = example_of(image, exact.view.depth)
    np.testing.assert_array_equal(whole["counts"], holes(image))
    true = depths(whole["truth"].astype(np.float64), image.view, (slice(None), slice(None)), UNIT)
    np.testing.assert_allclose(true[whole["counts"]], exact.view.depth[whole["counts"]], rtol=1e-4)
    crops = task.training.crops(stream(2, "views"))
    assert len(crops) == CROPS
    assert all(crop["counts"].any() for crop in crops)
    keys = task.validation_keys()
    assert {*keys} <= set(dataset.split("val").scene_ids)


def test_the_loss_reads_nothing_but_holes(mini: Path) -> None:
    task = hole_filling_task(Dataset(mini), "small")
    crop = task.validation_example(task.validation_keys()[0])
    batch = {name: torch.from_numpy(value)[None] for name, value in crop.items()}
    other = batch | {"truth": torch.where(batch["counts"], batch["truth"], batch["truth"] + 7)}
    with torch.inference_mode():
        loss, same, measures = float(task.loss(batch)), float(task.loss(other)), task.measure(batch)
    assert loss == same
    assert float(measures["loss"]) == pytest.approx(loss, rel=1e-5)
    assert 0 <= float(measures["far_hole"]) <= 1


@pytest.mark.slow
def test_registration_fills_holes_of_scanners_alone(mini: Path) -> None:
    dataset = Dataset(mini)
    with_network, by_rules = Registration(dataset, hole_filling=WEIGHTS / "hole-filling"), Registration(dataset)
    for track, same in (("snap", True), ("snap-d415", True), ("snap-photoneo", False)):
        query = next(iter(dataset.split("val").queries(track)))
        scenes = (method.scene(query) for method in (with_network, by_rules))
        filled, left = (image.restored.view for scene in scenes for _, image in [next(scene.parts())] if image)
        assert (filled.depth.tobytes() == left.depth.tobytes()) == same
