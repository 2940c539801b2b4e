"""What is wrong with all rows together: units, the order of quaternions, and poses that are no motions.

Statistics only: a file is suspected when it cannot be what it says and is what it should be once read in another way.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Literal

import numpy as np

from kit1000.pose import Pose, quaternion_angle
from kit1000.submission.faults import Fault
from kit1000.submission.rows import Rows

if TYPE_CHECKING:
    from kit1000.submission.asked import Asked

MILLIMETRES = 10.0  # [m] median length of a position beyond which it is in millimetres; true ones: 0.3 m
CENTIMETRES = 2.0  # [m] the same for centimetres
FEWEST = 10  # rows that a suspicion against guesses needs
FEWEST_ALONE = 20  # rows that a suspicion without guesses needs
TURNED, ALIKE = np.radians(60), np.radians(40)  # median angle to the guess: as no method has it; as every method has it
ASTRAY, AT_HOME = 0.07, 0.06  # [m] the same of the distance to the guessed place; true ones lie up to 0.05 off
SIGMAS = 5.0  # by how many standard errors two mean squares must differ
CLOSE_TO_UNIT = (0.5, 2.0)  # norms of quaternions that are taken to be meant as such


def suspicions(rows: Rows, asked: Asked | None, rotation_only: bool) -> list[Fault]:
    """All that looks wrong with the rows as a whole; with the queries of the dataset it is seen more surely."""
    with np.errstate(over="ignore", invalid="ignore"):
        norm = np.linalg.norm(rows.numbers[:, :4], axis=1)
    sound = np.isfinite(rows.numbers[:, :7]).all(axis=1) & (norm > CLOSE_TO_UNIT[0]) & (norm < CLOSE_TO_UNIT[1])
    sound &= np.abs(np.nan_to_num(rows.numbers[:, 4:7])).max(axis=1, initial=0) < 1e9
    wxyz, xyz = rows.numbers[sound, :4], rows.numbers[sound, 4:7]
    places = None if asked is None else _places(rows, asked, sound)
    faults = _angles(rows, norm)
    if len(wxyz) == 0:
        return faults
    unit, scale = (None, 1.0) if rotation_only else _unit(xyz)
    order = _order(wxyz, None if asked is None or places is None else asked.guesses[places])
    faults += [_fault(rows, *said) for said in (unit, order) if said]
    if asked is not None and places is not None and not rotation_only:
        motions = Pose(np.roll(wxyz, 1, axis=1) if order else wxyz, xyz * scale)
        said = _motion(motions, asked.pivots[places], asked.homes[places])
        faults += [_fault(rows, *said)] if said else []
    return faults


Said = tuple[str, str, str, str, Literal["error", "warning"]]  # name, seen, wanted, repair, kind


def _fault(rows: Rows, name: str, seen: str, wanted: str, repair: str, kind: Literal["error", "warning"]) -> Fault:
    return Fault(rows.file, None, None, seen, wanted, repair, kind, name)


def _places(rows: Rows, asked: Asked, sound: np.ndarray) -> np.ndarray:
    """(k,) index of the query of each sound row; that of a query without guess and place, -1, for unknown ids."""
    return np.array([asked.index.get(rows.query_ids[i], -1) for i in np.flatnonzero(sound)], dtype=np.int64)


def _angles(rows: Rows, norm: np.ndarray) -> list[Fault]:
    """Most quaternions far from unit length: something else stands in their columns."""
    known = norm[np.isfinite(norm)]
    if len(known) < FEWEST or np.median(np.abs(known - 1)) < 0.05:
        return []
    largest = float(np.nanmedian(np.nanmax(np.abs(rows.numbers[:, :4]), axis=1)))
    what = "angles in degrees" if largest > 4 else "angles, or quaternions that were not normalised"
    seen = f"most of qw, qx, qy, qz have a norm far from 1 (median {np.median(known):.3g}): {what} suspected"
    repair = "convert them: q = (cos(a/2), sin(a/2) * axis) of the angle a in radians"
    return [_fault(rows, "angles-suspected", seen, "unit quaternions, scalar first", repair, "error")]


def _unit(xyz: np.ndarray) -> tuple[Said | None, float]:
    """The unit of the positions, and what one of it is in metres."""
    median = float(np.median(np.linalg.norm(xyz, axis=1)))
    for limit, unit, scale in ((MILLIMETRES, "millimetres", 1e-3), (CENTIMETRES, "centimetres", 1e-2)):
        if median > limit:
            seen = f"the median length of x, y, z is {median:.4g}: {unit} suspected"
            kind = "error" if limit == MILLIMETRES else "warning"
            return (f"{unit}-suspected", seen, "metres", f"multiply x, y, z by {scale:g}", kind), scale
    return None, 1.0


def _order(wxyz: np.ndarray, guesses: np.ndarray | None) -> Said | None:
    """Whether the scalar stands last."""
    wanted, repair = "the scalar first: qw, qx, qy, qz", "move the last of the four to the front"
    if guesses is not None:
        said = np.isfinite(guesses).all(axis=1)
        if said.sum() >= FEWEST:
            as_is, moved = (_median_angle(q[said], guesses[said]) for q in (wxyz, np.roll(wxyz, 1, axis=1)))
            if as_is <= TURNED or moved >= ALIKE:
                return None
            seen = f"the turns lie {_deg(as_is)} off the guesses, and {_deg(moved)} off with the scalar last"
            return "scalar-last-suspected", f"{seen}: x, y, z, w suspected", wanted, repair, "error"
    if not _scalar_looks_last(wxyz):
        return None
    seen = "qz looks like the scalar of a quaternion, qw like its x: x, y, z, w suspected"
    return "scalar-last-suspected", seen, wanted, repair, "warning"


def _scalar_looks_last(wxyz: np.ndarray) -> bool:
    """Motions on a table turn about the vertical more than about others: w and z are large, x and y small.

    With the scalar last, the columns of x and y hold y and z, so that the third is larger than the first.
    """
    still = np.abs(wxyz[:, 3]) > 1 - 1e-9
    if len(wxyz) >= 5 and still.mean() > 0.5 and not (np.abs(wxyz[:, 0]) > 1 - 1e-9).any():
        return True  # (0, 0, 0, 1): nothing moves, or each part by exactly half a turn
    if len(wxyz) < FEWEST_ALONE:
        return False
    difference = wxyz[:, 0] ** 2 - wxyz[:, 2] ** 2
    return bool(difference.mean() < -SIGMAS * difference.std() / np.sqrt(len(wxyz))) and _first_is_small(wxyz)


def _first_is_small(wxyz: np.ndarray) -> bool:
    return bool(np.mean(wxyz[:, 0] ** 2) < 0.2 and np.mean(wxyz[:, 3] ** 2) > 0.25)


def _median_angle(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.median(quaternion_angle(a, b)))


def _deg(angle: float) -> str:
    return f"{np.degrees(angle):.0f} degrees"


READINGS: dict[str, tuple[Callable[[Pose, np.ndarray], np.ndarray], str, str]] = {
    "pose-suspected": (
        lambda p, pivots: p.xyz,
        "x, y, z are places in the kits: poses of parts suspected",
        "multiply each goal pose with the inverse of the pose now: goal_from_now = world_from_goal @ now_from_world",
    ),
    "inverse-suspected": (
        lambda p, pivots: p.inverse().apply(pivots),
        "the inverse motions carry the parts to the kits: now_from_goal suspected",
        "write the inverse of each motion",
    ),
    "turn-about-the-part-suspected": (
        lambda p, pivots: pivots + p.xyz,
        "x, y, z lead from the part to its place: turns about the part suspected, and not about the world's origin",
        "write x, y, z as pivot + shift - R pivot, with the centre of your turn as pivot",
    ),
}
"""By name: where a reading of the numbers carries the pivots, (n, 3) [m]; what is seen; the repair."""


def _motion(motions: Pose, pivots: np.ndarray, homes: np.ndarray) -> Said | None:
    """Whether the numbers make sense as another thing than a motion in the world."""
    said = np.isfinite(homes).all(axis=1)
    if said.sum() < FEWEST:
        return None
    motions, pivots, homes = motions[said], pivots[said], homes[said]

    def astray(places: np.ndarray) -> float:
        return float(np.median(np.linalg.norm(places - homes, axis=1)))

    as_is = astray(motions.apply(pivots))
    if as_is <= ASTRAY:
        return None
    name = min(READINGS, key=lambda name: astray(READINGS[name][0](motions, pivots)))
    if astray(READINGS[name][0](motions, pivots)) > min(AT_HOME, as_is / 2):
        return None
    seen, repair = f"the parts end {as_is * 1e3:.0f} mm off their kits, and {READINGS[name][1]}", READINGS[name][2]
    return name, seen, "goal_from_now, a motion in the world frame", repair, "error"
