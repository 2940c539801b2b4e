"""TransporterNet: its lattice and yaws, its networks, its inputs, its loss and its window."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch.utils.data import default_collate

from baselines.heights.maps import HeightMap
from baselines.heights.scene_heights import RenderedHeights, SceneHeights
from baselines.training.tasks.goal_draws import QueryDraws
from baselines.transporter.config import TRANSPORTER, YAW_STEP, YAWS, TransporterConfig
from baselines.transporter.examples import GUESS_YAWS, TransporterTask, goals_of, transporter_loss
from baselines.transporter.inputs import guess_window, kit_maps, part_maps, start_of
from baselines.transporter.lattice import lattice_of, peak_of, position_of, rotation_from, spread_cells, tilt_and_yaw
from baselines.transporter.method import Transporter, motion_to, search, within_window
from baselines.transporter.network import (
    FCN,
    FEATURES,
    PER_SCALAR,
    SCALARS,
    SCORED,
    TransporterNet,
    correlate,
    with_slopes,
)
from kit1000.dataset.reader import Dataset
from kit1000.pose import Pose, random_quaternions
from kit1000.queries.guesses import MAX_ANGLE, MAX_OFFSET
from kit1000.rng import stream
from kit1000.testing import check_predictor

TINY = TransporterConfig(4e-3, 88, 40, 16, 4, True, True, True, 4, True, 1, "mean")
ANGLES = st.floats(-3.1, 3.1)


@given(st.floats(-0.039, 0.039), st.floats(-0.039, 0.039), ANGLES)
def test_a_pose_comes_back_from_its_cells(x: float, y: float, yaw: float) -> None:
    """Spread over eight cells exactly, as the nearest cell within half of one: there is no bias of half a pixel."""
    xy = np.array([x, y])
    lattice = lattice_of(xy, 41, 2e-3)
    for spread, allowed in ((True, 1e-6), (False, 0.5 + 1e-9)):
        cells, shares = spread_cells(lattice, yaw, spread)
        probability = np.zeros((YAWS, 41, 41))
        probability[tuple(cells.T)] = shares
        assert shares.sum() == pytest.approx(1)
        _, found_yaw, found = peak_of(probability, np.arange(YAWS), spread)
        turn = (found_yaw - yaw + np.pi) % (2 * np.pi) - np.pi
        assert np.abs(found - lattice).max() <= allowed
        assert abs(turn) / YAW_STEP <= allowed
        assert np.abs(position_of(found, 41, 2e-3) - xy).max() <= allowed * 2e-3


def test_rotations_split_into_tilt_and_yaw_and_back() -> None:
    rotations = Pose(random_quaternions(stream(0, "split"), 200), np.zeros((200, 3)))
    tilts, yaws = tilt_and_yaw(rotations)
    back = Pose.stack([rotation_from(tilt, yaw) for tilt, yaw in zip(tilts, yaws, strict=True)])
    assert (back.inverse() @ rotations).angle().max() < 1e-6
    assert (np.abs(yaws) <= np.pi).all()


def test_correlation_is_the_sum_of_products_at_each_shift() -> None:
    rng = torch.Generator().manual_seed(0)
    kits, kernels = torch.randn(2, 3, 20, 20, generator=rng), torch.randn(2, 4, 3, 8, 8, generator=rng)
    plain = torch.stack([torch.conv2d(kits[i : i + 1], kernels[i])[0] for i in range(2)]) / 8
    assert torch.allclose(correlate(kits, kernels), plain, atol=1e-4)


@pytest.mark.parametrize("half", [False, True])
def test_heights_and_tilts_come_from_mean_products_at_each_point(half: bool) -> None:
    """Also where the networks run in bfloat16: there PyTorch's convolutions of groups are wrong on a CPU."""
    rng = torch.Generator().manual_seed(0)
    net = TransporterNet(TINY)
    kits, kernels = torch.randn(1, FEATURES, 20, 20, generator=rng), torch.randn(1, 2, FEATURES, 16, 16, generator=rng)
    with torch.no_grad(), torch.autocast("cpu", torch.bfloat16, enabled=half):
        found = net.height_and_tilt(kits, kernels, torch.tensor([[1, 2]]), 3)
    assert found.shape == (1, SCALARS, 2, 3, 3)
    for scalar, yaw, a, b in ((0, 0, 0, 0), (1, 1, 2, 0), (2, 0, 1, 2)):
        own = slice(SCORED + scalar * PER_SCALAR, SCORED + (scalar + 1) * PER_SCALAR)
        patch = kits[0, own, 1 + a : 17 + a, 2 + b : 18 + b]
        wanted = net.scalars[scalar]((patch * kernels[0, yaw, own]).mean((1, 2)))
        assert float(found[0, scalar, yaw, a, b]) == pytest.approx(wanted.item(), abs=1e-5)


