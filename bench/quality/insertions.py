"""Does rigid-body physics agree with the seating test? A compliant hand inserts parts of a dataset and releases them.

    python bench/quality/insertions.py data/kit1000 --sample 16 --true-only 32

`kit1000.sim.insertion` inserts parts in true and in wrong poses; the outcomes are compared with the seating test.
Physics decides no score: the study shows where and why the two differ. One seed and one set of convex pieces give the
same results.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from tqdm import tqdm

from bench.quality.convex_decomposition import cache_key, convex_pieces, pack_pieces, unpack_pieces
from benchmark.measurements import Column, Measurement, rate
from kit1000.dataset.geometry import Geometry
from kit1000.dataset.reader import Dataset
from kit1000.dataset.tables import pose_of
from kit1000.errors import InputError, Kit1000Error
from kit1000.files import locked, write_bytes
from kit1000.kits.acceptance import rotated_about_centroid
from kit1000.kits.seating import InsertedPart, SeatingResult, contact_offset, seating_result
from kit1000.mesh import Mesh
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.sim.insertion import (
    OUTCOMES,
    InsertionOutcome,
    Obstacle,
    Workpiece,
    assembly_obstacles,
    classify_outcome,
    insert,
)
from kit1000.values import Assembly, Mount, Part

SHIFTS_MM = (1, 2, 4, 8)
ROTATIONS_DEG = (2, 5, 10, 20)
TILTS_DEG = (0, 5, 15, 30, 45)  # bin edges of the tilt of a slot in the world
DEPTHS_MM = (0, 8, 12, 16, 20)  # bin edges of the depth of a cavity
PIECES = Path("runs/pieces")
AGREEMENT_COLUMNS = (
    Column("error", "prediction"),
    Column("n", "n"),
    Column("both", "both seat", 0),
    Column("test_alone", "test alone", 0),
    Column("physics_alone", "physics alone", 0),
    Column("neither", "neither", 0),
    Column("agree", "agree, %", 1, True),
)
DISAGREEMENT_COLUMNS = (
    Column("family", "part"),
    Column("error", "prediction"),
    Column("tilt_deg", "tilt of the slot, °", 0),
    Column("depth_mm", "depth, mm", 1),
    Column("rise_mm", "contact above the prediction, mm", 2),
    Column("release_mm", "released at, mm", 2),
    Column("release_deg", "°", 1),
    Column("outcome", "physics"),
    Column("aside_mm", "rests aside, mm", 2),
    Column("angle_deg", "°", 1),
)

Row = dict[str, Any]


@dataclass(frozen=True)
class Insertions:
    """Insert parts into their slots with a simulated compliant hand, and compare physics with the seating test."""

    data: tyro.conf.Positional[Path]
    """Dataset folder."""
    sample: int = 16
    """Number of slots with a true pose and eight wrong ones."""
    true_only: int = 32
    """Number of further slots with a true pose only."""
    seed: int = 0
    """Seed of the sample and of the pose errors."""
    split: str | None = None
    """One split; the slots of all splits when absent."""
    pieces: Path = PIECES
    """Folder of the convex pieces of parts, which later runs use again."""
    out: Path | None = None
    """JSON file of the tables, such as results/insertions.json."""


def main(options: Insertions) -> None:
    """Run the study and print its tables."""
    dataset = Dataset(options.data)
    start = time.process_time()
    rows = study(dataset.geometry, options.pieces, options.sample, options.true_only, options.seed, options.split)
    print(f"{time.process_time() - start:.0f} CPU s, missing convex pieces included")
    measurement = Measurement.begin(dataset)
    add_tables(measurement, rows)
    measurement.report(options.out)


@dataclass(frozen=True)
class SlotReference:
    """A slot of an assembly."""

    assembly_id: str
    mount: int
    part_id: str
    tilt: float
    """[rad] of the slot's axis from the vertical."""


@dataclass(frozen=True)
class TrialError:
    """The pose error of a trial's prediction."""

    kind: str
    """true, shift or turn"""
    amount: float
    """[mm] or [degrees]"""

    def __str__(self) -> str:
        return {"true": "true", "shift": f"offset {self.amount:g} mm", "turn": f"rotation {self.amount:g}°"}[self.kind]


TRIAL_ERRORS = (
    TrialError("true", 0),
    *(TrialError("shift", amount) for amount in SHIFTS_MM),
    *(TrialError("turn", amount) for amount in ROTATIONS_DEG),
)


