"""Where the part may go: the cavities, the faces it may be inserted on, and the candidates of the coarse search."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from baselines.completion.planes import find_planes, plane_frame
from baselines.registration.cavity import Cavity, find_cavity, plate_grid
from baselines.registration.faces import standing_faces
from baselines.registration.search import Candidate, SearchWindow, coarse_search
from baselines.registration.sources import Source
from kit1000.guesses import MAX_ANGLE, MAX_OFFSET
from kit1000.pose import Pose
from kit1000.products import matmul
from kit1000.rng import stream
from kit1000.values import Query
from kit1000.voxels import Volume, surface_points

SLACK_OFFSET, SLACK_ANGLE = 1.5e-3, np.radians(2.5)  # [m], [rad] searched beyond the largest error of a guess
SIDE = 0.144  # [m] of a plate's relief, at least: the range of a guess and half a part's width on either side
NEAR_GUESS = np.cos(np.radians(15))  # between the guess and a face that explains its tilt
DOWN = np.array([0.0, 0.0, -1.0])


def find_candidates(
    source: Source, part: Volume, query: Query, clearance: float, unseen_faces: bool = False
) -> list[Candidate]:
    """All candidates for a part, the best first; none where no part or no cavity is observed.

    Args:
        source: of the kits and of the middle of the part.
        part: as it lies now.
        query: its guess, if any, bounds the search.
        clearance: [m]
        unseen_faces: whether the part may stand on a face that its volume does not have.
    """
    if not part.occupied.any():
        return []
    cavities = find_cavities(source, query, plate_side(part, source.middle, clearance))
    if not cavities:
        return []
    window = SearchWindow(query.pivot, query.guess, MAX_ANGLE + SLACK_ANGLE, MAX_OFFSET + SLACK_OFFSET)
    down_normals = _down_normals(source, part, query, cavities, unseen_faces)
    return coarse_search(part, source.middle, down_normals, cavities, clearance, window)


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


def find_cavities(source: Source, query: Query, side: float = SIDE) -> list[Cavity]:
    """The cavities of all plates near the guess; of all plates where there is no guess. side: [m] of their reliefs."""
    guessed = None if query.guess is None else query.guess.apply(query.pivot)
    box = None if guessed is None else guessed + np.array([[-side / 2], [side / 2]])
    points, normals, area = source.oriented_points(box)
    planes = find_planes(points, normals, area, source.noise, stream(0, "registration", query.id))
    frames = [plane_frame(plane, plane.point if guessed is None else guessed) for plane in planes]
    noise = source.noise.distance
    cavities = [find_cavity(source.plate(plate_grid(frame, side)), frame, noise) for frame in frames]
    return [cavity for cavity in cavities if cavity is not None]


def _down_normals(
    source: Source, part: Volume, query: Query, cavities: Sequence[Cavity], unseen_faces: bool
) -> list[np.ndarray]:
    """Normals (3,) of the faces that may go onto a cavity's floor; without a guess the part lies as it is inserted."""
    if query.guess is None:
        return [DOWN]
    back = query.guess.inverse()
    guessed = [back.rotate(cavity.world_from_plate.rotate(DOWN)) for cavity in cavities]
    middle = part.grid.world(np.argwhere(part.occupied)).mean(0)
    angle = source.noise.angle
    cone = MAX_ANGLE + SLACK_ANGLE + angle
    faces = standing_faces(surface_points(part), middle, angle, np.array(guessed), cone)
    normals = [face.normal for face in faces]
    if normals and not unseen_faces:
        return normals
    unseen = [down for down in guessed if not any(matmul(down, normal) > NEAR_GUESS for normal in normals)]
    return normals + unseen  # the face may be one that the image does not show: then the guess gives the direction


def within_guess_error(goal_from_now: Pose, query: Query) -> bool:
    """Whether a motion is as near to the guess as a goal is; any is where there is no guess."""
    guess, pivot = query.guess, query.pivot
    if guess is None:
        return True
    offset = np.abs(goal_from_now.apply(pivot) - guess.apply(pivot)).max()
    angle = float((goal_from_now @ guess.inverse()).angle())
    return bool(offset <= MAX_OFFSET + 2 * SLACK_OFFSET and angle <= MAX_ANGLE + 2 * SLACK_ANGLE)
