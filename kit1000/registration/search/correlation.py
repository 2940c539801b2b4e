"""The coarse search: over the part's faces, yaws about the plate's normal and, by FFT, all positions on the plate."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.ndimage import minimum_filter

from kit1000.kits.cavity import insertion_depth
from kit1000.numerics.compiled import compiled
from kit1000.numerics.linear_algebra import matmul
from kit1000.pose import Pose, quaternion_between
from kit1000.queries.motions import apply_error
from kit1000.registration.geometry.expected_relief import expected_relief
from kit1000.registration.geometry.height_images import dilated, image_cells, lower_envelope
from kit1000.registration.geometry.observed_cavity import VOXEL, Cavity
from kit1000.voxels import Volume

CELL = 1.25e-3  # [m] of the images that are compared: half the usual clearance
YAW_STEP = np.radians(6)
PEAKS = 3  # positions kept for each yaw
PEAK_DISTANCE = 5  # cells between them
DUPLICATE_DISTANCE = 4e-3  # [m] candidates nearer than this, at nearly the same rotation, are refined to the same pose
DEPTH_TOLERANCE = 1e-3  # [m] by which an observed floor may be shallower than expected and still be the floor
UPRIGHT = -0.99  # z of a normal that points down at the table
UP = np.array([0.0, 0.0, 1.0])
YAW_DECIMALS = 12  # of the quaternions of the yaws: sine and cosine differ between processors in the last bit
MISFIT_DECIMALS = 9  # candidates whose misfits are equal on this grid are taken in order
ORDER = 1e-14  # added from cell to cell, in all less than that grid: of equal cells the first is the lowest


@dataclass(frozen=True, eq=False)
class Candidate:
    """A pose found by the coarse search."""

    cavity: Cavity
    plate_from_now: Pose
    """Takes the part from where it lies into the cavity."""
    down_normal: np.ndarray
    """(3,) unit, world, the part as it lies now: outward normal of the face that goes onto the cavity's floor."""
    depth_difference: float
    """[m] between the cavity's depth and the depth that a kit for this part has."""
    misfit: float
    """Squared difference of the reliefs over that of an empty plate: 0 fits, 1 explains nothing."""
    seen: bool = True
    """Whether the volume of the part has the face that goes onto the cavity's floor."""


def tilted(candidate: Candidate, middle: np.ndarray, angle: float) -> list[Candidate]:
    """A candidate tilted to either side about both axes of the plate by an angle [rad]; none where that is 0.

    Another face then goes onto the floor, which may be one that no image shows. middle: (3,) [m] world, of the part.
    """
    tilts = ((angle, 0, 0), (-angle, 0, 0), (0, angle, 0), (0, -angle, 0)) if angle else ()
    poses = [apply_error(candidate.plate_from_now, middle, np.zeros(3), np.array(tilt)) for tilt in tilts]
    return [replace(candidate, plate_from_now=pose, down_normal=pose.inverse().rotate(-UP)) for pose in poses]


@dataclass(frozen=True, eq=False)
class SearchWindow:
    """Bounds of the search about a guess; without a guess there are none."""

    pivot: np.ndarray
    """(3,) [m] world: the middle of the part now."""
    guess: Pose | None
    """goal_from_now, world."""
    angle: float
    """[rad] most from the guess."""
    offset: float
    """[m] most along each axis of the world, of the pivot's position from the guessed one."""

    def rotations_inside(self, rotations: Pose, plate_from_world: Pose) -> np.ndarray:
        """(k,) bool: which rotations (k,) plate_from_now are within `angle` of the guess, plus half a YAW_STEP."""
        if self.guess is None:
            return np.ones(len(rotations), bool)
        guessed = Pose((plate_from_world @ self.guess).wxyz, np.zeros(3))
        return (rotations @ guessed.inverse()).angle() <= self.angle + YAW_STEP / 2

    def positions_inside(self, world_from_plate: Pose, positions: np.ndarray) -> np.ndarray | bool:
        """(...,) bool: which positions (..., 3) [m] of the pivot, plate frame, are within `offset` of the guess."""
        if self.guess is None:
            return True
        guessed = self.guess.apply(self.pivot)
        return np.all(np.abs(world_from_plate.apply(positions) - guessed) <= self.offset, axis=-1)


def lies_on(down_normal: np.ndarray) -> bool:
    """Whether a part lies on its face of this outward normal (3,) in the world."""
    return bool(down_normal[2] < UPRIGHT)


