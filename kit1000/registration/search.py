"""Search: the candidates for a part, over the cavities of the kits, the faces of the part, yaws and positions.

At each yaw about the plate's normal an FFT compares all positions on the plate. The bounds of the work at the end are
counted and not timed, so that a query gives the same answer on any machine.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import NamedTuple

import numpy as np
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.ndimage import minimum_filter

from kit1000.kits.cavity import insertion_depth
from kit1000.numerics.compiled import compiled
from kit1000.numerics.linear_algebra import matmul
from kit1000.perception.image_kinds import Noise
from kit1000.perception.observed.parts import HALF_WIDTH
from kit1000.pose import Pose, quaternion_between
from kit1000.queries.guesses import MAX_ANGLE, MAX_OFFSET
from kit1000.registration.geometry.cavity import VOXEL, Cavity
from kit1000.registration.geometry.faces import right_angled, squared, standing_faces
from kit1000.registration.geometry.height_maps import dilated, expected_heights, lower_envelope, map_cells
from kit1000.registration.kit_volume import KitCavities
from kit1000.registration.part_volume import PartShape
from kit1000.values import Query
from kit1000.voxels import Volume, surface_points

SLACK_OFFSET, SLACK_ANGLE = 1.5e-3, np.radians(2.5)  # [m], [rad] searched beyond the largest error of a guess
LEAST_SIDE = 0.144  # [m] least width of a plate's map: the range of a guess and half a part on either side
NEAR_GUESS = np.cos(np.radians(15))  # between the guess and a face that explains its tilt
LIES = np.cos(MAX_ANGLE + SLACK_ANGLE)  # between the guess and the face on which the part lies, if the guess allows it
LARGE = 1e-4  # [m^2] a face of this area is tried beside a direction nearly its own
DOWN = np.array([0.0, 0.0, -1.0])
UP = np.array([0.0, 0.0, 1.0])
UPRIGHT = -0.99  # z of a normal that points down at the table

CELL = 1.25e-3  # [m] of the maps that are compared: half the usual clearance
YAW_STEP = np.radians(6)
YAW_DECIMALS = 12  # of the quaternions of the yaws: sine and cosine differ between processors in the last bit
PEAKS = 3  # positions kept for each yaw
PEAK_DISTANCE = 5  # cells between them
DUPLICATE_DISTANCE = 4e-3  # [m] nearer candidates at nearly the same rotation are refined to the same pose
DEPTH_TOLERANCE = 1e-3  # [m] by which an observed floor may be shallower than expected and still be the floor
COST_DECIMALS = 9  # candidates whose costs are equal on this grid are taken in order
ORDER = 1e-14  # added from cell to cell, in all less than that grid: the first of equal cells is the lowest

LARGEST = 0.1  # [m] from the middle of a part to its sides; larger parts are not searched
TRIES = 160.0  # units of work for all candidates of a part that are refined


@dataclass(frozen=True, eq=False)
class Candidate:
    """A pose found by the coarse search."""

    cavity: Cavity
    plate_from_now: Pose
    """Takes the part from where it lies into the cavity."""
    down_normal: np.ndarray
    """(3,) unit, world, the part as it lies now: outward normal of the face that goes onto the cavity's floor."""
    cost: float
    """Squared difference of the height maps over that of an empty plate: 0 fits, 1 explains nothing."""


class Faces(NamedTuple):
    """Faces that may go onto a cavity's floor."""

    normals: list[np.ndarray]
    """(3,) unit, world, each, the part as it lies now."""
    cavities: list[Cavity]
    """Cavities that they may go into."""


def find_candidates(part: PartShape, kits: KitCavities, query: Query, clearance: float) -> list[Candidate]:
    """All candidates for a part, the best first; none if no part or no cavity is observed.

    Args:
        part: as it lies now.
        kits: of the scene.
        query: its guess, if any, bounds the search.
        clearance: [m]
    """
    filled = part.bounds.filled
    if not filled.occupied.any():
        return []
    cavities = kits.within(plate_side(filled, part.middle, clearance))
    if not cavities:
        return []
    window = SearchWindow(query.pivot, query.guess, MAX_ANGLE + SLACK_ANGLE, MAX_OFFSET + SLACK_OFFSET)
    found: list[Candidate] = []
    for faces in faces_down(filled, query.guess, cavities, kits.noise):
        found += coarse_search(filled, part.middle, faces.normals, faces.cavities, clearance, window, part.height)
    return sorted(found, key=lambda candidate: candidate.cost)


