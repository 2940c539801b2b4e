"""The coarse search: over faces to stand on, turns about the plate's normal and, by FFT, all places on the plate."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.ndimage import minimum_filter

from baselines.registration.cavity import VOXEL, Cavity
from baselines.registration.outline import expected
from baselines.registration.relief import grown, lower_envelope
from kit1000.pose import Pose, quaternion_between
from kit1000.voxels import Volume

CELL = 1.25e-3  # [m] of the images that are compared: half the usual clearance
WIDE = 72  # cells of the part's image: 90 mm hold any part of 50 mm at any turn
TURN_STEP = np.radians(6)
PEAKS = 3  # places kept of each turn
APART = 5  # cells between them
NEIGHBOUR = 4e-3  # [m] candidates nearer than this, at nearly the same turn, end in the same place when refined
DEEPEST, SUNK = 20e-3, 0.6  # [m] and share of its height by which a part sinks into its kit
SHALLOWER = 1e-3  # [m] by which the floor that was seen may be no floor
UPRIGHT = -0.99  # z of a normal that looks down at the table
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Candidate:
    """A place found by the coarse search."""

    cavity: Cavity
    plate_from_now: Pose
    """Carries the part, as it lies now, into the cavity."""
    down: np.ndarray
    """(3,) unit, world: the normal of the face that looks into the cavity, the part as it lies now."""
    surprise: float
    """[m] by which the cavity is deeper or less deep than kits for such a part are made."""
    misfit: float
    """Squared difference of the reliefs over that of an empty plate: 0 fits, 1 explains nothing."""


@dataclass(frozen=True, eq=False)
class Window:
    """Where to look: at most so far from a guess, or everywhere without one."""

    pivot: np.ndarray
    """(3,) [m] world: the middle of the part now."""
    guess: Pose | None
    """goal_from_now, world."""
    turn: float
    """[rad] most from the guess."""
    offset: float
    """[m] most along each axis of the world, of where the pivot goes."""

    def allows(self, rotations: Pose, plate_from_world: Pose) -> np.ndarray:
        """(k,) bool: which rotations (k,) plate_from_now stay within `turn` of the guess, or half a step beyond."""
        if self.guess is None:
            return np.ones(len(rotations), bool)
        meant = Pose((plate_from_world @ self.guess).wxyz, np.zeros(3))
        return (rotations @ meant.inverse()).angle() <= self.turn + TURN_STEP / 2

    def holds(self, world_from_plate: Pose, places: np.ndarray) -> np.ndarray | bool:
        """(...,) bool: which places (..., 3) [m] of the pivot in the plate frame are near enough."""
        if self.guess is None:
            return True
        home = self.guess.apply(self.pivot)
        return np.all(np.abs(world_from_plate.apply(places) - home) <= self.offset, axis=-1)


def coarse_search(
    part: Volume,
    middle: np.ndarray,
    downs: Sequence[np.ndarray],
    cavities: Sequence[Cavity],
    clearance: float,
    window: Window,
) -> list[Candidate]:
    """All candidates, the best first: one of the normals `downs` (3,) of the part, world, into one of the cavities.

    middle: (3,) [m] world, of the part.
    """
    found: list[Candidate] = []
    kits: dict[tuple[int, float], KitImage] = {}
    inside = part.grid.world(np.argwhere(part.occupied))
    for down in downs:
        lying = Lying(part, middle, down)
        made = depth_made(inside, down)
        for number, whole in enumerate(cavities):
            allowed = np.flatnonzero(window.allows(lying.rotations, whole.world_from_plate.inverse()))
            for cavity in _depths(whole, made, down[2] < UPRIGHT) if len(allowed) else ():
                key = (number, cavity.depth)
                if key not in kits:
                    kits[key] = KitImage.of(cavity)
                for turn in allowed.tolist():
                    about, envelope = lying.seen(turn, clearance)
                    if np.isfinite(envelope).any():
                        for place, misfit in places(kits[key], envelope, cavity, window, about.apply(window.pivot)):
                            pose = Pose.from_translation(place) @ about
                            found.append(Candidate(cavity, pose, down, abs(cavity.depth - made), misfit))
    return sorted(found, key=lambda candidate: candidate.misfit)


class Lying:
    """A part with one of its normals turned down, at every turn about it; its envelopes serve all plates."""

    def __init__(self, part: Volume, middle: np.ndarray, down: np.ndarray) -> None:
        self.part = part
        self.middle = middle
        turns = np.arange(0, 2 * np.pi, TURN_STEP)
        laid = Pose(quaternion_between(down, -UP), np.zeros(3))
        self.rotations = Pose.from_rotvec(turns[:, None] * UP) @ laid
        self._seen: dict[int, tuple[Pose, np.ndarray]] = {}

    def seen(self, turn: int, clearance: float) -> tuple[Pose, np.ndarray]:
        """The pose about the part's middle at a turn, by its number, and the grown envelope (n, n) [m]."""
        if turn not in self._seen:
            about = self.rotations[turn] @ Pose.from_translation(-self.middle)
            self._seen[turn] = (about, grown(lower_envelope(self.part, about, CELL, WIDE), CELL, clearance))
        return self._seen[turn]


