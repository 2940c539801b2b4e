"""The network that restores noisy depth: what it reads and learns from, its mixture, and what its weights mend."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import find_objects

from baselines.training.tasks.noisy_images import WIDER, noisy_view
from baselines.training.tasks.restoration import beside_jumps, recorded_example, restoration_task
from kit1000.dataset.reader import Dataset
from kit1000.perception.restoration.disparity import (
    STARTS,
    Inputs,
    above_table,
    cropped_inputs,
    depths,
    labelled_inputs,
    padded_box,
    shifted_box,
)
from kit1000.perception.restoration.restorer import (
    DISPARITY_STEP,
    SIDE,
    Mixture,
    RestorationConfig,
    RestorationNet,
    Restorer,
)
from kit1000.perception.restoration.rules import closed_gaps, restored_edges
from kit1000.perception.sensor_facts import simulated_sensor
from kit1000.registration.predictor import Registration
from kit1000.rng import stream
from kit1000.sim.cameras import CAMERA
from kit1000.values import ASSEMBLY_LABEL, LabelledDepth
from kit1000.weights import WEIGHTS

TINY = RestorationConfig(widths=(8, 8, 8, 8))
D415 = simulated_sensor("d415")


@pytest.fixture(scope="module")
def noisy(exact: LabelledDepth) -> LabelledDepth:
    """The same, by the calibrated d415."""
    return LabelledDepth(noisy_view(exact.view, stream(0, "noisy")), exact.labels)


def untrained(bias: float = 0.0) -> RestorationNet:
    torch.manual_seed(0)
    net = RestorationNet(TINY)
    assert net.head.bias is not None
    torch.nn.init.constant_(net.head.bias, bias)
    return net


def read_of(image: LabelledDepth) -> Inputs:
    return labelled_inputs(image, closed_gaps(image).view, D415)


def test_an_exact_image_shows_the_truth_and_depths_come_back(exact: LabelledDepth) -> None:
    read, bodies = read_of(exact), exact.labels > 0
    truth = above_table(exact.view.depth, exact.view, D415)
    np.testing.assert_allclose(read["disparity"][bodies], truth[bodies], atol=1e-5)
    assert np.abs(read["disparity"][~bodies]).max() < 1e-4  # depths are float32
    whole = slice(0, CAMERA.height), slice(0, CAMERA.width)
    back = depths(read["disparity"].astype(float), exact.view, whole, D415)
    np.testing.assert_allclose(back[bodies], exact.view.depth[bodies], atol=1e-6)


def test_the_slope_is_that_of_the_table(exact: LabelledDepth) -> None:
    seen = exact.view.depth > 0
    inverse = CAMERA.fx * WIDER.baseline / np.where(seen, exact.view.depth, 1.0)
    table = seen & (exact.labels == 0)
    for axis, slope in ((1, read_of(exact)["slope"][0]), (0, read_of(exact)["slope"][1])):
        both = table & np.roll(table, -1, axis)
        step = (np.roll(inverse, -1, axis) - inverse)[both]
        assert np.median(step) == pytest.approx(slope, abs=1e-3)


def test_where_nothing_returned_is_known(noisy: LabelledDepth) -> None:
    read, lost = read_of(noisy), (noisy.labels > 0) & (noisy.view.depth == 0)
    assert lost.any()
    np.testing.assert_array_equal(read["returned"], ~lost)
    assert np.isfinite(read["disparity"]).all()


@given(st.integers(0, 1200), st.integers(1, 1280), st.integers(0, 700), st.integers(1, 720), st.sampled_from(STARTS))
def test_shifted_boxes_hold_theirs_and_begin_elsewhere(
    left: int, width: int, top: int, height: int, start: tuple[int, int]
) -> None:
    columns, rows = slice(left, min(left + width, CAMERA.width)), slice(top, min(top + height, CAMERA.height))
    box = padded_box(rows, columns, SIDE, CAMERA)
    shifted = shifted_box(box, start, SIDE, CAMERA)
    for wide, span, before, size in zip(shifted, box, start, (CAMERA.height, CAMERA.width), strict=True):
        assert 0 <= wide.start <= span.start
        assert span.stop <= wide.stop <= size
        assert (wide.stop - wide.start) % SIDE == 0
        if before <= span.start and span.start - before + span.stop - span.start + SIDE <= size:
            assert span.start - wide.start == before


def test_a_pixel_is_where_the_second_of_three_images_shows_it(noisy: LabelledDepth) -> None:
    torch.manual_seed(1)
    net = untrained()
    torch.nn.init.normal_(net.head.weight, std=0.1)  # so that it depends on where an image begins
    found = Restorer(net)(noisy, D415, [ASSEMBLY_LABEL]).view
    rows, columns = find_objects(noisy.labels)[ASSEMBLY_LABEL - 1]
    box, shown = padded_box(rows, columns, SIDE, CAMERA), []
    for start in STARTS:
        wide = shifted_box(box, start, SIDE, CAMERA)
        cut = cropped_inputs(read_of(noisy), wide)
        with torch.inference_mode():
            read = (torch.from_numpy(cut[name])[None] for name in ("disparity", "returned", "labels", "slope", "level"))
            likeliest = net.eval()(*read).likeliest()[0].numpy()
        whole = np.zeros(noisy.labels.shape)
        whole[wide] = likeliest
        shown.append(whole)
    kits = noisy.labels == ASSEMBLY_LABEL
    low, middle, high = np.sort([image[kits] for image in shown], axis=0)
    assert (high - low).max() > 0.1
    back = above_table(found.depth, closed_gaps(noisy).view, D415)[kits]
    np.testing.assert_allclose(back, middle, atol=DISPARITY_STEP)


def test_a_mixture_is_a_density_and_its_likeliest_is_never_between() -> None:
    values = torch.tensor([[-1.0, 2.0]]).view(1, 2, 1, 1)
    share = torch.log(torch.tensor([[0.4, 0.6]])).view(1, 2, 1, 1)
    mixture = Mixture(values, torch.tensor([[0.05, 0.2]]).view(1, 2, 1, 1), share)
    at = torch.linspace(-8, 8, 160_001)
    density = torch.exp(mixture.log_likelihood(at.view(1, 1, -1)))
    assert float(torch.trapezoid(density[0, 0], at)) == pytest.approx(1, abs=1e-3)
    assert float(mixture.likeliest()) == 2.0
    assert float(mixture._replace(log_share=share.flip(1)).likeliest()) == -1.0


def test_without_training_the_measured_image_stays(noisy: LabelledDepth) -> None:
    labels = np.unique(noisy.labels[noisy.labels > 0]).tolist()
    same, closed = Restorer(untrained())(noisy, D415, labels).view, closed_gaps(noisy).view
    gain = CAMERA.fx * WIDER.baseline
    step = np.abs(gain / np.maximum(same.depth, 0.1) - gain / np.maximum(closed.depth, 0.1))
    seen = closed.depth > 0
    assert step[seen].max() < 0.6 * DISPARITY_STEP + 1e-3
    assert same.world_from_camera == closed.world_from_camera


def test_only_the_labels_asked_for_change(noisy: LabelledDepth) -> None:
    there, closed = Restorer(untrained(0.5))(noisy, D415, [ASSEMBLY_LABEL]).view.depth, closed_gaps(noisy).view.depth
    kits = noisy.labels == ASSEMBLY_LABEL
    np.testing.assert_array_equal(there[~kits], closed[~kits])
    assert (there[kits] != closed[kits]).mean() > 0.99
    nothing = LabelledDepth(noisy.view, np.zeros_like(noisy.labels))
    assert Restorer(untrained())(nothing, D415, [ASSEMBLY_LABEL]).view.depth.shape == noisy.view.depth.shape


def test_the_truth_measures_zero_and_is_the_likeliest(mini: Path) -> None:
    task = restoration_task(Dataset(mini), "small")
    keys = task.validation_keys()
    assert task.validation_keys() == keys
    batch = {name: torch.from_numpy(value)[None] for name, value in task.validation_example(keys[0]).items()}
    assert 0 < float(beside_jumps(batch["truth"]).float().mean()) < 0.7
    two, spread = torch.stack([batch["truth"]] * 2, 1), torch.full((1, 2, *batch["truth"].shape[1:]), 0.02)
    share = torch.full_like(spread, np.log(0.5))
    task.model.forward = lambda *_: Mixture(two, spread, share)  # type: ignore[method-assign]
    assert all(float(value) == 0 for value in task.measure(batch).values())
    truth = float(task.loss(batch))
    task.model.forward = lambda *_: Mixture(two + 0.05, spread, share)  # type: ignore[method-assign]
    assert truth == pytest.approx(float(np.log(0.04)), abs=1e-3)
    assert float(task.loss(batch)) == pytest.approx(truth + 2.5, abs=1e-3)


def test_the_network_mends_what_rules_leave(mini: Path) -> None:
    """Beside edges of the kits of recorded images, and elsewhere on them."""
    dataset, restorer, errors = Dataset(mini), Restorer(WEIGHTS / "restoration"), []
    for scene_id in dataset.split("val").scene_ids:
        image, example = recorded_example(dataset, "val", scene_id)
        beside = beside_jumps(torch.from_numpy(example["truth"])[None])[0].numpy()
        for found in (restored_edges(image, D415), restorer(image, D415, [ASSEMBLY_LABEL])):
            wrong = np.abs(above_table(found.view.depth, image.view, D415) - example["truth"])
            kits = (image.labels == ASSEMBLY_LABEL) & (found.view.depth > 0)
            errors.append((wrong[kits & beside].mean(), wrong[kits & ~beside].mean()))
    rules, network = np.mean(errors[::2], axis=0), np.mean(errors[1::2], axis=0)
    assert network[0] < 0.95 * rules[0]
    assert network[1] < 0.95 * rules[1]  # both keep what calibration leaves of so few images


@pytest.mark.slow
def test_registration_reads_noisy_images_through_it_and_exact_ones_as_they_are(mini: Path) -> None:
    dataset = Dataset(mini)
    with_network, by_rules = Registration(dataset, restoration=WEIGHTS / "restoration"), Registration(dataset)
    for track, same in (("snap", True), ("snap-d415", False)):
        query = next(iter(dataset.split("val").queries(track)))
        one, two = with_network(query), by_rules(query)
        assert np.array_equal(one.goal_from_now.xyz, two.goal_from_now.xyz) == same
        assert (one.confidence == two.confidence) == same
