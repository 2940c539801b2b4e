"""Where the part may go: the cavities, the faces it may be inserted on, and the candidates of the coarse search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain, compress
from typing import NamedTuple

import numpy as np

from kit1000.numerics.linear_algebra import matmul
from kit1000.perception.observed.pixels import Noise
from kit1000.perception.observed.plates import find_planes, plane_frame, without_nested
from kit1000.pose import Pose
from kit1000.queries.guesses import MAX_ANGLE, MAX_OFFSET
from kit1000.registration.geometry.faces import right_angled, squared, standing_faces
from kit1000.registration.geometry.observed_cavity import VOXEL, Cavity, find_cavity, plate_grid
from kit1000.registration.geometry.wide_plates import plate_frames
from kit1000.registration.inputs.volume_sources import Source
from kit1000.registration.search.correlation import Candidate, SearchWindow, coarse_search
from kit1000.rng import stream
from kit1000.values import Query
from kit1000.voxels import Volume, surface_points

SLACK_OFFSET, SLACK_ANGLE = 1.5e-3, np.radians(2.5)  # [m], [rad] searched beyond the largest error of a guess
SIDE = 0.144  # [m] of a plate's relief, at least: the range of a guess and half a part's width on either side
WIDER = 1.4  # times that, where the border cuts all cavities: a guess may be off by its largest error along two axes
DEEPER = (2.0, 3.0)  # times as deep a cut, where a cavity then seems to run out over a rim: noise may bend it
MOST_PLATES = 24  # reliefs that are searched: eight planes, some of them with many holes
LEAST_REGION = 1e-4  # [m^2] a smaller hole is none that holds a part
NEAR_GUESS = np.cos(np.radians(15))  # between the guess and a face that explains its tilt
LIES = np.cos(MAX_ANGLE + SLACK_ANGLE)  # between the guess and the face on which the part lies, where it allows that
LARGE = 1e-4  # [m^2] of a face that is tried beside a direction nearly its own
DOWN = np.array([0.0, 0.0, -1.0])


class Faces(NamedTuple):
    """Faces that may go onto a cavity's floor, and where."""

    normals: list[np.ndarray]
    """(3,) unit, world, each, the part as it lies now."""
    cavities: list[Cavity]
    """That they may go into."""
    seen: bool
    """Whether the volume of the part has these faces."""


def find_candidates(
    source: Source,
    part: Volume,
    query: Query,
    clearance: float,
    thorough: bool = False,
) -> list[Candidate]:
    """All candidates for a part, the best first; none where no part or no cavity is observed.

    Args:
        source: of the kits, and of the middle and the height of the part.
        part: as it lies now.
        query: its guess, if any, bounds the search.
        clearance: [m]
        thorough: whether the face on which the part lies is preferred, faces that the volume does not have are tried,
            and planes within larger ones are no plates.
    """
    if not part.occupied.any():
        return []
    side = plate_side(part, source.middle, clearance)
    if side not in source.cavities:
        source.cavities[side] = find_cavities(source, query, side, nested=not thorough)
    cavities = source.cavities[side]
    if not cavities:
        return []
    window = SearchWindow(query.pivot, query.guess, MAX_ANGLE + SLACK_ANGLE, MAX_OFFSET + SLACK_OFFSET)
    found: list[Candidate] = []
    for faces in faces_down(source, part, query, cavities, thorough):
        candidates = coarse_search(part, source.middle, faces.normals, faces.cavities, clearance, window, source.height)
        found += candidates if faces.seen else [replace(candidate, seen=False) for candidate in candidates]
    return sorted(found, key=lambda candidate: candidate.misfit)


def plate_side(part: Volume, middle: np.ndarray, clearance: float) -> float:
    """[m] across a plate's relief that holds the cavity of a part wherever a guess may put it.

    Args:
        part: as it lies now.
        middle: (3,) [m] world, of the part.
        clearance: [m]
    """
    away = part.grid.world(np.argwhere(part.occupied)) - middle
    radius = np.sqrt(np.square(away).sum(-1).max())
    return max(SIDE, 2 * float(MAX_OFFSET + SLACK_OFFSET + radius + clearance))


def find_cavities(source: Source, query: Query, side: float = SIDE, nested: bool = True) -> list[Cavity]:
    """The cavities of all plates near the guess; of all plates where there is no guess.

    Args:
        source: of the kits.
        query: its guess.
        side: [m] of the reliefs of plates; WIDER where they hold no cavity. A plate without one is then cut DEEPER, and
            at once where rims may be bent; there holes that hold no part are left out beside one that does.
        nested: whether a plane within a larger one may be a plate.
    """
    guessed = None if query.guess is None else query.guess.apply(query.pivot)
    box = None if guessed is None else guessed + np.array([[-side / 2], [side / 2]])
    points, normals, area = source.oriented_points(box)
    planes = find_planes(points, normals, area, source.noise, stream(0, "registration", query.id))
    if not nested:
        planes = without_nested(planes, points, normals, source.noise)
    if guessed is None:
        about = (plate_frames(source, plane, points, normals, side) for plane in planes)
        frames = list(chain.from_iterable(about))[:MOST_PLATES]
    else:
        frames = [plane_frame(plane, guessed) for plane in planes]
    noise, small = source.noise, list[Cavity]()
    for wide in (side, WIDER * side):
        cuts = (1.0, *DEEPER) if noise.bent or wide > side else (1.0,)
        found = [_cavity(source.plate(plate_grid(frame, wide)), frame, noise, cuts) for frame in frames]
        cavities = [cavity for cavity in found if cavity is not None]
        large = [cavity for cavity in cavities if _holds_a_part(cavity)]
        if large:
            return large if noise.bent else cavities
        small = small or cavities
    return small