def distinct(candidates: Sequence[Candidate], pivot: np.ndarray, most: int) -> list[Candidate]:
    """The first few candidates (best first) of every plate that are no neighbours: another place, turn or depth.

    Of every plate, because misfits of cavities of which more or less was seen cannot be compared; what is left after
    refinement can.
    """
    kept: list[Candidate] = []
    for candidate in candidates:
        same = [other for other in kept if other.cavity.world_from_plate is candidate.cavity.world_from_plate]
        if len(same) < most and not any(_neighbours(candidate, other, pivot) for other in same):
            kept.append(candidate)
    return kept


def _neighbours(a: Candidate, b: Candidate, pivot: np.ndarray) -> bool:
    if abs(a.cavity.depth - b.cavity.depth) > SHALLOWER:
        return False
    one, other = (c.cavity.world_from_plate @ c.plate_from_now for c in (a, b))
    if np.linalg.norm(one.apply(pivot) - other.apply(pivot)) > NEIGHBOUR:
        return False
    return bool((one @ other.inverse()).angle() < 1.5 * TURN_STEP)


def _depths(cavity: Cavity, made: float, sure: bool) -> list[Cavity]:
    """The cavity as deep as it was seen to be and, where its floor may be hidden, as deep as kits are made [m].

    sure: that depth is well known, because the part lies as it will be inserted and shows its height.
    """
    hidden = np.isnan(cavity.relief[cavity.region]).any()
    if not hidden or made <= cavity.depth + SHALLOWER:
        return [cavity]
    return [replace(cavity, depth=made)] if sure else [cavity, replace(cavity, depth=made)]


def depth_made(inside: np.ndarray, down: np.ndarray) -> float:
    """[m] how deep a kit takes a part from places (n, 3) [m] in it, with this normal down: the rule of kits."""
    return min(DEEPEST, SUNK * float(np.ptp(inside @ down)))


@dataclass(frozen=True, eq=False)
class KitImage:
    """The expected relief of a plate at CELL with its transforms."""

    cells: int
    size: int
    """Of the transforms: no less than the cells."""
    weighed: np.ndarray
    """Transform of the relief times its trust."""
    trust: np.ndarray
    """Transform of the trust."""
    empty: float
    """Squared height that a plate without a part leaves unexplained."""

    @classmethod
    def of(cls, cavity: Cavity) -> KitImage:
        """Sampled at the nearest cells, enough for a search."""
        cells = int(len(cavity.relief) * VOXEL / CELL)
        size = int(next_fast_len(max(cells, WIDE), real=True) or cells)
        at = np.rint((np.arange(cells) - (cells - 1) / 2) * CELL / VOXEL + (len(cavity.relief) - 1) / 2).astype(int)
        relief, trust = (image[np.ix_(at, at)] for image in expected(cavity))
        return cls(
            cells, size, _spectrum(trust * relief, size), _spectrum(trust, size), float((trust * relief**2).sum())
        )


def places(
    kit: KitImage, envelope: np.ndarray, cavity: Cavity, window: Window, pivot: np.ndarray
) -> Iterator[tuple[np.ndarray, float]]:
    """The best shifts (3,) [m] in the plate frame of a part with this grown envelope, and their misfits.

    pivot: (3,) [m] of the part before it is shifted.

    The misfit at a shift t is the sum over all cells x of trust(x) (relief(x) - sunk(x - t))^2, over that without a
    part. Multiplied out it takes two correlations.
    """
    lowest = float(envelope.min())
    sunk = np.minimum(envelope - lowest - cavity.depth, 0)
    product = kit.trust * _spectrum(sunk**2, kit.size).conj() - 2 * kit.weighed * _spectrum(sunk, kit.size).conj()
    misfit = kit.empty + np.asarray(irfft2(product, (kit.size, kit.size)))
    steps = np.arange(kit.size)
    middle = (kit.cells - len(envelope)) / 2  # the step that lays the middle of one image on that of the other
    axis = (np.where(steps > middle + kit.size / 2, steps - kit.size, steps) - middle) * CELL
    z = -cavity.depth - lowest
    shifts = np.stack(np.broadcast_arrays(axis[:, None], axis[None], z), axis=-1)
    misfit = np.where(window.holds(cavity.world_from_plate, shifts + pivot), misfit, np.inf)
    low = (misfit == minimum_filter(misfit, 2 * APART + 1, mode="wrap")) & np.isfinite(misfit)
    i, j = np.nonzero(low)
    best = np.argsort(misfit[i, j])[:PEAKS]
    for a, b in zip(i[best], j[best], strict=True):
        yield shifts[a, b], float(misfit[a, b] / kit.empty)


def _spectrum(image: np.ndarray, size: int) -> np.ndarray:
    return np.asarray(rfft2(image, (size, size)))
