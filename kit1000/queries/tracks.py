"""The tasks of the benchmark: splits, tracks and the ids of queries.

Every track draws for itself, by its name: goals, errors of the guesses and the drawn query. Two guesses with the same
error about two pivots would give the goal away.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Literal

from kit1000.errors import InputError

SPLITS = ("train", "val", "test")
Sensor = Literal["ideal", "d415", "photoneo"]
"""A sensor whose depth images datasets record, see `kit1000.sim.sensors.SENSORS`."""


@dataclass(frozen=True)
class Track:
    """A track of the benchmark: one kind of query."""

    name: str
    sensor: Sensor
    """The depth image of its queries."""
    guess: Literal["ball", "tilt"] | None
    """The rotation error of the user's initial guess: about any axis, or a tilt alone; None: there is no guess."""
    parts: Literal["all", "upright", "upright with a nearly level goal"]
    """The parts of a scene that have a query, among the visible ones."""
    crowded_scenes: bool
    """Whether it has queries in crowded scenes too."""
    description: str
    """One sentence for tables and pages."""
    splits: tuple[str, ...] = SPLITS
    """Splits that have its queries."""


def _noisy(track: Track, sensor: Sensor, device: str, splits: tuple[str, ...] = SPLITS) -> Track:
    """A track with the depth images of a sensor, the simulated one of a device."""
    description = f"As {track.name}, from a depth image with the noise of a {device}."
    return replace(track, name=f"{track.name}-{sensor}", sensor=sensor, description=description, splits=splits)


SNAP = Track(
    "snap",
    sensor="ideal",
    guess="ball",
    parts="all",
    crowded_scenes=True,
    description="With an initial guess: up to 28 mm off along each axis and up to 27.5° about any axis.",
)
PLACE = Track(
    "place",
    sensor="ideal",
    guess=None,
    parts="upright",
    crowded_scenes=True,
    description="Without a guess: parts lie upright at any yaw, slots are tilted by up to 45°.",
)
TRACKS = {
    track.name: track
    for track in (
        SNAP,
        Track(
            "snap-tilt",
            sensor="ideal",
            guess="tilt",
            parts="all",
            crowded_scenes=False,
            description="As snap, but the guess is rotated by a tilt alone, as in the release of the paper.",
        ),
        PLACE,
        Track(
            "place-paper",
            sensor="ideal",
            guess=None,
            parts="upright with a nearly level goal",
            crowded_scenes=False,
            description="Without a guess, as in the paper: only goals with roll and pitch within ± 15°.",
        ),
        *(_noisy(track, "d415", "RealSense D415") for track in (SNAP, PLACE)),
        *(_noisy(track, "photoneo", "Photoneo PhoXi scanner", ("val", "test")) for track in (SNAP, PLACE)),
    )
}
CURVES = "curves"
"""The track of the robustness curves: as snap, with guess errors at fixed levels instead of random ones."""
ALL_TRACKS = (*TRACKS, CURVES)
GUESS_TRACKS = (*(name for name, track in TRACKS.items() if track.guess is not None), CURVES)
"""Tracks whose queries come with a guess."""
PAPER_TRACKS = {"with user input": "snap-tilt", "without user input": "place-paper"}
"""The tracks that correspond to Table I of the paper, by the half of the table. Guesses of snap-tilt are rotated by a
tilt alone, as in the paper's release; the text of the paper rotates them about any axis."""


def query_id(scene_id: str, part: int, track: str) -> str:
    """Id of the query about a part of a scene, such as test-s0007-p2-snap."""
    return f"{scene_id}-p{part}-{track}"


def has_curves(scene_id: str, scenes: int) -> bool:
    """Whether the drawn target of a scene has queries of the curves: in the first `scenes` test scenes."""
    split, _, number = scene_id.rpartition("-s")
    return split == "test" and int(number) < scenes


def curve_id(scene_id: str, part: int, varied: str, level: int, fixed: int) -> str:
    """Id of a query of the curves: the error `varied` ("pos" or "rot") is at `level`, the other one at `fixed`."""
    other = {"pos": "rot", "rot": "pos"}[varied]
    return f"{scene_id.replace('test-', 'curves-', 1)}-p{part}-{varied}{level}-{other}{fixed}"


def curve_levels(query_id: str) -> tuple[str, int, int]:
    """From the id of a query of the curves: the varied error ("pos" or "rot"), its level, the level of the other."""
    match = re.fullmatch(r"curves-s\d+-p\d+-(?:pos(\d)-rot(\d)|rot(\d)-pos(\d))", query_id)
    if match is None:
        raise InputError(f"query id {query_id!r}: expected one of the curves, such as curves-s0007-p2-pos3-rot1")
    varied, groups = ("pos", match.group(1, 2)) if match.group(1) else ("rot", match.group(3, 4))
    return varied, int(groups[0]), int(groups[1])
