"""Reliefs of plates and the network that completes them: known plates from known cameras, and what is seen stays."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from baselines.training.tasks.kit_completion import (
    D415_SHARE,
    STRETCH,
    drawn_kit,
    kit_completion_task,
    mirrored,
    stretched,
    with_kit,
)
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.kits.assembly import AssemblyPlan, SidePlate, build_assembly
from kit1000.mesh import defect_float32
from kit1000.perception.completion.kits import KitCompleter, KitCompletionNet, kit_loss, likely_depths
from kit1000.perception.image_kinds import IDEAL
from kit1000.perception.networks.unet import UNetConfig
from kit1000.perception.observed.kits import (
    CELLS,
    DEEPEST,
    HIGHEST,
    ObservedKits,
    SeenHeights,
    seen_heights,
    true_depths,
)
from kit1000.perception.observed.plates import Plane
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.values import Kit
from kit1000.voxels import signed_distance
from kit1000.weights import WEIGHTS
from tests.samples.completers import DEEP, WIDE, KnownPlate, plate_image, tray

VOXEL = 1e-3
SMALL = UNetConfig(widths=(8, 8, 8, 8))


def relief_of(moved: Pose, middle: tuple[float, float, float] = (0.004, -0.003, 0.01)) -> SeenHeights:
    plate = Plane(moved.rotate((0.0, 0.0, 1.0)), moved.xyz, 0.0)
    return seen_heights(plate_image(moved), plate, moved.apply(middle), IDEAL.noise)


@pytest.fixture(scope="module")
def seen() -> SeenHeights:
    return relief_of(Pose.identity())


def network() -> KitCompletionNet:
    torch.manual_seed(0)
    return KitCompletionNet(SMALL)


def test_what_is_seen_of_a_plate_is_true_and_its_surface_is_never_above_what_is_seen_free(seen: SeenHeights) -> None:
    truth = true_depths(tray(), Pose.identity(), seen.world_from_plate)
    level = (truth == 0) | (np.abs(truth - 1e3 * DEEP) < 1e-3)  # no wall crosses the cell
    wrong = np.abs(seen.least - truth)[seen.seen & level]
    assert np.median(wrong) < 0.02
    assert (wrong < 0.05).mean() > 0.96  # at rims a pixel reaches half its width too far
    hidden = ~seen.seen & level & (truth < DEEPEST)
    assert (seen.least <= truth + 0.05)[hidden].mean() > 0.98
    # behind the near rim the camera, at 41 degrees from the normal, hides 12 mm x tan 41 of the floor
    floor = np.abs(truth - 1e3 * DEEP) < 1e-3
    assert (hidden & floor).sum() / floor.sum() == pytest.approx(DEEP * np.hypot(0.4, 0.1) / 0.45 / WIDE, abs=0.06)


def test_the_relief_is_the_same_wherever_the_scene_stands(seen: SeenHeights) -> None:
    moved = relief_of(Pose.from_rotvec((0.0, 0.0, 2.0), (0.3, -0.2, 0.1)))
    np.testing.assert_allclose(moved.camera, seen.camera, atol=1e-5)
    assert (moved.seen == seen.seen).mean() > 0.995
    both = moved.seen & seen.seen
    assert np.quantile(np.abs(moved.least - seen.least)[both], 0.99) < 0.02


def test_a_network_changes_no_seen_cell_and_fills_nothing_that_is_seen_free(seen: SeenHeights) -> None:
    completed = KitCompleter(network())(seen)
    np.testing.assert_array_equal(completed.depths[seen.seen], seen.least[seen.seen])
    assert (completed.depths >= seen.least).all()
    assert (completed.depths <= DEEPEST).all()
    mirrored = replace(seen, least=seen.least[:, ::-1].copy(), seen=seen.seen[:, ::-1].copy())
    np.testing.assert_allclose(KitCompleter(network())(mirrored).depths[:, ::-1], completed.depths, atol=0.05)


def test_a_known_relief_fills_the_volume_where_columns_have_no_floor() -> None:
    kits = ObservedKits(plate_image(Pose.identity()), IDEAL.noise, "tray")
    exact, solids = None, []
    for completer in (None, KnownPlate(Pose.identity())):
        volume = replace(kits, completer=completer).volume(np.zeros(3), VOXEL)
        exact = signed_distance(volume.grid, [(tray(), Pose.identity())], threads=1).values < 0
        places = volume.grid.centres()
        box = (np.abs(places[..., :2]) < 0.04).all(-1) & (np.abs(places[..., 2] + 0.011) < 0.009)
        solids.append(((volume.values < 0) != exact)[box].mean())
        assert not np.isnan(volume.values).any()
    assert solids[1] < 0.4 * solids[0]


@given(st.floats(0, DEEPEST - 1), st.integers(0, 9))
def test_sure_logits_give_their_depth(depth: float, seed: int) -> None:
    share = torch.clamp(depth - torch.arange(DEEPEST, dtype=torch.float32), 0, 1)
    logits = torch.logit(share.clamp(1e-4, 1 - 1e-4)).view(1, -1, 1, 1) + torch.zeros(1, 1, 2, 2)
    assert float((likely_depths(logits) - depth).abs().max()) < 0.2
    least, seen = torch.full((1, 2, 2), -HIGHEST), torch.zeros(1, 2, 2, dtype=torch.bool)
    arguments = least, seen, torch.full((1, 2, 2), depth), torch.ones(1, 2, 2)
    torch.manual_seed(seed)
    assert kit_loss(logits, *arguments) < kit_loss(logits + torch.randn_like(logits), *arguments)


def test_seen_cells_and_layers_seen_free_do_not_count_in_the_loss() -> None:
    logits = torch.randn(2, DEEPEST, 4, 4, requires_grad=True)
    least, depth = torch.full((2, 4, 4), 5.0), torch.full((2, 4, 4), 9.5)
    seen = torch.rand(2, 4, 4) < 0.5
    kit_loss(logits, least, seen, depth, torch.ones(2, 4, 4)).backward()
    assert logits.grad is not None
    gradient = logits.grad.permute(0, 2, 3, 1)
    assert (gradient[seen] == 0).all()
    assert (gradient[..., :5] == 0).all()
    assert (gradient[~seen][:, 5:] != 0).all()
    nothing = kit_loss(logits, least, torch.ones_like(seen), depth, torch.ones(2, 4, 4))
    assert float(nothing.detach()) == 0


@pytest.mark.parametrize("blind", ["no return", "another label", "from below"])
def test_an_image_that_shows_nothing_of_a_plate_leaves_all_hidden(blind: str) -> None:
    image, plate = plate_image(Pose.identity()), Plane(np.array([0.0, 0.0, 1.0]), np.zeros(3), 0.0)
    if blind == "no return":
        image = replace(image, view=replace(image.view, depth=np.zeros_like(image.view.depth)))
    elif blind == "another label":
        image = replace(image, labels=np.zeros_like(image.labels))  # beside a plate all is seen free
    else:
        plate = replace(plate, point=np.array([0.0, 0.0, 1.0]))  # above the camera
    relief = seen_heights(image, plate, plate.point, IDEAL.noise)
    assert np.isfinite(relief.least).all()
    assert np.isfinite(relief.camera).all()
    truth = true_depths(tray(), Pose.identity(), relief.world_from_plate)
    assert not relief.seen[truth < DEEPEST].any()
    depths = KitCompleter(network())(relief).depths
    assert np.isfinite(depths).all()
    assert depths.shape == (CELLS, CELLS)


def test_a_camera_on_the_normal_has_a_frame_too() -> None:
    view = plate_image(Pose.identity())
    below = view.view.world_from_camera.xyz * (1, 1, 0)
    relief = seen_heights(view, Plane(np.array([0.0, 0.0, 1.0]), np.zeros(3), 0.0), below, IDEAL.noise)
    assert relief.camera[0] == pytest.approx(0, abs=1e-6)
    np.testing.assert_allclose(relief.world_from_plate.rotate((0, 0, 1)), (0, 0, 1), atol=1e-12)


def test_fresh_views_are_the_same_whoever_makes_them_and_truth_is_below_what_is_seen_free(mini: Path) -> None:
    task = kit_completion_task(Dataset(mini), "small", WEIGHTS / "restoration")
    again = kit_completion_task(Dataset(mini), "small", WEIGHTS / "restoration")
    draws = [stream(task.training.seed, "kit-completion", index).random() for index in range(40)]
    for index in (int(np.argmin(draws)), int(np.argmax(draws))):  # by the d415, and ideal
        view, same = task.training.view(index), again.training.view(index)
        assert all(np.array_equal(view[name], same[name]) for name in view)
        twice = mirrored(mirrored(view))
        assert all(np.array_equal(view[name], twice[name]) for name in view)
        wrong = np.abs(view["least"] - view["depth"])[view["seen"] & view["plate"]]
        noisy = draws[index] < D415_SHARE
        assert 0.1 < np.median(wrong) < 3 if noisy else np.median(wrong) < 0.1
        assert (view["least"] < view["depth"] + 2)[view["plate"]].mean() > 0.9


def test_the_measure_is_zero_for_the_truth_and_validation_examples_are_kept(mini: Path) -> None:
    task = kit_completion_task(Dataset(mini), "small", WEIGHTS / "restoration")
    keys = task.validation_keys()
    assert {key.sensor for key in keys} == {"ideal", "d415"}
    example = task.validation_example(keys[0])
    assert task.validation_example(task.validation_keys()[0]) is example
    batch = {name: torch.from_numpy(value)[None] for name, value in example.items()}
    share = (batch["depth"][:, None] - torch.arange(DEEPEST).view(1, -1, 1, 1)).clamp(1e-4, 1 - 1e-4)
    task.model.forward = lambda *_: torch.logit(share)  # type: ignore[method-assign]
    assert float(task.measure(batch)["hidden_mm"]) < 0.15
    truth = float(task.loss(batch))
    task.model.forward = lambda *_: 0 * share  # type: ignore[method-assign]
    assert truth < 0.1 * float(task.loss(batch))


@pytest.fixture(scope="module")
def kit() -> Kit:
    return drawn_kit(5, 0)


def test_fresh_kits_are_the_same_whoever_makes_them_and_change_one_plate_alone(kit: Kit) -> None:
    kits = [kit, drawn_kit(5, 1), drawn_kit(5, 2)]
    assembly = build_assembly("a", kits[:2], AssemblyPlan(0.1, 0.4, (SidePlate(1, 0.3),)))
    assert np.array_equal(kit.mesh.vertices, drawn_kit(5, 0).mesh.vertices)
    for each in kits:
        assert np.ptp(each.mesh.vertices, axis=0) == pytest.approx(each.extent, abs=1e-6)
    for number in range(2):
        changed, old = with_kit(assembly, number, kits[2]), assembly.mounts[number].kit
        assert [mount.kit is kits[2] for mount in changed.mounts] == [k == number for k in range(2)]
        cut = old.mesh.volume - kits[2].mesh.volume  # its own cavity is all that changes
        assert assembly.mesh.volume - changed.mesh.volume == pytest.approx(cut, abs=2e-9)


@given(factors=st.tuples(*(st.floats(*map(float, bounds)) for bounds in STRETCH)))
def test_a_stretched_kit_is_printable_and_its_cavity_is_as_much_larger(kit: Kit, factors: tuple[float, ...]) -> None:
    changed = stretched(kit, np.array(factors))
    assert defect_float32(changed.mesh) is None
    sizes = [np.ptp(one.mesh.vertices, axis=0) for one in (kit, changed)]
    assert sizes[1] == pytest.approx(sizes[0] * (*factors[:2], 1.0), abs=1e-9)
    cavities = [np.prod(size) - one.mesh.volume for size, one in zip(sizes, (kit, changed), strict=True)]
    assert cavities[1] == pytest.approx(cavities[0] * np.prod(factors), rel=1e-6)


def test_a_cavity_is_not_stretched_through_its_plate(kit: Kit) -> None:
    with pytest.raises(InputError, match="underside"):
        stretched(kit, np.array([1.0, 1.0, 4.0]))