def plate_side(part: Volume, middle: np.ndarray, clearance: float) -> float:
    """[m] width of a plate's map that holds the cavity of a part wherever a guess may put it.

    Args:
        part: as it lies now.
        middle: (3,) [m] world, of the part.
        clearance: [m]
    """
    away = part.grid.world(np.argwhere(part.occupied)) - middle
    radius = np.sqrt(np.square(away).sum(-1).max())
    return max(LEAST_SIDE, 2 * float(MAX_OFFSET + SLACK_OFFSET + radius + clearance))


def faces_down(part: Volume, guess: Pose | None, cavities: Sequence[Cavity], noise: Noise) -> list[Faces]:
    """The faces that may go onto a cavity's floor.

    Without a guess the part lies as it is inserted. With one, it is inserted on the face on which it lies, wherever the
    guess allows that: parts seldom stand on two faces less than the error of a guess apart.
    """
    if guess is None:
        return [Faces([DOWN], list(cavities))]
    back = guess.inverse()
    guessed = [back.rotate(cavity.world_from_plate.rotate(DOWN)) for cavity in cavities]
    lies = [bool(matmul(down, DOWN) > LIES) for down in guessed]
    upright, others = list(compress(cavities, lies)), list(compress(cavities, np.logical_not(lies)))
    turned = _turned(part, list(compress(guessed, np.logical_not(lies))), noise)
    return [Faces([DOWN], upright), Faces(turned, others)]


def _turned(part: Volume, guessed: Sequence[np.ndarray], noise: Noise) -> list[np.ndarray]:
    """Normals (3,) of the faces near a guessed direction that a part may be inserted on if it lies on another one.

    They are the faces on which its volume stands, those that right angles add to them, and the guessed directions (3,)
    that no face is near to: as they are, and put upright or level.
    """
    if not guessed:
        return []
    middle, angle = part.grid.world(np.argwhere(part.occupied)).mean(0), noise.angle
    faces = standing_faces(surface_points(part), middle, angle)
    normals = right_angled([DOWN, -DOWN, *(squared(face.normal, noise.square) for face in faces)], angle)
    large = [face.normal for face in faces if face.area >= LARGE]
    normals += [normal for normal in large if not _any_near(normals, normal, np.cos(angle))]
    near = [normal for normal in normals if _any_near(guessed, normal, np.cos(MAX_ANGLE + SLACK_ANGLE + angle))]
    free = [down for down in guessed if not _any_near(near, down, NEAR_GUESS)]
    level = [squared(down, MAX_ANGLE) for down in free]
    free = [down for down, put in zip(free, level, strict=True) if put is not down]
    return [*near, *level, *free]


def _any_near(normals: Sequence[np.ndarray], normal: np.ndarray, least: float) -> bool:
    """Whether the cosine between any of some unit vectors (3,) and another one is above the least."""
    return any(matmul(other, normal) > least for other in normals)


def within_guess_error(goal_from_now: Pose, query: Query) -> bool:
    """Whether a motion is as near to the guess as a goal is; without a guess every motion is."""
    guess, pivot = query.guess, query.pivot
    if guess is None:
        return True
    offset = np.abs(goal_from_now.apply(pivot) - guess.apply(pivot)).max()
    angle = float((goal_from_now @ guess.inverse()).angle())
    return bool(offset <= MAX_OFFSET + 2 * SLACK_OFFSET and angle <= MAX_ANGLE + 2 * SLACK_ANGLE)


