"""KitNet: its views, its loss without a sign, its examples, its choice of a cavity."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.utils.data import default_collate

from baselines.heights.maps import UNSEEN, HeightMap
from baselines.heights.scene_heights import RenderedHeights
from baselines.kitnet.config import KitNetConfig
from baselines.kitnet.examples import KitNetTask, wiped
from baselines.kitnet.method import KitNetMethod, seat
from baselines.kitnet.network import KitNet, rotation_error, rotation_loss
from baselines.kitnet.views import cavity_view
from baselines.training.tasks.goal_draws import QueryDraws
from kit1000.dataset.reader import Dataset
from kit1000.perception.observed.plates import Plane
from kit1000.pose import Pose, random_quaternions
from kit1000.rng import stream
from kit1000.testing import check_predictor

TINY = KitNetConfig(32, 2.5e-3, 8, (2, 2, 1))


def test_the_error_is_the_angle_to_the_nearest_goal() -> None:
    predicted = Pose(random_quaternions(stream(0, "error"), 5), np.zeros((5, 3)))
    goals = [Pose(random_quaternions(stream(k, "goal"), 5), np.zeros((5, 3))) for k in range(3)]
    angles = np.min([(goal.inverse() @ predicted).angle() for goal in goals[:2]], axis=0)
    wxyz = torch.as_tensor(np.stack([goal.wxyz for goal in goals], 1))
    weights = torch.tensor([[1.0, 1.0, 0.0]], dtype=torch.float64).expand(5, 3)  # the third is no goal
    own = torch.tensor(predicted.wxyz)
    assert rotation_error(own, wxyz, weights).numpy() == pytest.approx(angles)
    assert rotation_loss(own, wxyz, weights).numpy() == pytest.approx(np.sin(angles / 2) ** 2)


def test_the_loss_of_small_angles_is_exact_in_half_precision_too() -> None:
    """Training computes in bfloat16, whose steps near 1 are 7 degrees of rotation."""
    angles = torch.tensor([0.01, 0.05, 0.1, 0.3])
    predicted = torch.stack([(angles / 2).cos(), (angles / 2).sin(), *torch.zeros(2, 4)], 1)
    goals, weights = torch.tensor([1.0, 0, 0, 0]).expand(4, 1, 4), torch.ones(4, 1)
    with torch.autocast("cpu", torch.bfloat16):
        assert torch.allclose(rotation_error(predicted, goals, weights), angles, atol=1e-4)
        assert torch.allclose(rotation_loss(predicted, goals, weights), (angles / 2).sin() ** 2, atol=1e-6)


def plate_with_hollow(tilt: float) -> tuple[HeightMap, Plane]:
    """A plate about x = 0, y = 0.2, tilted about x, with a hollow 30 x 16 mm wide and 12 mm deep."""
    x, y = np.meshgrid(np.arange(-0.21, 0.21, 1e-3) + 5e-4, np.arange(0, 0.42, 1e-3) + 5e-4, indexing="ij")
    along = (y - 0.2) / np.cos(tilt)
    surface = 0.08 + (y - 0.2) * np.tan(tilt)
    plate = (np.abs(x) < 0.049) & (np.abs(along) < 0.049)
    heights = np.where(plate, surface, 0.0)
    mouth = (np.abs(x - 0.004) < 0.015) & (np.abs(along + 0.006) < 0.008)
    wall = 0.2 - 0.014 * np.cos(tilt), 0.08 - 0.014 * np.sin(tilt)  # its upper edge, the one that is seen from above
    down = wall[1] - (y - wall[0]) / np.tan(max(tilt, 1e-3))
    heights = np.where(mouth, np.maximum(surface - 0.012 / np.cos(tilt), down), heights)
    normal = np.array([0.0, -np.sin(tilt), np.cos(tilt)])
    return HeightMap(np.array([-0.21, 0.0]), 1e-3, heights.astype(np.float32)), Plane(
        normal, np.array([0, 0.2, 0.08]), 1.0
    )


@pytest.mark.parametrize("tilt", [0.0, 0.3, 0.5])
def test_a_cavity_is_seen_along_the_normal_of_its_plate(tilt: float) -> None:
    view = cavity_view(*plate_with_hollow(tilt))
    assert view is not None
    inside = np.argwhere(view.depths > 0)
    size = inside.max(0) - inside.min(0) + 1
    assert np.sort(size) == pytest.approx((16, 30), abs=2.5)
    assert view.floor == pytest.approx(0.012, abs=1e-3)
    assert view.world_from_view.rotate((0, 0, 1)) == pytest.approx((0, -np.sin(tilt), np.cos(tilt)), abs=1e-6)
    middle = np.array([0.004, 0.2 - 0.006 * np.cos(tilt), 0.08 - 0.006 * np.sin(tilt)])
    assert view.world_from_view.xyz == pytest.approx(middle, abs=2e-3)


def test_a_plate_without_a_hollow_has_no_cavity() -> None:
    heights = np.full((420, 420), UNSEEN, np.float32)
    heights[160:260, 150:250] = 0.05
    plane = Plane(np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.2, 0.05]), 1.0)
    assert cavity_view(HeightMap(np.array([-0.21, 0.0]), 1e-3, heights), plane) is None


def test_a_block_is_seated_on_the_floor_of_its_cavity() -> None:
    view = cavity_view(*plate_with_hollow(0.3))
    assert view is not None
    x, y = np.meshgrid(np.arange(-14, 14.5, 0.5), np.arange(-7, 7.5, 0.5))
    top = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 20)]) / 1e3
    points = np.concatenate([top, top * (1, 1, 0)]) - (0, 0, 0.01)  # about its middle
    turn = Pose.from_rotvec((0, 0, np.arctan2(view.world_from_view.rotate((1, 0, 0))[1], 1)))
    good, bad = (seat(view, Pose.from_rotvec((0, 0, angle)) @ turn, points, np.zeros(3)) for angle in (0.0, np.pi / 2))
    assert good.overlap > 0.7 > bad.overlap
    there = view.world_from_view.inverse().apply(good.target)
    assert there == pytest.approx((*view.centroid, 0.01 - view.floor), abs=1.5e-3)


def test_wiping_sets_pixels_to_zero_and_changes_no_other() -> None:
    view = np.ones((64, 64), np.float32)
    once = wiped(view, 0.02, stream(0, "wipe"))
    assert set(np.unique(once)) <= {0.0, 1.0}
    assert 0.01 < (once == 0).mean() < 0.15
    assert (view == 1).all()


def tiny_task(mini: Path, folder: Path) -> KitNetTask:
    dataset = Dataset(mini)
    draws = QueryDraws(dataset, "train", RenderedHeights(dataset, folder))
    return KitNetTask(draws, draws, TINY, KitNet(TINY))


def test_examples_begin_within_the_range_of_the_method(mini: Path, tmp_path: Path) -> None:
    """A goal is at most 30 degrees away, of a guess 27.5; half a step more where the goals stand for a free axis."""
    task = tiny_task(mini, tmp_path)
    for k in range(8):
        example = task.example(stream(k, "kitnet"))
        assert example["part"].shape == example["cavity"].shape == (32, 32)
        goals = example["goals"][example["weights"] > 0]
        assert np.linalg.norm(goals, axis=1) == pytest.approx(1, abs=1e-5)
        assert 2 * np.degrees(np.arccos(np.abs(goals[:, 0]).clip(max=1))).min() < 30 + 7.6


@pytest.mark.slow
def test_one_batch_is_learned(mini: Path, tmp_path: Path) -> None:
    torch.manual_seed(0)
    task = tiny_task(mini, tmp_path)
    drawn = [task.example(stream(k, "overfit")) for k in range(8)]
    batch = default_collate([{key: torch.as_tensor(value) for key, value in one.items()} for one in drawn])
    net = task.model
    optimizer = torch.optim.Adam(net.parameters(), 3e-3)
    losses = []
    for _ in range(40):
        loss = rotation_loss(net(batch["part"], batch["cavity"]), batch["goals"], batch["weights"]).mean()
        losses.append(float(loss.detach()))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    assert losses[-1] < 0.2 * losses[0]


def test_the_method_keeps_the_rules(mini: Path) -> None:
    torch.manual_seed(0)
    dataset = Dataset(mini)
    queries = [query for query in dataset.split("test-all").queries() if query.sensor == "ideal"]
    for position in ("centroid", "none"):
        some = [queries[0], replace(queries[0], guess=None, track="place")]
        check_predictor(KitNetMethod(dataset, KitNet(TINY), position), some, moves=False)  # pyright: ignore
