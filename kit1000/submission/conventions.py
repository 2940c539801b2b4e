"""Motions that take the parts out of the scene: after which likely mistake would they lie in their kits?

A part lies in its kit if its pivot ends near where the user's guess takes it, which is at most 48 mm off. Rows without
a motion, and parts without a guess, are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from kit1000.pose import Pose, quaternion_angle, quaternion_conjugate
from kit1000.submission.faults import Fault, file_error, file_warning
from kit1000.submission.predictions import Rows

if TYPE_CHECKING:
    from kit1000.submission.expected_queries import ExpectedQueries

IMPOSSIBLE = 10.0  # [m] median length of x, y, z; about 0.3 m for correct motions
LEAST_ROWS = 10  # for a statement about all rows
IN_KIT = 0.06  # [m] from a pivot to the guessed one: guesses are within 0.05 m of the goals
FEW, ENOUGH, GAIN = 0.5, 0.6, 0.3  # shares of parts in their kits: as they are, after a correction, and the difference
NEARLY_ALL, SHIFT_GAIN = 0.95, 0.1  # the same for shifted rows, which are wrong only at the end of a scene or a part
BESIDE = 0.18  # [m] median distance beyond which the parts are not on the kits at all; a wrong kit is 0.1 m away
FAR_ANGLE, NEAR_ANGLE = np.radians(60), np.radians(40)  # median angle to the guess: no method's, every method's
SAME = 1e-9  # largest number of a row without a motion
EXPECTED = "goal_from_now, a motion in the world frame"


@dataclass(frozen=True, eq=False)
class Sample:
    """The rows with a motion of a part that has a guess."""

    motions: Pose
    """(n,) as written."""
    pivots: np.ndarray
    """(n, 3) [m] world."""
    guessed: np.ndarray
    """(n, 3) [m] world: the pivots under the guess."""
    rotations: np.ndarray
    """(n, 4) wxyz of the guess; NaN if the guess belongs to another query of the part."""
    cameras: Callable[[], Pose] | None
    """Returns world_from_camera (n,) of the images; None if they are unknown."""

    def distances(self, motions: Pose) -> np.ndarray:
        """(n,) [m] from where motions (n,) take the pivots to where the guess takes them."""
        return np.linalg.norm(motions.apply(self.pivots) - self.guessed, axis=1)

    def share(self, motions: Pose) -> float:
        """The share of the parts that lie in their kits after motions (n,)."""
        return float(np.mean(self.distances(motions) <= IN_KIT))


@dataclass(frozen=True)
class Mistake:
    """A convention in which motions are written by mistake."""

    code: str
    corrected: Callable[[Sample], Pose]
    """Returns the motions (n,) in the world, if the rows contain this mistake."""
    text: str
    repair: str


def _about_world(rotation: Pose, pivots: np.ndarray, ends: np.ndarray) -> Pose:
    """Motions that rotate as `rotation` does and take the pivots to their ends; both (n, 3) [m]."""
    turn = Pose(rotation.wxyz, np.zeros_like(pivots))
    return Pose(rotation.wxyz, ends - turn.apply(pivots))


def _from_cameras(sample: Sample) -> Pose:
    if sample.cameras is None:
        return sample.motions
    cameras = sample.cameras()
    return cameras @ sample.motions @ cameras.inverse()


SCALAR_LAST = Mistake(
    "scalar-last-suspected",
    lambda s: Pose(np.roll(s.motions.wxyz, 1, axis=1), s.motions.xyz),
    "quaternions in the order x, y, z, w",
    "move the last of the four numbers to the front",
)
TRANSPOSED = Mistake(
    "transposed-suspected",
    lambda s: Pose(quaternion_conjugate(s.motions.wxyz), s.motions.xyz),
    "rotations of the transposed matrices",
    "negate qx, qy and qz, or transpose the matrices before you convert them",
)
MISTAKES = (
    SCALAR_LAST,
    TRANSPOSED,
    Mistake(
        "inverse-suspected",
        lambda s: s.motions.inverse(),
        "inverse motions, now_from_goal",
        "write the inverse of each motion",
    ),
    Mistake(
        "pose-suspected",
        lambda s: _about_world(s.motions, s.pivots, s.motions.xyz),
        "poses of the parts",
        "multiply each goal pose by the inverse of the current pose: goal_from_now = world_from_goal @ now_from_world",
    ),
    Mistake(
        "rotation-about-the-part-suspected",
        lambda s: _about_world(s.motions, s.pivots, s.pivots + s.motions.xyz),
        "rotations about the part, not about the world's origin",
        "write x, y, z as pivot + shift - R pivot, with the centre of your rotation as pivot",
    ),
    Mistake(
        "camera-frame-suspected",
        _from_cameras,
        "motions in the frame of the camera",
        "write world_from_camera @ motion @ camera_from_world",
    ),
)
SHIFTED = tuple(
    Mistake(
        "shifted-rows-suspected",
        lambda s, step=step: s.motions[np.roll(np.arange(len(s.pivots)), -step)],
        f"motions of the row {where}",
        "match ids and motions",
    )
    for step, where in ((1, "before"), (-1, "after"))
)


def convention_faults(rows: Rows, expected: ExpectedQueries | None, rotation_only: bool) -> list[Fault]:
    """At most one fault of the valid rows as a whole: a wrong unit, another convention, or parts far from their kits.

    Args:
        rows: of the file.
        expected: queries of the dataset; only the unit is checked without.
        rotation_only: whether the method predicts no positions.
    """
    valid = np.flatnonzero(rows.valid)
    motions = Pose(rows.numbers[valid, :4], rows.numbers[valid, 4:7])
    if not rotation_only and len(valid):
        median = float(np.median(np.linalg.norm(motions.xyz, axis=1)))
        if median > IMPOSSIBLE:
            actual = f"the median length of x, y, z is {median:.4g}, probably not in metres"
            return [file_error(rows.file, "unit-suspected", actual, "metres", "divide millimetres by 1000")]
    if expected is None:
        return []
    index = np.array([expected.index.get(rows.query_ids[i], -1) for i in valid], dtype=np.int64)
    sample = sample_of(expected, index, motions)
    if len(sample.pivots) < LEAST_ROWS:
        return []
    return motion_faults(sample, rows.file, rotation_only)


def sample_of(expected: ExpectedQueries, index: np.ndarray, motions: Pose) -> Sample:
    """The rows with a motion of a part that has a guess. index: (k,) the query of each motion; -1 if unknown."""
    moving = np.abs(np.concatenate([motions.rotvec(), motions.xyz], axis=1)).max(axis=1) > SAME
    kept = moving & (index >= 0) & np.isfinite(expected.guessed_positions[index]).all(axis=1)
    queries, cameras = index[kept], expected.cameras
    return Sample(
        motions[kept],
        expected.pivots[queries],
        expected.guessed_positions[queries],
        expected.guessed_rotations[queries],
        None if cameras is None else lambda: cameras(queries),
    )


def motion_faults(sample: Sample, file: str, rotation_only: bool) -> list[Fault]:
    """At most one fault of all motions: the mistake that explains best why few parts end in their kits."""
    if rotation_only:
        return _rotation_faults(sample, file)
    share, distance = sample.share(sample.motions), np.median(sample.distances(sample.motions))
    mistake, after = _best(sample, SHIFTED)
    found = after >= max(NEARLY_ALL, share + SHIFT_GAIN)
    if not found and share >= FEW:
        return _rotation_faults(sample, file)
    if not found:
        mistake, after = _best(sample, MISTAKES)
        found = after >= max(ENOUGH, share + GAIN)
    actual = f"the parts end {distance * 1e3:.0f} mm from their kits ({share:.0%} lie in them)"
    if found:
        actual = f"{actual}, and {after:.0%} lie in them if the rows hold {mistake.text}"
        return [file_error(file, mistake.code, actual, EXPECTED, mistake.repair)]
    if distance > BESIDE:
        repair = "check the frame, the unit and the ids; no known mistake explains it"
        return [file_warning(file, "far-from-kits", actual, EXPECTED, repair)]
    return []


def _best(sample: Sample, mistakes: Sequence[Mistake]) -> tuple[Mistake, float]:
    """The mistake after whose correction most parts lie in their kits, and their share."""

    def closeness(mistake: Mistake) -> tuple[float, float]:
        motions = mistake.corrected(sample)
        return sample.share(motions), -float(np.median(sample.distances(motions)))

    best = max(mistakes, key=closeness)
    return best, closeness(best)[0]


def _rotation_faults(sample: Sample, file: str) -> list[Fault]:
    """Rotations that agree with the guesses only after a correction, although the positions are right."""
    known = np.isfinite(sample.rotations).all(axis=1)
    if known.sum() < LEAST_ROWS:
        return []

    def angle(motions: Pose) -> float:
        return float(np.median(quaternion_angle(motions.wxyz[known], sample.rotations[known])))

    as_is = angle(sample.motions)
    for mistake in (SCALAR_LAST, TRANSPOSED):
        after = angle(mistake.corrected(sample))
        if as_is > FAR_ANGLE and after < NEAR_ANGLE:
            angles = f"{np.degrees(as_is):.0f} degrees from the guesses, but {np.degrees(after):.0f}"
            actual = f"rotations are {angles} if the rows hold {mistake.text}"
            return [file_error(file, mistake.code, actual, EXPECTED, mistake.repair)]
    return []