@dataclass(frozen=True, eq=False)
class SearchWindow:
    """Bounds of the search about a guess; without a guess nothing is bounded."""

    pivot: np.ndarray
    """(3,) [m] world: the middle of the part now."""
    guess: Pose | None
    """goal_from_now, world."""
    angle: float
    """[rad] largest angle from the guess."""
    offset: float
    """[m] largest distance of the pivot from its guessed place along each axis of the world."""

    def rotations_inside(self, rotations: Pose, plate_from_world: Pose) -> np.ndarray:
        """(k,) bool: which rotations (k,) plate_from_now lie within `angle` and half a YAW_STEP of the guess."""
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
        height: [m] of the part as it lies, if that is known; by default the height of its volume.
    """
    candidates: list[Candidate] = []
    kits: dict[tuple[int, float], KitSpectrum] = {}
    occupied = part.grid.world(np.argwhere(part.occupied))
    for down_normal in down_normals:
        oriented = OrientedPart(part, middle, down_normal)
        upright = bool(down_normal[2] < UPRIGHT)  # the part lies on this face already
        tall = height if upright and height is not None else float(np.ptp(matmul(occupied, down_normal)))
        expected = insertion_depth(tall)
        for number, whole in enumerate(cavities):
            inside = np.flatnonzero(window.rotations_inside(oriented.rotations, whole.world_from_plate.inverse()))
            for cavity in _possible_depths(whole, expected, upright) if len(inside) else ():
                key = (number, cavity.depth)
                if key not in kits:
                    kits[key] = KitSpectrum.of(cavity, map_cells(part, clearance, CELL))
                candidates += _at_yaws(oriented, inside.tolist(), kits[key], cavity, clearance, window)
    return sorted(candidates, key=lambda candidate: candidate.cost)


def _at_yaws(
    oriented: OrientedPart,
    yaws: Sequence[int],
    kit: KitSpectrum,
    cavity: Cavity,
    clearance: float,
    window: SearchWindow,
) -> Iterator[Candidate]:
    """The candidates for a part with one of its faces down in a cavity, at some yaws."""
    for yaw in yaws:
        about, envelope = oriented.at_yaw(yaw, clearance)
        if np.isfinite(envelope).any():
            for shift, cost in best_shifts(kit, envelope, cavity, window, about.apply(window.pivot)):
                yield Candidate(cavity, Pose(about.wxyz, about.xyz + shift), oriented.down_normal, cost)


class OrientedPart:
    """A part with one of its faces down, at every yaw; each envelope is computed once for all plates."""

    def __init__(self, part: Volume, middle: np.ndarray, down_normal: np.ndarray) -> None:
        self.part = part
        self.middle = middle
        self.down_normal = down_normal
        half_yaws = np.arange(0, 2 * np.pi, YAW_STEP)[:, None] / 2
        yaws = Pose((np.cos(half_yaws) * (1, 0, 0, 0) + np.sin(half_yaws) * (0, *UP)).round(YAW_DECIMALS), np.zeros(3))
        face_down = Pose(quaternion_between(down_normal, -UP), np.zeros(3))
        self.rotations = yaws @ face_down
        self._envelopes: dict[int, tuple[Pose, np.ndarray]] = {}

    def at_yaw(self, yaw: int, clearance: float) -> tuple[Pose, np.ndarray]:
        """The rotation about the part's middle at a yaw, by its index, and the dilated envelope (n, n) [m]."""
        if yaw not in self._envelopes:
            about = self.rotations[yaw] @ Pose.from_translation(-self.middle)
            envelope = lower_envelope(self.part, about, CELL, map_cells(self.part, clearance, CELL))
            self._envelopes[yaw] = (about, dilated(envelope, CELL, clearance))
        return self._envelopes[yaw]


def without_duplicates(candidates: Sequence[Candidate], pivot: np.ndarray, most: int) -> list[Candidate]:
    """The first `most` candidates (the best first) of every plate that differ in position, rotation or depth.

    The plates are treated apart: costs of cavities that are hidden to different degrees cannot be compared. The
    residuals after refinement can.
    """
    if not candidates:
        return []
    frames = (
        Pose.stack([c.cavity.world_from_plate for c in candidates]),
        Pose.stack([c.plate_from_now for c in candidates]),
    )
    poses = frames[0] @ frames[1]
    pivots, depths = poses.apply(pivot), np.array([c.cavity.depth for c in candidates])
    numbers: dict[Pose, int] = {}
    plates = np.array([numbers.setdefault(c.cavity.world_from_plate, len(numbers)) for c in candidates])
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
    """The cavity with its observed depth and, if its floor may be hidden, with the expected depth [m].

    certain: whether the expected depth is well known, because the part lies as it will be inserted and shows its
    height.
    """
    hidden = np.isnan(cavity.heights[cavity.region]).any()
    if not hidden or expected <= cavity.depth + DEPTH_TOLERANCE:
        return [cavity]
    return [replace(cavity, depth=expected)] if certain else [cavity, replace(cavity, depth=expected)]