class TrialSlot:
    """One slot with its assembly, prepared for trials."""

    def __init__(self, assembly: Assembly, mount: Mount, part: Part, workpiece: Workpiece) -> None:
        self.mount, self.part, self.workpiece = mount, part, workpiece
        self.assembly = assembly
        self.obstacles: Sequence[Obstacle] = assembly_obstacles(assembly)

    def run_trial(self, pose: Pose, goal: Pose) -> Row:
        """The results of the seating test and of physics for a predicted pose, against a goal; both kit_from_part."""
        part = InsertedPart.of(self.part.mesh, goal)
        kit, assembly_from_kit = self.mount.kit, self.mount.assembly_from_kit
        predicted = assembly_from_kit @ pose
        offset = contact_offset(part, self.assembly.mesh, predicted)
        trial = insert(self.workpiece, self.obstacles, predicted, part.axis)
        kit_from_assembly = assembly_from_kit.inverse()
        release, rest = kit_from_assembly @ trial.release_pose, kit_from_assembly @ trial.rest_pose
        return {
            "seating": _seating_row(seating_result(offset, part, pose, goal, kit.slot.depth, kit.slot.clearance)),
            "released": _outcome_row(classify_outcome(kit, release, release)) | {"held_up": trial.blocked},
            "physics": _outcome_row(classify_outcome(kit, release, rest)) | {"still": trial.at_rest},
        }


def study(
    geometry: Geometry,
    pieces: Path,
    sample: int = 16,
    true_only: int = 32,
    seed: int = 0,
    split: str | None = None,
) -> list[Row]:
    """The rows of all trials: `sample` slots with a true and eight wrong poses, `true_only` with a true one.

    Slots are spread over tilt. The convex pieces of parts are written to the folder `pieces`; those that are already
    there are reused. Progress goes to stderr.
    """
    if sample < 1 or true_only < 0:
        raise InputError(
            f"sample: expected 1 or more slots, and 0 or more true-only ones, got {sample} and {true_only}"
        )
    slots = draw_slots(geometry, sample + true_only, seed, split)
    rows: list[Row] = []
    with locked(pieces):
        for number, slot in enumerate(tqdm(slots, desc="slots", unit="", disable=None)):
            errors = TRIAL_ERRORS if number < sample else TRIAL_ERRORS[:1]
            rows += run_slot(geometry, slot, pieces, seed, errors)
    return rows


def draw_slots(geometry: Geometry, sample: int, seed: int, split: str | None = None) -> list[SlotReference]:
    """`sample` slots of a dataset or split, or all when it has fewer, in turn from the bins of TILTS_DEG."""
    assemblies = {i: row for i, row in sorted(geometry.assemblies.items()) if split is None or row["split"] == split}
    slots = [slot for item_id, row in assemblies.items() for slot in _assembly_slots(item_id, row)]
    order = stream(seed, "insertions", "places").permutation(len(slots))
    bins: list[list[SlotReference]] = [[] for _ in TILTS_DEG[1:]]
    for i in order:
        bins[_bin_index(np.degrees(slots[i].tilt), TILTS_DEG)].append(slots[i])
    ranked = [(rank, k, slot) for k, members in enumerate(bins) for rank, slot in enumerate(members)]
    return [slot for _, _, slot in sorted(ranked, key=lambda item: item[:2])[:sample]]


def _assembly_slots(assembly_id: str, row: Row) -> Iterator[SlotReference]:
    for i, mount in enumerate(row["mounts"]):
        up = pose_of(mount["assembly_from_kit"]).rotation_matrix()[:, 2]
        yield SlotReference(assembly_id, i, mount["kit_id"], float(np.arctan2(np.hypot(up[0], up[1]), up[2])))


def _bin_index(value: float, edges: Sequence[float]) -> int:
    return int(np.clip(np.searchsorted(edges, value, side="right") - 1, 0, len(edges) - 2))


def run_slot(
    geometry: Geometry, reference: SlotReference, pieces: Path, seed: int, errors: Sequence[TrialError] = TRIAL_ERRORS
) -> list[Row]:
    """Rows of one slot: a prediction for each error, from a random goal in a random direction.

    pieces: folder of the convex pieces.
    """
    assembly = geometry.assembly(reference.assembly_id)
    mount = assembly.mounts[reference.mount]
    slot = mount.kit.slot
    part = geometry.part(slot.part_id)
    trial_slot = TrialSlot(assembly, mount, part, Workpiece.of(part, cached_pieces(part.mesh, pieces)))
    row = {
        "assembly": reference.assembly_id,
        "mount": reference.mount,
        "part": part.id,
        "family": part.family,
        "tilt_deg": round(float(np.degrees(reference.tilt)), 3),
        "depth_mm": round(slot.depth * 1e3, 3),
    }
    rng = stream(seed, "insertions", reference.assembly_id, reference.mount)
    rows = []
    for error in errors:
        goal = slot.goals[int(rng.integers(len(slot.goals)))]
        rows.append(row | {"error": asdict(error)} | trial_slot.run_trial(_pose_with_error(goal, error, rng), goal))
    return rows


def _pose_with_error(goal: Pose, error: TrialError, rng: np.random.Generator) -> Pose:
    """A goal (kit frame) with an error: shifted along the plate, or rotated about the part's centroid."""
    angle, axis = rng.uniform(0, 2 * np.pi), rng.standard_normal(3)
    if error.kind == "shift":
        return Pose.from_translation(error.amount * 1e-3 * np.array([np.cos(angle), np.sin(angle), 0.0])) @ goal
    return rotated_about_centroid(goal, np.radians(error.amount) * axis / np.linalg.norm(axis))