def test_a_plane_has_its_slopes_where_it_is_seen() -> None:
    i, j = torch.meshgrid(torch.arange(9.0), torch.arange(9.0), indexing="ij")
    seen = (i < 6).float()
    height = (0.3 * i - 0.2 * j) * 2e-3 * seen
    slopes = with_slopes(torch.stack([height / 0.05, seen])[None], {0: 0.05}, 1, 2e-3)[0, 2:]
    assert torch.allclose(slopes[:, 1:5, 1:-1], torch.tensor([0.3, -0.2])[:, None, None].expand(2, 4, 7), atol=1e-5)
    assert (slopes[0, 5:] == 0).all()
    assert (slopes[:, 6:] == 0).all()


class Outline(torch.nn.Module):
    """Features that are the outline alone."""

    def forward(self, maps: torch.Tensor) -> torch.Tensor:
        return (2 * maps[:, 2:3] - 0.6).repeat(1, FEATURES, 1, 1)


def ell(turn: float, middle: tuple[float, float]) -> np.ndarray:
    """(n, 3) [m]: points of an L, 20 mm high, turned about its pivot and moved there."""
    x, y = np.meshgrid(np.arange(-19.75, 20, 0.5), np.arange(-19.75, 20, 0.5))
    inside = (x < -6) | (y < -10)
    flat = np.column_stack([x[inside], y[inside], np.full(inside.sum(), 20)]) / 1e3
    return Pose.from_rotvec((0, 0, turn)).rotate(flat) + (*middle, 0)


@pytest.mark.parametrize("yaw", [0, 3, 10, 20, 35])
def test_a_part_is_found_where_it_lies_at_every_yaw(yaw: int) -> None:
    """Its outline as features: the best cell is the pose of the same outline in the scene, not its mirror image."""
    config = TransporterConfig(2e-3, 88, 64, 32, 8, peak="mean")
    net = TransporterNet(config)
    net.kits = net.part = Outline()  # pyright: ignore[reportAttributeAccessIssue]
    start = start_of(SceneHeights(HeightMap(np.zeros(2), 1e-3, np.zeros((1, 1))), np.zeros(2), {}), np.zeros(3), None)
    target = np.array([0.0213, -0.0148])
    scene = part_maps(ell(yaw * YAW_STEP, (target[0], target[1])), start, TransporterConfig(2e-3, 88, 64, 58, 8))
    kits = torch.as_tensor(scene)
    assert kits.shape[-1] == config.kits
    part = torch.as_tensor(part_maps(ell(0, (0, 0)), start, config))
    points = start.points(config)
    found = search(net, kits, part, np.arange(YAWS), np.ones((points, points), bool), np.zeros((points, points)))
    assert np.abs(found.xyz[:2] - target).max() < 1e-3
    assert np.degrees(np.abs(np.angle(np.exp(1j * (found.yaw - yaw * YAW_STEP))))) < 3


def test_the_paper_preset_has_the_layers_and_the_size_of_the_paper() -> None:
    net = FCN(6, 64, 3)
    layers = [module for module in net.modules() if isinstance(module, torch.nn.Conv2d)]
    assert len(layers) == 1 + 8 * 6 + 8  # the stem, three in each of 16 blocks, and the shortcuts
    assert sum(layer.weight.numel() for layer in layers) == pytest.approx(9.8e6, rel=0.02)
    assert TRANSPORTER["paper"].pixel * TRANSPORTER["paper"].kits == pytest.approx(0.7, abs=1e-3)


def tiny_task(mini: Path, folder: Path) -> TransporterTask:
    dataset = Dataset(mini)
    draws = QueryDraws(dataset, "train", RenderedHeights(dataset, folder))
    return TransporterTask(draws, draws, TINY, TransporterNet(TINY))


def test_goals_are_the_motions_that_cells_heights_and_tilts_stand_for(mini: Path, tmp_path: Path) -> None:
    task = tiny_task(mini, tmp_path)
    for k, guesses in enumerate(("place", "ball", "tilt")):
        sample = task.training.draw(stream(k, "goals"), guesses)
        start = start_of(sample.heights, sample.query.pivot, sample.guess, yaw=0.7)
        goals = goals_of(sample, start)
        for xyz, tilt, yaw in zip(*goals, strict=True):
            rotation = start.work_from_world.inverse() @ rotation_from(tilt, yaw) @ start.work_from_part
            motion = motion_to(rotation, sample.query.pivot, start.work_from_world.inverse().apply(xyz))
            apart = [np.linalg.norm((goal.inverse() @ motion).matrix() - np.eye(4)) for goal in sample.goals]
            assert min(apart) < 1e-6
        if sample.guess is not None:
            assert (np.abs(goals.yaws) <= MAX_ANGLE + 0.01).all()