def _cavity(volume: Volume, world_from_plate: Pose, noise: Noise, cuts: Sequence[float]) -> Cavity | None:
    """The first cavity that holds a part, by deeper and deeper cuts; where none does, the first."""
    first = None
    for deeper in cuts:
        cavity = find_cavity(volume, world_from_plate, noise.distance, deeper, noise.dark)
        if _holds_a_part(cavity):
            return cavity
        first = first or cavity
    return first


def _holds_a_part(cavity: Cavity | None) -> bool:
    """Whether there is a cavity, and its region is larger than LEAST_REGION."""
    return cavity is not None and np.count_nonzero(cavity.region) * VOXEL**2 > LEAST_REGION


def faces_down(source: Source, part: Volume, query: Query, cavities: Sequence[Cavity], thorough: bool) -> list[Faces]:
    """The faces that may go onto a cavity's floor.

    Without a guess the part lies as it is inserted. With one, a thorough search inserts it on the face on which it
    lies, wherever the guess allows that: seldom does a part stand on two faces less than the error of a guess apart.
    """
    if query.guess is None:
        return [Faces([DOWN], list(cavities), True)]
    back = query.guess.inverse()
    guessed = [back.rotate(cavity.world_from_plate.rotate(DOWN)) for cavity in cavities]
    if not thorough:
        return [Faces(_standing(source, part, guessed) or guessed, list(cavities), True)]
    lies = [bool(matmul(down, DOWN) > LIES) for down in guessed]
    upright = [cavity for cavity, down in zip(cavities, lies, strict=True) if down]
    others = [cavity for cavity, down in zip(cavities, lies, strict=True) if not down]
    seen, unseen = _turned(source, part, list(compress(guessed, np.logical_not(lies))))
    return [Faces([DOWN], upright, True), Faces(seen, others, True), Faces(unseen, others, False)]


def _standing(source: Source, part: Volume, guessed: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Normals (3,) of the faces of a volume on which it stands, near one of the guessed directions (3,)."""
    middle, angle = part.grid.world(np.argwhere(part.occupied)).mean(0), source.noise.angle
    cone = MAX_ANGLE + SLACK_ANGLE + angle
    return [face.normal for face in standing_faces(surface_points(part), middle, angle, np.array(guessed), cone)]


def _turned(source: Source, part: Volume, guessed: Sequence[np.ndarray]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Normals (3,) of the faces on which a part that does not lie as it is inserted may be, near a guessed direction.

    First those of faces on which its volume stands. Then those that right angles add to them, and the guessed
    directions (3,) that none of them is near to, as they are and put upright or level.
    """
    if not guessed:
        return [], []
    middle, angle = part.grid.world(np.argwhere(part.occupied)).mean(0), source.noise.angle
    faces = standing_faces(surface_points(part), middle, angle)
    normals = right_angled([DOWN, -DOWN, *(squared(face.normal, source.noise.square) for face in faces)], angle)
    large = [face.normal for face in faces if face.area >= LARGE]
    normals += [normal for normal in large if not _any_near(normals, normal, np.cos(angle))]
    near = [normal for normal in normals if _any_near(guessed, normal, np.cos(MAX_ANGLE + SLACK_ANGLE + angle))]
    shown = [_any_near([face.normal for face in faces], normal, np.cos(angle)) for normal in near]
    free = [down for down in guessed if not _any_near(near, down, NEAR_GUESS)]
    level = [squared(down, MAX_ANGLE) for down in free]
    free = [down for down, put in zip(free, level, strict=True) if put is not down]
    return list(compress(near, shown)), [*compress(near, np.logical_not(shown)), *level, *free]


def _any_near(normals: Sequence[np.ndarray], normal: np.ndarray, least: float) -> bool:
    """Whether the cosine between any of some unit vectors (3,) and another is more than the least."""
    return any(matmul(other, normal) > least for other in normals)


def within_guess_error(goal_from_now: Pose, query: Query) -> bool:
    """Whether a motion is as near to the guess as a goal is; any is where there is no guess."""
    guess, pivot = query.guess, query.pivot
    if guess is None:
        return True
    offset = np.abs(goal_from_now.apply(pivot) - guess.apply(pivot)).max()
    angle = float((goal_from_now @ guess.inverse()).angle())
    return bool(offset <= MAX_OFFSET + 2 * SLACK_OFFSET and angle <= MAX_ANGLE + 2 * SLACK_ANGLE)