def _seating_row(result: SeatingResult) -> Row:
    contact = np.isfinite(result.contact_offset)
    return {
        "seated": result.seated,
        "strict": result.strict,
        "rise_mm": round(result.contact_offset * 1e3, 3) if contact else None,
        "height_mm": round(result.contact_height * 1e3, 3) if contact else None,
    }


def _outcome_row(outcome: InsertionOutcome) -> Row:
    return {
        "outcome": outcome.outcome,
        "height_mm": round(outcome.height * 1e3, 3),
        "aside_mm": round(outcome.offset * 1e3, 3),
        "angle_deg": round(float(np.degrees(outcome.angle)), 3),
        "turned_deg": round(float(np.degrees(outcome.rotation_after_release)), 3),
    }


def cached_pieces(mesh: Mesh, folder: Path) -> list[np.ndarray]:
    """The convex pieces of a mesh from a folder, computed and written there when they are missing or damaged."""
    path = folder / f"{cache_key(mesh)}.npz"
    pieces = unpack_pieces(path.read_bytes()) if path.is_file() else None
    if pieces is None:
        pieces = convex_pieces(mesh)
        write_bytes(path, pack_pieces(pieces))
    return pieces


def add_tables(measurement: Measurement, rows: Sequence[Row]) -> None:
    """Add agreement and outcomes by error, outcomes of true poses by tilt and depth, and the disagreements."""
    by_error = {str(error): [row for row in rows if row["error"] == asdict(error)] for error in TRIAL_ERRORS}
    agreement = measurement.table("agreement", "Trials that test and physics seat", *AGREEMENT_COLUMNS)
    for error, trials in [*by_error.items(), ("all", rows)]:
        if trials:
            agreement.add(error=error, **agreement_counts(trials))
    true = by_error[str(TRIAL_ERRORS[0])]
    tilts, depths = _by_bin(true, "tilt_deg", TILTS_DEG), _by_bin(true, "depth_mm", DEPTHS_MM)
    for name, title, heading, groups in (
        ("outcomes", "Outcomes of physics", "prediction", by_error),
        ("tilts", "Outcomes of true poses by the tilt of the slot", "tilt, °", tilts),
        ("depths", "Outcomes of true poses by the depth of the cavity", "depth, mm", depths),
    ):
        columns = [Column("group", heading), Column("n", "n"), *(Column(outcome, outcome, 0) for outcome in OUTCOMES)]
        table = measurement.table(name, title, *columns, Column("rate", "seated, %", 1, True))
        for group, trials in groups.items():
            if trials:
                table.add(group=group, **outcome_counts(trials))
    disagreements = measurement.table("disagreements", "Trials in which they differ", *DISAGREEMENT_COLUMNS)
    for row in rows:
        if row["seating"]["seated"] != _seated_in_physics(row):
            disagreements.add(**_disagreement(row))


def _seated_in_physics(row: Row) -> bool:
    return row["physics"]["outcome"] == "seated"


def agreement_counts(rows: Sequence[Row]) -> Row:
    """Number of trials that both seat, one alone, neither; and the share in which they agree."""
    counts = Counter((row["seating"]["seated"], _seated_in_physics(row)) for row in rows)
    return {
        "n": len(rows),
        "both": counts[True, True],
        "test_alone": counts[True, False],
        "physics_alone": counts[False, True],
        "neither": counts[False, False],
        "agree": rate([row["seating"]["seated"] == _seated_in_physics(row) for row in rows]),
    }


def outcome_counts(rows: Sequence[Row]) -> Row:
    """Number of trials by the outcome of physics, and the share that it seats."""
    counts = Counter(row["physics"]["outcome"] for row in rows)
    seated = rate([_seated_in_physics(row) for row in rows])
    return {"n": len(rows), "rate": seated} | {outcome: counts[outcome] for outcome in OUTCOMES}


def _by_bin(rows: Sequence[Row], key: str, edges: Sequence[float]) -> dict[str, list[Row]]:
    index = partial(_bin_index, edges=edges)
    return {
        f"{low:g} to {high:g}": [row for row in rows if index(row[key]) == k]
        for k, (low, high) in enumerate(pairwise(edges))
    }


def _disagreement(row: Row) -> Row:
    """The cells of a trial in which test and physics differ."""
    test, release, physics = row["seating"], row["released"], row["physics"]
    return {
        "family": row["family"].replace("_", " "),
        "error": str(TrialError(**row["error"])),
        "tilt_deg": row["tilt_deg"],
        "depth_mm": row["depth_mm"],
        "rise_mm": test["rise_mm"],
        "release_mm": release["height_mm"],
        "release_deg": release["angle_deg"],
        "outcome": physics["outcome"],
        "aside_mm": physics["aside_mm"],
        "angle_deg": physics["angle_deg"],
    }


if __name__ == "__main__":
    try:
        main(tyro.cli(Insertions))
    except Kit1000Error as error:
        raise SystemExit(f"insertions: {error}") from error
