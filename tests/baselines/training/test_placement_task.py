"""Examples of placement: their changes agree with moves of the fit, and fits are kept in files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from baselines.training.tasks.placement import (
    BORDER,
    IN_PLATE,
    LARGEST_SHIFT,
    MM,
    Changes,
    PlacedFits,
    changed,
    drawn_changes,
    no_changes,
    placement_task,
)
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.perception.placement import CELLS, Channel
from kit1000.pose import Pose
from kit1000.registration.image_refine import PlatePatch, plate_patch
from kit1000.registration.prepared_image import RestoredImage
from kit1000.registration.search import Candidate
from kit1000.weights import WEIGHTS
from tests.samples.registration_cases import CLEARANCE, case, known_shape
from tests.samples.registration_images import CAMERA, image_of, moved

NAME = "an L"


def patch_of(fit: Candidate, cells: int) -> PlatePatch:
    """The patch of a fit of the known part in its exact image."""
    image, part = image_of(NAME), known_shape(case(NAME).part, case(NAME).pivot)
    patch = plate_patch(part, RestoredImage(image, image, CAMERA.fx * 0.055), fit, CLEARANCE, cells)
    assert patch is not None
    return patch


def patch_at(x_mm: float, y_mm: float, yaw_deg: float, cells: int = CELLS) -> tuple[PlatePatch, np.ndarray]:
    """The patch of a fit that far from the goal in the plate, and its move to the goal."""
    known = case(NAME)
    fit = moved(known, x_mm, y_mm, yaw_deg)
    patch = patch_of(fit, cells)
    goal_from_now = fit.cavity.world_from_plate @ fit.plate_from_now
    return patch, MM * patch.twist_to(known.goal, goal_from_now, known.pivot)[IN_PLATE].astype(np.float32)


def apply(patch: PlatePatch, move: np.ndarray, **changes: np.ndarray) -> tuple[Tensor, Tensor]:
    every = no_changes() | {name: np.asarray(value, no_changes()[name].dtype) for name, value in changes.items()}
    batch = Changes(*(torch.from_numpy(every[name])[None] for name in Changes._fields))
    return changed(torch.from_numpy(patch.channels)[None], torch.from_numpy(move)[None], batch)


def wide(x_mm: float = 0.0, y_mm: float = 0.0, yaw_deg: float = 0.0) -> tuple[PlatePatch, np.ndarray]:
    return patch_at(x_mm, y_mm, yaw_deg, CELLS + 2 * BORDER)


def test_without_changes_the_border_is_cut_off() -> None:
    patch, move = wide(1.0, -1.0, 2.0)
    seen, true = apply(patch, move)
    np.testing.assert_allclose(seen[0].numpy(), patch.channels[:, BORDER:-BORDER, BORDER:-BORDER], atol=2e-5)
    np.testing.assert_array_equal(true[0].numpy(), move)


@pytest.mark.parametrize("shift_mm", [(2.0, 0.0), (0.0, -2.0), (1.0, 1.5)])
def test_a_shifted_fit_is_the_cavity_there(shift_mm: tuple[float, float]) -> None:
    """The cavity of a changed fit is that of a fit which lies there, and what the image shows of it stays."""
    here, move = wide()
    along = here.world_from_patch.rotate((*shift_mm, 0.0)) * 1e-3
    at_goal = moved(case(NAME), 0, 0, 0)
    plate = at_goal.cavity.world_from_plate.inverse()
    there = replace(at_goal, plate_from_now=Pose.from_translation(plate.rotate(along)) @ at_goal.plate_from_now)
    patch = patch_of(there, CELLS)
    seen, true = apply(here, move, shift=np.array(shift_mm))
    np.testing.assert_allclose(true[0].numpy() - move, [0, -shift_mm[0], -shift_mm[1]], atol=1e-5)
    x, y = np.array(shift_mm).round().astype(int)
    whole = np.roll(patch.channels[Channel.HEIGHTS], (x, y), (0, 1))
    middle = np.s_[10:-10, 10:-10]
    if (np.array(shift_mm) == (x, y)).all():
        assert np.abs(seen[0, Channel.HEIGHTS].numpy() - whole)[middle].mean() < 0.2e-3
    np.testing.assert_allclose(seen[0, Channel.RESTORED].numpy(), apply(here, move)[0][0, Channel.RESTORED].numpy())


def test_a_rotated_fit_has_its_rotation_left_to_undo() -> None:
    patch, move = wide()
    _, true = apply(patch, move, yaw=np.array(0.05))
    np.testing.assert_allclose(true[0].numpy() - move, [-20 * 0.05, 0, 0], atol=1e-5)


def test_the_cavity_rotates_with_the_fit() -> None:
    turned, (here, move) = patch_at(0, 0, 8.0)[0], wide()
    seen, _ = apply(here, move, yaw=np.array(np.radians(8.0)))
    cavity = turned.channels[Channel.HEIGHTS]
    still = here.channels[Channel.HEIGHTS, BORDER:-BORDER, BORDER:-BORDER]
    assert np.abs(seen[0, Channel.HEIGHTS].numpy() - cavity).mean() < 0.5 * np.abs(still - cavity).mean()


def test_seen_from_aside_the_move_is_in_the_other_frame() -> None:
    patch, move = wide(1.5, -0.5, 3.0)
    _, true = apply(patch, move, aside=np.array(np.pi / 2))
    np.testing.assert_allclose(true[0].numpy(), move[[0, 2, 1]] * [1, 1, -1], atol=1e-4)


def test_changes_are_drawn_and_those_of_validation_are_none() -> None:
    drawn = [drawn_changes(np.random.default_rng(seed)) for seed in range(200)]
    assert 0.35 < np.mean([each["mirrored"] for each in drawn]) < 0.65
    assert 0.5 < np.std([each["shift"] for each in drawn]) < 0.9
    assert not any(value.any() for value in no_changes().values())


def test_fits_are_kept_in_files(mini: Path, tmp_path: Path) -> None:
    task = placement_task(Dataset(mini), "small", WEIGHTS / "completion-d415", WEIGHTS / "restoration")
    registration = task.training.registration
    drawn = PlacedFits(registration, "train", tmp_path).draw(np.random.default_rng(0))
    assert drawn.channels.shape == (len(Channel), CELLS + 2 * BORDER, CELLS + 2 * BORDER)
    assert np.abs(drawn.twist[3:5]).max() <= LARGEST_SHIFT
    files = {path: path.read_bytes() for path in tmp_path.rglob("output.pkl")}
    again = PlacedFits(registration, "train", tmp_path).draw(np.random.default_rng(0))
    np.testing.assert_array_equal(again.channels, drawn.channels)
    np.testing.assert_array_equal(again.twist, drawn.twist)
    assert {path: path.read_bytes() for path in tmp_path.rglob("output.pkl")} == files


def test_a_split_without_queries_of_the_track_says_so(mini: Path, tmp_path: Path) -> None:
    task = placement_task(Dataset(mini), "small", WEIGHTS / "completion-d415", WEIGHTS / "restoration")
    fits = PlacedFits(task.training.registration, "train", tmp_path)
    fits.__dict__["queries"] = {}
    with pytest.raises(InputError, match="no query of snap-d415"):
        fits.draw(np.random.default_rng(0))
