"""Motions that take the parts out of the scene: after which known mistake would they lie in the kits?

A part lies in its kit when its pivot ends near where the user's guess takes it, which is at most 48 mm off. Rows
without a motion, and parts without a guess, are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from kit1000.pose import Pose, quaternion_angle, quaternion_conjugate, quaternion_from_rotvec

if TYPE_CHECKING:
    from kit1000.submission.expected_queries import ExpectedQueries

LEAST_ROWS = 10  # for any statement about all rows
LEAST_PARTS = 3  # for a statement that could be true of a single part by chance
IN_KIT = 0.06  # [m] of a pivot to the guessed one: guesses are within 0.05 m of the goals
FEW, MOST, NEARLY_ALL = 0.5, 0.6, 0.8  # shares of the parts in their kits: too few as they are, enough when read right
GAIN = 0.3  # by which another reading must raise that share
SHIFT_GAIN, SHIFT_SHARE = 0.1, 0.95  # the same for rows that slipped, which harm only where one scene ends
BESIDE = 0.18  # [m] median distance beyond which the parts are not on the kits at all; a wrong kit is 0.1 m away
FAR_ANGLE, NEAR_ANGLE = np.radians(60), np.radians(40)  # median angle to the guess: no method's, every method's
SAME = 1e-9  # largest difference of numbers that are the same
Z_UP = Pose(np.array([np.sqrt(0.5), np.sqrt(0.5), 0, 0]), np.zeros(3))  # z-up from y-up, as in glTF
OPENGL = Pose(np.array([0.0, 1, 0, 0]), np.zeros(3))  # a camera of OpenCV from one of OpenGL
AXES = np.eye(3)


@dataclass(frozen=True, eq=False)
class Sample:
    """The usable rows about parts with a guess."""

    motions: Pose
    """(n,) as written."""
    pivots: np.ndarray
    """(n, 3) [m] world"""
    guessed: np.ndarray
    """(n, 3) [m] world: the pivots under the guess."""
    rotations: np.ndarray
    """(n, 4) of the guess; NaN for a part whose guess belongs to another query."""
    parts: np.ndarray
    """(n,) a number for each scene and part; curves are about parts of the test split."""
    rows: np.ndarray
    """(n,) the index of each query."""
    read_cameras: Callable[[np.ndarray], Pose] | None
    """Returns world_from_camera of queries by their indices; None where unknown."""

    @cached_property
    def cameras(self) -> Pose:
        """(n,) world_from_camera of the images."""
        assert self.read_cameras is not None
        return self.read_cameras(self.rows)

    def distances(self, ends: np.ndarray) -> np.ndarray:
        """(n,) [m] from ends (n, 3) of the pivots to where the guess takes them."""
        return np.linalg.norm(ends - self.guessed, axis=1)

    def share(self, ends: np.ndarray) -> float:
        """The share of the parts that lie in their kits when their pivots end there."""
        return float(np.mean(self.distances(ends) <= IN_KIT))


@dataclass(frozen=True)
class Finding:
    """What the rows show as a whole."""

    code: str
    actual: str
    repair: str
    is_error: bool


@dataclass(frozen=True)
class Mistake:
    """Another reading of the numbers."""

    code: str
    ends: Callable[[Sample], np.ndarray]
    """(n, 3) [m] where the pivots end, when the numbers are read so."""
    text: str
    repair: str


def _framed(sample: Sample, world_from_other: Pose) -> np.ndarray:
    """Where the pivots end when the motions are written in another frame."""
    return world_from_other.apply(sample.motions.apply(world_from_other.inverse().apply(sample.pivots)))


def _mirrored(sample: Sample, matrix: np.ndarray) -> np.ndarray:
    """The same for axes of the other hand; matrix: (3, 3), its own inverse."""
    return sample.motions.apply(sample.pivots @ matrix.T) @ matrix.T


TRANSPOSED = "negate qx, qy and qz, or transpose the matrices before you convert them"
WORLD_FRAME = "write world_from_camera @ motion @ camera_from_world"
SIMPLE = (
    Mistake(
        "pose-suspected",
        lambda s: s.motions.xyz,
        "x, y, z are positions in the kits: probably poses of the parts",
        "multiply each goal pose by the inverse of the current pose: goal_from_now = world_from_goal @ now_from_world",
    ),
    Mistake(
        "inverse-suspected",
        lambda s: s.motions.inverse().apply(s.pivots),
        "the inverse motions take the parts to the kits: probably now_from_goal",
        "write the inverse of each motion",
    ),
    Mistake(
        "rotation-about-the-part-suspected",
        lambda s: s.pivots + s.motions.xyz,
        "x, y, z lead from each part to its kit: probably rotations about the part, not about the world's origin",
        "write x, y, z as pivot + shift - R pivot, with the centre of your rotation as pivot",
    ),
    Mistake(
        "transposed-suspected",
        lambda s: Pose(quaternion_conjugate(s.motions.wxyz), s.motions.xyz).apply(s.pivots),
        "transposed rotations take the parts to the kits: probably those of the transposed matrices",
        TRANSPOSED,
    ),
    Mistake(
        "scalar-last-suspected",
        lambda s: Pose(np.roll(s.motions.wxyz, 1, axis=1), s.motions.xyz).apply(s.pivots),
        "with the scalar last the parts end in the kits: probably x, y, z, w",
        "move the last of the four to the front",
    ),
    Mistake(
        "negated-suspected",
        lambda s: Pose(s.motions.wxyz, -s.motions.xyz).apply(s.pivots),
        "with x, y, z negated the parts end in the kits",
        "negate x, y and z",
    ),
    Mistake(
        "y-up-suspected",
        lambda s: _framed(s, Z_UP),
        "in a world whose y axis is up the parts end in the kits",
        "write the motions in the world of the dataset, whose z axis is up: (x, y, z) of yours is (x, -z, y) here",
    ),
    *(
        Mistake(
            "left-handed-suspected",
            lambda s, matrix=matrix: _mirrored(s, matrix),
            f"in left-handed axes ({name}) the parts end in the kits",
            "write the motions in the right-handed axes of the dataset",
        )
        for name, matrix in (
            ("x reversed", np.diag([-1.0, 1, 1])),
            ("y reversed", np.diag([1.0, -1, 1])),
            ("z reversed", np.diag([1.0, 1, -1])),
            ("y and z exchanged", AXES[[0, 2, 1]]),
            ("x and y exchanged", AXES[[1, 0, 2]]),
        )
    ),
)
OF_CAMERAS = (
    Mistake(
        "camera-frame-suspected",
        lambda s: _framed(s, s.cameras),
        "in the frame of the camera the motions take the parts to the kits",
        WORLD_FRAME,
    ),
    Mistake(
        "opengl-camera-suspected",
        lambda s: _framed(s, s.cameras @ OPENGL),
        "in the frame of an OpenGL camera (y up, z backwards) the motions take the parts to the kits",
        f"{WORLD_FRAME}, with the axes of OpenCV: x right, y down, z forwards",
    ),
    Mistake(
        "camera-pose-suspected",
        lambda s: s.cameras.apply(s.motions.xyz),
        "x, y, z are positions in the kits as the camera sees them: probably poses of the parts in its frame",
        "write goal_from_now = world_from_camera @ camera_from_goal @ now_from_world",
    ),
)


def convention_findings(sample: Sample, order_is_known: bool = False) -> Iterator[Finding]:
    """What is wrong with all rows together: at most one mistake that explains it, else that the parts end far away.

    order_is_known: whether the order of the quaternions was looked at before.
    """
    moving = np.abs(np.concatenate([sample.motions.rotvec(), sample.motions.xyz], axis=1)).max(axis=1) > SAME
    if moving.sum() < LEAST_ROWS:
        return
    sample = _only(sample, moving)
    ends = sample.motions.apply(sample.pivots)
    share, distances = sample.share(ends), sample.distances(ends)
    beside = f"the parts end {np.median(distances) * 1e3:.0f} mm from their kits ({share:.0%} lie in them)"
    same = _same_motion(sample)
    if same is not None:
        yield same
        return
    found = _explained(sample, share, order_is_known)
    if found is not None:
        mistake, after = found
        yield Finding(
            mistake.code, f"{beside}, and {mistake.text} ({after:.0%} lie in them then)", mistake.repair, True
        )
    elif np.median(distances) > BESIDE and share < 1 - FEW:
        repair = "check the frame, the unit and the ids; no known mistake explains it"
        yield Finding("far-from-kits", beside, repair, False)
    elif share >= FEW and (turned := _turned(sample)) is not None:
        yield turned


def _only(sample: Sample, rows: np.ndarray) -> Sample:
    arrays = (sample.pivots[rows], sample.guessed[rows], sample.rotations[rows], sample.parts[rows], sample.rows[rows])
    return Sample(sample.motions[rows], *arrays, sample.read_cameras)


def _part_count(sample: Sample) -> int:
    return len(np.unique(sample.parts))


def _same_motion(sample: Sample) -> Finding | None:
    """A warning where all rows hold one motion, although they are about several parts."""
    numbers = np.concatenate([sample.motions.wxyz, sample.motions.xyz], axis=1)
    if _part_count(sample) < 2 or np.ptp(numbers, axis=0).max() > SAME:
        return None
    actual = f"all {len(numbers)} rows hold the same motion, of {_part_count(sample)} different parts"
    return Finding("same-motion", actual, "write the motion of each query into its own row", False)


def _explained(sample: Sample, share: float, order_is_known: bool) -> tuple[Mistake, float] | None:
    """The mistake that explains best why few parts lie in their kits, and the share that would without it."""
    if share < FEW:
        known = [m for m in SIMPLE if not (order_is_known and m.code == "scalar-last-suspected")]
        known += OF_CAMERAS if sample.read_cameras is not None else []
        readings = [(mistake, mistake.ends(sample)) for mistake in known]
        best = max(readings, key=lambda reading: (sample.share(reading[1]), -np.median(sample.distances(reading[1]))))
        after = sample.share(best[1])
        if after >= MOST and after >= share + GAIN:
            return best[0], after
    if _part_count(sample) < LEAST_PARTS:
        return None
    for mistake in _slipped(sample):
        after = sample.share(mistake.ends(sample))
        if after >= SHIFT_SHARE and after >= share + SHIFT_GAIN:
            return mistake, after
    for mistake in _fitted(sample) if share < FEW else ():
        after = sample.share(mistake.ends(sample))
        if after >= NEARLY_ALL and after >= share + GAIN:
            return mistake, after
    return None


def _slipped(sample: Sample) -> Iterator[Mistake]:
    """Rows whose motions are those of the row before or after."""
    for step, taken, held in ((1, "after", "before"), (-1, "before", "after")):
        yield Mistake(
            "shifted-rows-suspected",
            lambda s, step=step: s.motions[np.roll(np.arange(len(s.pivots)), -step)].apply(s.pivots),
            f"with the motion of the row {taken} the parts end in the kits",
            f"each row has the motion of the row {held} it: match ids and motions",
        )


def _fitted(sample: Sample) -> Iterator[Mistake]:
    """Readings with a free number, found from the rows themselves: an offset, another origin, degrees as radians."""
    offset = np.median(sample.guessed - sample.motions.apply(sample.pivots), axis=0)
    yield Mistake(
        "offset-suspected",
        lambda s: s.motions.apply(s.pivots) + offset,
        f"they do so by the same ({_millimetres(-offset)}) mm",
        "add what is missing, or write the motions about the origin of the dataset's world",
    )
    origin = _origin(sample)
    yield Mistake(
        "other-origin-suspected",
        lambda s: s.motions.apply(s.pivots - origin) + origin,
        f"about an origin at ({_millimetres(origin)}) mm they end in the kits",
        "write the motions about the origin of the dataset's world: t + d - R d, with your origin d",
    )
    yield Mistake(
        "degrees-suspected",
        _of_degrees,
        "with their angles read as degrees the parts end in the kits",
        "convert angles to radians before you take sine and cosine",
    )


def _millimetres(vector: np.ndarray) -> str:
    return ", ".join(f"{value * 1e3:.0f}" for value in vector)


def _origin(sample: Sample) -> np.ndarray:
    """(3,) [m] the origin about which the motions take the pivots nearest to where the guess does."""
    matrices = AXES - sample.motions.rotation_matrix()
    gaps = sample.guessed - sample.motions.apply(sample.pivots)
    solution, *_ = np.linalg.lstsq(matrices.reshape(-1, 3), gaps.reshape(-1), rcond=1e-6)
    return solution


def _of_degrees(sample: Sample) -> np.ndarray:
    """Where the pivots end if each angle was meant in degrees, taken from the turns that look the same."""
    turns = sample.motions.rotvec()
    angles = np.linalg.norm(turns, axis=1, keepdims=True)
    axes = turns / np.maximum(angles, 1e-12)
    best = sample.motions.apply(sample.pivots)
    for turn in range(-29, 30):
        meant = Pose(quaternion_from_rotvec(axes * np.radians(angles + 2 * np.pi * turn)), sample.motions.xyz)
        ends = meant.apply(sample.pivots)
        nearer = sample.distances(ends) < sample.distances(best)
        best = np.where(nearer[:, None], ends, best)
    return best


def _turned(sample: Sample) -> Finding | None:
    """Rotations that agree with the guesses only when transposed, although the positions are right."""
    known = np.isfinite(sample.rotations).all(axis=1)
    if known.sum() < LEAST_ROWS:
        return None
    wxyz, guesses = sample.motions.wxyz[known], sample.rotations[known]
    as_is, transposed = (float(np.median(quaternion_angle(q, guesses))) for q in (wxyz, quaternion_conjugate(wxyz)))
    if as_is <= FAR_ANGLE or transposed >= NEAR_ANGLE:
        return None
    angles = f"{np.degrees(as_is):.0f} degrees from the guesses, but {np.degrees(transposed):.0f}"
    return Finding("transposed-suspected", f"rotations are {angles} when transposed", TRANSPOSED, True)


def sample_of(expected: ExpectedQueries, index: np.ndarray, motions: Pose) -> Sample | None:
    """The rows about parts with a guess; None where they are too few. index: (k,) the query of each motion."""
    with_guess = (index >= 0) & np.isfinite(expected.guessed_positions[index]).all(axis=1)
    if with_guess.sum() < LEAST_ROWS:
        return None
    rows = index[with_guess]
    known = (expected.pivots[rows], expected.guessed_positions[rows], expected.guessed_rotations[rows])
    names = [expected.scene_part(i).partition("-")[2] for i in rows.tolist()]
    parts = np.unique(names, return_inverse=True)[1]
    return Sample(motions[with_guess], *known, parts, rows, expected.cameras)