@dataclass(frozen=True, eq=False)
class KitSpectrum:
    """The expected heights of a plate in cells of CELL, as Fourier transforms."""

    cells: int
    size: int
    """Size of the transforms, at least the number of cells."""
    weighted_heights: np.ndarray
    """Transform of the heights times its trust."""
    trust: np.ndarray
    """Transform of the trust."""
    empty: float
    """Sum of squared heights without a part."""

    @classmethod
    def of(cls, cavity: Cavity, part_cells: int) -> KitSpectrum:
        """Heights are sampled at the nearest cells. part_cells: across the maps of the part."""
        cells = int(len(cavity.heights) * VOXEL / CELL)
        size = int(next_fast_len(max(cells, part_cells), real=True) or cells)
        at = np.rint((np.arange(cells) - (cells - 1) / 2) * CELL / VOXEL + (len(cavity.heights) - 1) / 2).astype(int)
        heights, trust = (image[np.ix_(at, at)] for image in expected_heights(cavity))
        return cls(
            cells, size, _spectrum(trust * heights, size), _spectrum(trust, size), float((trust * heights**2).sum())
        )


def best_shifts(
    kit: KitSpectrum, envelope: np.ndarray, cavity: Cavity, window: SearchWindow, pivot: np.ndarray
) -> Iterator[tuple[np.ndarray, float]]:
    """The best shifts (3,) [m] in the plate frame of a part with this dilated envelope, and their costs.

    The cost at a shift t is the sum over all cells x of trust(x) (heights(x) - cut(x - t))^2, divided by that sum
    without a part. Multiplied out, it takes two correlations.

    pivot: (3,) [m] of the part before it is shifted.
    """
    if kit.empty == 0:  # a cavity between two cells
        return
    lowest = float(envelope.min())
    cut = np.minimum(envelope - lowest - cavity.depth, 0)
    squares, heights = (_spectrum(image, kit.size) for image in (cut**2, 2 * cut))
    product = np.empty_like(squares)
    correlate(kit.trust, squares, kit.weighted_heights, heights, product)
    cost = (1 + np.asarray(irfft2(product, (kit.size, kit.size))) / kit.empty).round(COST_DECIMALS)
    steps = np.arange(kit.size)
    middle = (kit.cells - len(envelope)) / 2  # the step that puts the middle of one image on that of the other
    axis = (np.where(steps > middle + kit.size / 2, steps - kit.size, steps) - middle) * CELL
    z = -cavity.depth - lowest
    if window.guess is not None:
        shifts = np.stack(np.broadcast_arrays(axis[:, None], axis[None], z), axis=-1)
        cost = np.where(window.positions_inside(cavity.world_from_plate, shifts + pivot), cost, np.inf)
    ordered = cost + ORDER * np.arange(cost.size).reshape(cost.shape)
    low = (ordered == minimum_filter(ordered, 2 * PEAK_DISTANCE + 1, mode="wrap")) & np.isfinite(cost)
    i, j = np.nonzero(low)
    best = np.argsort(ordered[i, j], kind="stable")[:PEAKS]
    for a, b in zip(i[best], j[best], strict=True):
        yield np.array([axis[a], axis[b], z]), float(cost[a, b])


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


def work_of(half_width: float) -> float:
    """Units of work of a search for a part, 1 for up to 50 mm. half_width: [m] from its middle to its sides."""
    return max(half_width / HALF_WIDTH, 1.0) ** 3


def tries_of(half_width: float, least: int, most: int) -> int:
    """Number of candidates of a part that are refined: TRIES units of work, at least the least, at most the most."""
    return max(least, min(most, int(TRIES / work_of(half_width))))
