"""One row per query: each prediction is measured against the ground truth; as arrays and as a CSV file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from benchmark import quantities
from benchmark.queries import ScoredQueries
from kit1000.errors import InternalError
from kit1000.files import write_own
from kit1000.metrics import Targets, pose_errors, seatings
from kit1000.pose import Pose
from kit1000.queries.tracks import CURVES
from kit1000.submission import Predictions
from kit1000.values import Slot, Truth

MM = 1e3  # millimetres in a metre
UP = np.array([0.0, 0.0, 1.0])


class AlignedPredictions(NamedTuple):
    """The predictions of a submission for n queries, in their order."""

    motions: Pose
    """(n,) goal_from_now; the zero motion if there is no prediction."""
    covered: np.ndarray
    """(n,) bool: whether there is a prediction."""
    confidence: np.ndarray
    """(n,) 0 to 1; 0 without a prediction."""
    seconds: np.ndarray
    """(n,) NaN if it was not measured."""


def align(predictions: Predictions, queries: ScoredQueries) -> AlignedPredictions:
    """The predictions in the order of the queries."""
    row_of = {query_id: i for i, query_id in enumerate(predictions.query_ids)}
    rows = np.array([row_of.get(query_id, -1) for query_id in queries.query_ids])
    covered = rows >= 0
    given = rows[covered]
    wxyz, xyz = np.tile((1.0, 0.0, 0.0, 0.0), (len(rows), 1)), np.zeros((len(rows), 3))
    wxyz[covered], xyz[covered] = predictions.motions.wxyz[given], predictions.motions.xyz[given]
    confidence, seconds = np.zeros(len(rows)), np.full(len(rows), np.nan)
    confidence[covered], seconds[covered] = predictions.confidence[given], predictions.seconds[given]
    seconds[seconds < 0] = np.nan  # -1 in a file: not measured
    return AlignedPredictions(Pose(wxyz, xyz), covered, confidence, seconds)


def evaluate(
    queries: ScoredQueries,
    predictions: AlignedPredictions,
    rotation_only: bool = False,
    exact: str = "near",
    workers: int = 1,
) -> PerQuery:
    """Measure every prediction.

    Args:
        queries: n of them.
        predictions: in the same order.
        rotation_only: whether the method predicts rotations alone; then positions and seating are not measured.
        exact: near, all or never: the predictions that the exact seating test decides.
        workers: processes for the seating test.
    """
    measured = pose_quantities(queries, predictions.motions, rotation_only)
    seating, tests = _seating_columns(queries, predictions.motions, rotation_only, exact, workers)
    measured |= {**seating, quantities.SECONDS.key: predictions.seconds}
    return PerQuery(
        query_id=np.array(queries.query_ids),
        track=np.array(queries.tracks),
        scene_id=np.array(queries.scene_ids),
        assembly_id=np.array([truth.assembly_id for truth in queries.truths]),
        part_id=np.array([truth.part_id for truth in queries.truths]),
        covered=predictions.covered,
        quantities=measured,
        confidence=predictions.confidence,
        **tests,
        **_properties(queries),
    )


def pose_quantities(queries: ScoredQueries, motions: Pose, rotation_only: bool) -> dict[str, np.ndarray]:
    """The quantities (n,) that depend on the predicted pose alone, by key; NaN if positions are not predicted."""
    targets = queries.targets
    errors = pose_errors(centred(motions, targets) if rotation_only else motions, targets)
    measured = {
        quantities.POSITION.key: errors.position * MM,
        quantities.ROTATION.key: np.degrees(errors.rotation),
        quantities.MSSD.key: errors.mssd * MM,
        quantities.POSITION_PLAIN.key: errors.position_plain * MM,
        quantities.ROTATION_PLAIN.key: np.degrees(errors.rotation_plain),
    }
    if rotation_only:
        nothing = np.full(len(queries), np.nan)
        measured |= {
            each.key: nothing for each in quantities.QUANTITIES if each.needs_position and each.key in measured
        }
    return measured


def centred(motions: Pose, targets: Targets) -> Pose:
    """Motions (n,) with the predicted rotations, that move each part's centroid to its place at the drawn goal.

    So the rotation alone decides the nearest goal of a method that predicts no positions.
    """
    goal_centroids = targets.goals_drawn.apply(targets.anchors)
    return Pose(motions.wxyz, goal_centroids - motions.rotate(targets.anchors))


def _seating_columns(
    queries: ScoredQueries, motions: Pose, rotation_only: bool, exact: str, workers: int
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """The quantities of the seating test by key, and the columns about the exact test; not tested in the curves."""
    n = len(queries)
    seated, strict, penetration_mm = np.zeros(n, bool), np.zeros(n, bool), np.full(n, np.nan)
    measured = {
        quantities.SEATED.key: seated,
        quantities.STRICT.key: strict,
        quantities.PENETRATION.key: penetration_mm,
    }
    tests = {"exact_test": np.zeros(n, bool), "exact_disagreement": np.zeros(n, bool)}
    tested = np.flatnonzero(np.array(queries.tracks) != CURVES)
    if rotation_only or not len(tested):
        return measured, tests
    truths = [queries.truths[i] for i in tested]
    results = seatings(motions[tested], truths, queries.geometry, exact, workers)  # type: ignore[arg-type]
    seated[tested], strict[tested], penetration_mm[tested] = results.seated, results.strict, results.penetration * MM
    tests["exact_test"][tested], tests["exact_disagreement"][tested] = results.exact, results.disagrees
    return measured, tests


def _properties(queries: ScoredQueries) -> dict[str, np.ndarray]:
    """The columns of the properties of the queries."""
    truths = queries.truths
    held_out = queries.geometry.summary.get("held_out_families", ())
    return {
        "rest_mode": np.array([truth.rest_mode for truth in truths]),
        "tilt_deg": _tilt_deg(truths),
        "kits": np.array([truth.kits for truth in truths]),
        "crowded": np.array([truth.crowded for truth in truths]),
        "held_out": np.array([truth.family in held_out for truth in truths]),
        "visible": np.array([truth.visible for truth in truths]),
        "noise_px": np.array([truth.noise_px for truth in truths]),
        "symmetry": np.array([symmetry_of(truth.slot) for truth in truths]),
    }


def _tilt_deg(truths: tuple[Truth, ...]) -> np.ndarray:
    """(n,) angle between the axis of each slot and the vertical."""
    world_from_kit = Pose(np.array([truth.world_from_kit.wxyz for truth in truths]), np.zeros(3))
    x, y, z = world_from_kit.rotate(UP).T
    return np.degrees(np.arctan2(np.hypot(x, y), z))


def symmetry_of(slot: Slot) -> str:
    """The symmetry class of a part in its slot."""
    if slot.free_axis is not None:
        return "free axis"
    return "several goals" if len(slot.goals) > 1 else "one goal"


@dataclass(frozen=True, eq=False)
class PerQuery:
    """Arrays (n,), read-only, a row per query. NaN: not measured, as positions of a method that predicts rotations."""

    query_id: np.ndarray
    """str"""
    track: np.ndarray
    """str; `curves` for the queries of the robustness curves."""
    scene_id: np.ndarray
    """str"""
    assembly_id: np.ndarray
    """str"""
    part_id: np.ndarray
    """str"""
    covered: np.ndarray
    """bool: whether there is a prediction; without one, the zero motion is measured."""
    quantities: Mapping[str, np.ndarray]
    """Values by key of `quantities.per_query()`: float in the unit of the key, or bool for a rate."""
    exact_test: np.ndarray
    """bool: whether the exact seating test ran."""
    exact_disagreement: np.ndarray
    """bool: whether its result differs from the result of the fast test."""
    confidence: np.ndarray
    """0 to 1; 0 without a prediction."""
    rest_mode: np.ndarray
    """str: upright or tumbled."""
    tilt_deg: np.ndarray
    """Angle between the axis of the slot, z of the kit, and z of the world."""
    kits: np.ndarray
    """int: number of kits in the assembly."""
    crowded: np.ndarray
    """bool: whether the parts of the scene are pushed together."""
    held_out: np.ndarray
    """bool: whether the part's family is in no training scene."""
    visible: np.ndarray
    """Share of the part's silhouette that is visible to the camera."""
    noise_px: np.ndarray
    """[px] RMS noise of the disparity of the image; 0 of ideal depth, NaN if it is not known."""
    symmetry: np.ndarray
    """str: one goal, several goals, or free axis: the symmetry of the part in its slot."""

    def __post_init__(self) -> None:
        keys = [quantity.key for quantity in quantities.per_query()]
        if wrong := {*keys} ^ {*self.quantities}:
            raise InternalError(f"rows per query: quantities missing or too many: {', '.join(sorted(wrong))}")
        object.__setattr__(self, "quantities", MappingProxyType({key: self.quantities[key] for key in keys}))
        for column in self.columns().values():
            column.setflags(write=False)

    def __len__(self) -> int:
        return len(self.query_id)

    def __getitem__(self, index: np.ndarray | slice) -> PerQuery:
        """Some of the rows, by indices, a mask or a slice."""
        return PerQuery.of_columns({name: column[index] for name, column in self.columns().items()})

    @staticmethod
    def of_columns(columns: Mapping[str, np.ndarray]) -> PerQuery:
        """The rows of columns by name, as `columns` gives them."""
        measured = {quantity.key: columns[quantity.key] for quantity in quantities.per_query()}
        rest = {field.name: columns[field.name] for field in fields(PerQuery) if field.name != "quantities"}
        return PerQuery(**rest, quantities=measured)

    def columns(self) -> dict[str, np.ndarray]:
        """All arrays by name, in order, the quantities in place."""
        columns: dict[str, np.ndarray] = {}
        for field in fields(self):
            value = getattr(self, field.name)
            columns |= value if field.name == "quantities" else {field.name: value}
        return columns

    def of_track(self, track: str) -> PerQuery:
        """The rows of a track."""
        return self[self.track == track]

    @property
    def clusterings(self) -> tuple[np.ndarray, np.ndarray]:
        """Queries about one assembly are resampled together, and so are queries about one part."""
        return self.assembly_id, self.part_id

    @property
    def tracks(self) -> tuple[str, ...]:
        """The tracks that have rows, in the order of their first rows."""
        names, first = np.unique(self.track, return_index=True)
        return tuple(names[np.argsort(first)].tolist())


def write_per_query(path: Path, rows: PerQuery) -> None:
    """Write the rows as a CSV file: a header, then a line per query; values that were not measured are empty."""
    columns = rows.columns()
    lines = [",".join(columns), *map(",".join, zip(*map(_cells, columns.values()), strict=True))]
    write_own(path, ("\n".join(lines) + "\n").encode())


def _cells(column: np.ndarray) -> Sequence[str]:
    """A column as text, a cell per row."""
    if column.dtype.kind == "b":
        return ["true" if value else "false" for value in column.tolist()]
    return [_cell(value) for value in column.tolist()]


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return "" if np.isnan(value) else f"{round(value, 9):.9g}"
    return str(value)