def coarse_search(
    part: Volume,
    middle: np.ndarray,
    down_normals: Sequence[np.ndarray],
    cavities: Sequence[Cavity],
    clearance: float,
    window: SearchWindow,
    height: float | None = None,
) -> list[Candidate]:
    """All candidates, the best first: any of the part's faces down in any of the cavities, within the window.

    Args:
        part: as it lies now.
        middle: (3,) [m] world, of the part.
        down_normals: (3,) unit, world, each: outward normals of the faces that may go onto the floor.
        cavities: of all plates.
        clearance: [m]
        window: about the guess.
        height: [m] of the part as it lies, where that is known; by default that of its volume.
    """
    candidates: list[Candidate] = []
    kits: dict[tuple[int, float], KitImage] = {}
    occupied = part.grid.world(np.argwhere(part.occupied))
    for down_normal in down_normals:
        oriented = OrientedPart(part, middle, down_normal)
        upright = lies_on(down_normal)
        tall = height if upright and height is not None else float(np.ptp(matmul(occupied, down_normal)))
        expected = insertion_depth(tall)
        for number, whole in enumerate(cavities):
            inside = np.flatnonzero(window.rotations_inside(oriented.rotations, whole.world_from_plate.inverse()))
            for cavity in _possible_depths(whole, expected, upright) if len(inside) else ():
                key = (number, cavity.depth)
                if key not in kits:
                    kits[key] = KitImage.of(cavity, image_cells(part, clearance, CELL))
                for yaw in inside.tolist():
                    about, envelope = oriented.at_yaw(yaw, clearance)
                    if np.isfinite(envelope).any():
                        for shift, misfit in best_shifts(
                            kits[key], envelope, cavity, window, about.apply(window.pivot)
                        ):
                            pose = Pose(about.wxyz, about.xyz + shift)
                            difference = abs(cavity.depth - expected)
                            candidates.append(Candidate(cavity, pose, down_normal, difference, misfit))
    return sorted(candidates, key=lambda candidate: candidate.misfit)


class OrientedPart:
    """A part with one of its faces down, at every yaw; its envelopes are computed once for all plates."""

    def __init__(self, part: Volume, middle: np.ndarray, down_normal: np.ndarray) -> None:
        self.part = part
        self.middle = middle
        half_yaws = np.arange(0, 2 * np.pi, YAW_STEP)[:, None] / 2
        yaws = Pose((np.cos(half_yaws) * (1, 0, 0, 0) + np.sin(half_yaws) * (0, *UP)).round(YAW_DECIMALS), np.zeros(3))
        face_down = Pose(quaternion_between(down_normal, -UP), np.zeros(3))
        self.rotations = yaws @ face_down
        self._envelopes: dict[int, tuple[Pose, np.ndarray]] = {}

    def at_yaw(self, yaw: int, clearance: float) -> tuple[Pose, np.ndarray]:
        """The rotation about the part's middle at a yaw, by its index, and the dilated envelope (n, n) [m]."""
        if yaw not in self._envelopes:
            about = self.rotations[yaw] @ Pose.from_translation(-self.middle)
            envelope = lower_envelope(self.part, about, CELL, image_cells(self.part, clearance, CELL))
            self._envelopes[yaw] = (about, dilated(envelope, CELL, clearance))
        return self._envelopes[yaw]


def without_duplicates(candidates: Sequence[Candidate], pivot: np.ndarray, most: int) -> list[Candidate]:
    """The first `most` candidates (best first) of every plate that differ in position, rotation or depth.

    Of every plate, because misfits of cavities that are hidden to different degrees cannot be compared; the residuals
    after refinement can.
    """
    if not candidates:
        return []
    frames = (
        Pose.stack([c.cavity.world_from_plate for c in candidates]),
        Pose.stack([c.plate_from_now for c in candidates]),
    )
    poses = frames[0] @ frames[1]
    pivots, depths = poses.apply(pivot), np.array([c.cavity.depth for c in candidates])
    plates = np.array([id(c.cavity.world_from_plate) for c in candidates])
    left = np.ones(len(candidates), bool)
    kept: list[Candidate] = []
    while left.any():
        n = int(np.argmax(left))
        kept.append(candidates[n])
        same = plates == plates[n]
        near = same & left & (np.abs(depths - depths[n]) <= DEPTH_TOLERANCE)
        near[near] = np.linalg.norm(pivots[near] - pivots[n], axis=-1) <= DUPLICATE_DISTANCE
        near[near] = (poses[near] @ poses[n].inverse()).angle() < 1.5 * YAW_STEP
        left &= ~near
        left[n] = False
        if sum(other.cavity.world_from_plate is candidates[n].cavity.world_from_plate for other in kept) == most:
            left &= ~same
    return kept