def test_turning_the_work_frame_turns_the_maps_and_keeps_the_goal(mini: Path, tmp_path: Path) -> None:
    """A quarter turn: the same pixels elsewhere, the same yaw, height and size of the tilt."""
    task = tiny_task(mini, tmp_path)
    sample = task.training.draw(stream(0, "turn"), "ball")
    plain, turned = (start_of(sample.heights, sample.query.pivot, sample.guess, yaw) for yaw in (0.0, np.pi / 2))
    maps, base = kit_maps(sample.heights.kits, plain, TINY)
    turned_maps, turned_base = kit_maps(sample.heights.kits, turned, TINY)
    assert np.mean(np.abs(turned_maps[:2] - np.rot90(maps[:2], -1, (1, 2))) > 1e-4) < 0.01  # cells on borders
    assert np.median(np.abs(turned_base - np.rot90(base, -1))) < 1e-4
    one, other = goals_of(sample, plain), goals_of(sample, turned)
    assert one.yaws == pytest.approx(other.yaws, abs=1e-9)
    assert one.xyz[:, 2] == pytest.approx(other.xyz[:, 2])
    assert np.linalg.norm(one.tilts, axis=1) == pytest.approx(np.linalg.norm(other.tilts, axis=1))
    assert other.xyz[:, :2] == pytest.approx(np.stack([one.xyz[:, 1], -one.xyz[:, 0]], 1))


def test_targets_of_a_guess_lie_in_its_window(mini: Path, tmp_path: Path) -> None:
    task = tiny_task(mini, tmp_path)
    for k in range(6):
        example = task.drawn(stream(k, "window"), "ball")
        _, row, column = example["cells"].T
        used = example["shares"] > 0
        assert used.any()
        assert example["window"][row[used], column[used]].all()
        assert (example["yaws"] == GUESS_YAWS).all()
        assert example["shares"].sum() == pytest.approx(1, abs=1e-5)
    start = start_of(task.training.draw(stream(0, "w"), "tilt").heights, np.zeros(3), Pose.identity())
    axis = (np.arange(start.points(TINY)) - (start.points(TINY) - 1) / 2) * TINY.pixel
    inside = np.abs(axis) <= MAX_OFFSET + 2 * TINY.pixel
    assert (guess_window(start, TINY) == (inside[:, None] & inside)).all()


@given(st.integers(0, 1000))
def test_predictions_stay_in_the_window_of_the_guess(seed: int) -> None:
    rng = stream(seed, "stay")
    wxyz = random_quaternions(rng, 2)
    guess, rotation = Pose(wxyz[0], rng.normal(size=3)), Pose(wxyz[1], np.zeros(3))
    pivot = rng.normal(size=3) / 10
    kept, target = within_window(rotation, rng.normal(size=3) / 20, guess, pivot)
    assert (kept @ Pose(guess.wxyz, np.zeros(3)).inverse()).angle() <= MAX_ANGLE + 1e-9
    assert (np.abs(target - guess.apply(pivot)) <= MAX_OFFSET + 1e-12).all()
    near = Pose.from_rotvec((0.1, 0.0, 0.2)) @ Pose(guess.wxyz, np.zeros(3))
    same, there = within_window(near, guess.apply(pivot) + 0.01, guess, pivot)
    assert (same.inverse() @ near).angle() < 1e-7
    assert there == pytest.approx(guess.apply(pivot) + 0.01)


@pytest.mark.slow
def test_one_batch_is_learned(mini: Path, tmp_path: Path) -> None:
    """The cell of the goal, its height and its tilt, in a query without and one with a guess."""
    torch.manual_seed(0)
    task = tiny_task(mini, tmp_path)
    net = task.model
    drawn = [task.drawn(stream(3, guesses), guesses) for guesses in ("place", "tilt")]
    batches = [default_collate([{key: torch.as_tensor(value) for key, value in one.items()}]) for one in drawn]
    optimizer = torch.optim.Adam(net.parameters(), 4e-3)
    first = last = np.zeros(2)
    for step in range(40):
        losses = [transporter_loss(net, batch) for batch in batches]
        last = np.array([float(loss.detach()) for loss in losses])
        first = last if step == 0 else first
        optimizer.zero_grad()
        torch.stack(losses).sum().backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        optimizer.step()
    assert (last < 0.6 * first).all()


def test_the_method_keeps_the_rules(mini: Path) -> None:
    torch.manual_seed(0)
    dataset = Dataset(mini)
    queries = [query for query in dataset.split("test-all").queries() if query.sensor == "ideal"]
    some = [queries[0], replace(queries[0], guess=None, track="place")]
    check_predictor(Transporter(dataset, TransporterNet(TINY)), some, moves=False)
