"""The coarse search of registration against brute force, and refinement from near a known pose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kit1000.kits.cavity import insertion_depth
from kit1000.mesh import mesh_from_solid
from kit1000.pose import Pose
from kit1000.queries.guesses import MAX_ANGLE, MAX_OFFSET
from kit1000.registration.geometry.cavity import Cavity
from kit1000.registration.geometry.height_maps import dilated, expected_heights
from kit1000.registration.search import CELL, UP, KitSpectrum, SearchWindow, best_shifts, coarse_search
from kit1000.voxels import Grid, signed_distance
from tests.samples.registration_cases import CLEARANCE, WORLD_FROM_KIT, case, known_cavity
from tests.samples.shapes import box

# search


def random_cavity(seed: int, hidden: bool = False) -> Cavity:
    """A small plate with a pit of random heights, part of it hidden or not."""
    rng = np.random.default_rng(seed)
    heights = np.zeros((40, 40))
    heights[10:30, 12:28] = rng.uniform(-0.01, -0.003, (20, 16))
    cavity = known_cavity(heights, depth=0.01)
    if not hidden:
        return cavity
    partial = heights.copy()
    partial[12:20, 14:20] = np.nan
    return replace(cavity, heights=partial)


def random_envelope(seed: int, n: int = 20) -> np.ndarray:
    """(n, n) [m]: a lower envelope of random heights."""
    rng = np.random.default_rng(seed)
    heights = np.full((n, n), np.inf)
    heights[5:14, 4:15] = rng.uniform(-0.02, -0.004, (9, 11))
    return heights


def brute_misfits(cavity: Cavity, kit: KitSpectrum, envelope: np.ndarray) -> np.ndarray:
    """(size, size): the misfit at every whole shift, cell by cell; cells off the plate do not count."""
    picks = np.rint((np.arange(kit.cells) - (kit.cells - 1) / 2) * CELL / 1e-3 + (len(cavity.heights) - 1) / 2)
    heights, trust = (image[np.ix_(picks.astype(int), picks.astype(int))] for image in expected_heights(cavity))
    cut = np.minimum(dilated(envelope, CELL, CLEARANCE) - envelope.min() - cavity.depth, 0)
    m, n = len(cut), kit.cells
    misfits = np.ones((kit.size, kit.size))  # without overlap a part explains nothing
    for s in range(-m, n + 1):
        for t in range(-m, n + 1):
            image = np.zeros((n + 2 * m, n + 2 * m))
            image[s + m : s + 2 * m, t + m : t + 2 * m] = cut
            inside = image[m : m + n, m : m + n]
            misfits[s, t] = (trust * (heights - inside) ** 2).sum() / (trust * heights**2).sum()
    return misfits


@pytest.mark.parametrize(("seed", "hidden"), [(0, False), (1, False), (2, True)])
def test_the_best_shifts_are_those_of_brute_force(seed: int, hidden: bool) -> None:
    cavity, envelope = random_cavity(seed, hidden), random_envelope(seed)
    kit = KitSpectrum.of(cavity, 72)
    every = brute_misfits(cavity, kit, envelope)
    anywhere = SearchWindow(np.zeros(3), None, MAX_ANGLE, MAX_OFFSET)
    found = list(best_shifts(kit, dilated(envelope, CELL, CLEARANCE), cavity, anywhere, np.zeros(3)))
    assert found[0][1] == pytest.approx(every.min(), abs=1e-9)
    assert [misfit for _, misfit in found] == sorted(misfit for _, misfit in found)
    for shift, misfit in found:
        np.testing.assert_allclose(shift[2], -cavity.depth - envelope.min(), atol=1e-12)  # down on the floor
        # Cell i of the envelope is on cell i + s of the plate.
        s, t = np.rint(shift[:2] / CELL + (kit.cells - len(envelope)) / 2).astype(int)
        np.testing.assert_allclose((np.array([s, t]) - (kit.cells - len(envelope)) / 2) * CELL, shift[:2], atol=1e-12)
        assert misfit == pytest.approx(every[s, t], abs=1e-9)


def test_a_cavity_between_two_cells_has_no_shift() -> None:
    cavity, envelope = random_cavity(0), random_envelope(0)
    flat = replace(KitSpectrum.of(cavity, 72), empty=0.0)
    anywhere = SearchWindow(np.zeros(3), None, MAX_ANGLE, MAX_OFFSET)
    assert not list(best_shifts(flat, dilated(envelope, CELL, CLEARANCE), cavity, anywhere, np.zeros(3)))


def test_no_shift_leaves_the_window() -> None:
    """And the best inside the window is that of brute force there."""
    cavity, envelope = replace(random_cavity(0), world_from_plate=WORLD_FROM_KIT), random_envelope(0)
    kit = KitSpectrum.of(cavity, 72)
    every = brute_misfits(cavity, kit, envelope)
    z = -cavity.depth - envelope.min()
    pivot = np.array([3e-3, -2e-3, 1e-3])  # before the shift
    guessed = WORLD_FROM_KIT.apply(pivot + [0.006, -0.008, z])
    window = SearchWindow(np.zeros(3), Pose.from_translation(guessed), MAX_ANGLE, 4e-3)
    found = list(best_shifts(kit, dilated(envelope, CELL, CLEARANCE), cavity, window, pivot))
    assert found
    for shift, _ in found:
        assert np.abs(WORLD_FROM_KIT.apply(pivot + shift) - guessed).max() <= 4e-3 + 1e-12
    steps = np.arange(kit.size)
    axis = (np.where(steps > kit.size // 2, steps - kit.size, steps) - (kit.cells - len(envelope)) / 2) * CELL
    at = np.stack(np.broadcast_arrays(axis[:, None], axis[None], z), axis=-1)
    inside = (np.abs(WORLD_FROM_KIT.apply(pivot + at) - guessed) <= 4e-3).all(-1)
    assert found[0][1] == pytest.approx(every[inside].min(), abs=1e-9)


def test_a_hidden_floor_is_sought_as_deep_as_the_known_height_of_the_part_tells() -> None:
    known = case("a bar")
    heights = np.where(known.cavity.region, np.nan, known.cavity.heights)
    hidden = replace(known.cavity, heights=heights, depth=3e-3)
    window = SearchWindow(np.zeros(3), None, 0.0, 0.0)
    around = Grid.centred(Pose.identity(), (84, 84, 84), 1e-3)
    upright = signed_distance(around, [(mesh_from_solid(box(44, 14, 20)).scaled(1e-3), Pose.identity())], threads=1)

    def depths(height: float | None) -> set[float]:
        found = coarse_search(upright, np.zeros(3), [-UP], [hidden], CLEARANCE, window, height)
        return {each.cavity.depth for each in found}

    assert depths(30e-3) == {insertion_depth(30e-3)}
    (by_volume,) = depths(None)
    assert by_volume == pytest.approx(insertion_depth(20e-3), abs=0.7e-3)