def _possible_depths(cavity: Cavity, expected: float, certain: bool) -> list[Cavity]:
    """The cavity with its observed depth and, where its floor may be hidden, with the expected depth [m].

    certain: the expected depth is well known, because the part lies as it will be inserted and shows its height.
    """
    hidden = np.isnan(cavity.relief[cavity.region]).any()
    if not hidden or expected <= cavity.depth + DEPTH_TOLERANCE:
        return [cavity]
    return [replace(cavity, depth=expected)] if certain else [cavity, replace(cavity, depth=expected)]


@dataclass(frozen=True, eq=False)
class KitImage:
    """The expected relief of a plate at CELL, as Fourier transforms."""

    cells: int
    size: int
    """Size of the transforms: no less than the cells."""
    weighted_relief: np.ndarray
    """Transform of the relief times its trust."""
    trust: np.ndarray
    """Transform of the trust."""
    empty: float
    """Sum of squared heights without a part."""

    @classmethod
    def of(cls, cavity: Cavity, part_cells: int) -> KitImage:
        """Sampled at the nearest cells, enough for a search. part_cells: across the images of the part."""
        cells = int(len(cavity.relief) * VOXEL / CELL)
        size = int(next_fast_len(max(cells, part_cells), real=True) or cells)
        at = np.rint((np.arange(cells) - (cells - 1) / 2) * CELL / VOXEL + (len(cavity.relief) - 1) / 2).astype(int)
        relief, trust = (image[np.ix_(at, at)] for image in expected_relief(cavity))
        return cls(
            cells, size, _spectrum(trust * relief, size), _spectrum(trust, size), float((trust * relief**2).sum())
        )


def best_shifts(
    kit: KitImage, envelope: np.ndarray, cavity: Cavity, window: SearchWindow, pivot: np.ndarray
) -> Iterator[tuple[np.ndarray, float]]:
    """The best shifts (3,) [m] in the plate frame of a part with this dilated envelope, and their misfits.

    pivot: (3,) [m] of the part before it is shifted.

    The misfit at a shift t is the sum over all cells x of trust(x) (relief(x) - cut(x - t))^2, over that without a
    part. Multiplied out it takes two correlations.
    """
    if kit.empty == 0:  # a cavity between two cells
        return
    lowest = float(envelope.min())
    cut = np.minimum(envelope - lowest - cavity.depth, 0)
    squares, heights = (_spectrum(image, kit.size) for image in (cut**2, 2 * cut))
    product = np.empty_like(squares)
    correlate(kit.trust, squares, kit.weighted_relief, heights, product)
    misfit = (1 + np.asarray(irfft2(product, (kit.size, kit.size))) / kit.empty).round(MISFIT_DECIMALS)
    steps = np.arange(kit.size)
    middle = (kit.cells - len(envelope)) / 2  # the step that puts the middle of one image on that of the other
    axis = (np.where(steps > middle + kit.size / 2, steps - kit.size, steps) - middle) * CELL
    z = -cavity.depth - lowest
    if window.guess is not None:
        shifts = np.stack(np.broadcast_arrays(axis[:, None], axis[None], z), axis=-1)
        misfit = np.where(window.positions_inside(cavity.world_from_plate, shifts + pivot), misfit, np.inf)
    ordered = misfit + ORDER * np.arange(misfit.size).reshape(misfit.shape)
    low = (ordered == minimum_filter(ordered, 2 * PEAK_DISTANCE + 1, mode="wrap")) & np.isfinite(misfit)
    i, j = np.nonzero(low)
    best = np.argsort(ordered[i, j], kind="stable")[:PEAKS]
    for a, b in zip(i[best], j[best], strict=True):
        yield np.array([axis[a], axis[b], z]), float(misfit[a, b])


@compiled
def correlate(a, b, c, d, product):
    """Fill a spectrum (m, n) complex with a times the conjugate of b, less c times that of d.

    By real products: those of numpy are rounded differently on processors with FMA.
    """
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            s, t, u, v = a[i, j], b[i, j], c[i, j], d[i, j]
            real = (s.real * t.real + s.imag * t.imag) - (u.real * v.real + u.imag * v.imag)
            imag = (s.imag * t.real - s.real * t.imag) - (u.imag * v.real - u.real * v.imag)
            product[i, j] = complex(real, imag)


def _spectrum(image: np.ndarray, size: int) -> np.ndarray:
    return np.asarray(rfft2(image, (size, size)))
