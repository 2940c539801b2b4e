"""The insertion study: does rigid-body physics agree with the seating test?

A compliant hand inserts parts of a dataset into their slots and releases them (`kit1000.sim.insertion`), in true and in
wrong poses; the outcomes are compared with the results of the seating test. Physics decides no score: the study shows
where and why the two differ. One seed and one set of convex pieces give the same bytes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from kit1000.dataset.geometry import Geometry
from kit1000.dataset.tables import pose_of
from kit1000.errors import InputError
from kit1000.files import locked, write_bytes, write_json
from kit1000.kits.acceptance import rotated_about_centroid
from kit1000.kits.contact import ConvexEdges, convex_edges
from kit1000.kits.seating import InsertedPart, SeatingResult, contact_offset, seating_result
from kit1000.mesh import Mesh
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.sim.convex_decomposition import cache_key, convex_pieces, pack_pieces, unpack_pieces
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
REPORT_FILE = "insertions.json"
PIECES_FOLDER = "pieces"

Row = dict[str, Any]


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
        unit = {"true": "", "shift": f" {self.amount:g} mm", "turn": f" {self.amount:g} degrees"}
        return f"{self.kind}{unit[self.kind]}"


TRIAL_ERRORS = (
    TrialError("true", 0),
    *(TrialError("shift", amount) for amount in SHIFTS_MM),
    *(TrialError("turn", amount) for amount in ROTATIONS_DEG),
)


class TrialSlot:
    """One slot with its assembly, prepared for trials."""

    def __init__(self, assembly: Assembly, mount: Mount, part: Part, workpiece: Workpiece) -> None:
        self.mount, self.part, self.workpiece = mount, part, workpiece
        self.edges: ConvexEdges = convex_edges(assembly.mesh)
        self.obstacles: Sequence[Obstacle] = assembly_obstacles(assembly)

    def run_trial(self, pose: Pose, goal: Pose) -> Row:
        """The results of the seating test and of physics for a predicted pose, against a goal; both kit_from_part."""
        part = InsertedPart.of(self.part.mesh, goal)
        kit, assembly_from_kit = self.mount.kit, self.mount.assembly_from_kit
        predicted = assembly_from_kit @ pose
        offset = contact_offset(part, self.edges, predicted)
        trial = insert(self.workpiece, self.obstacles, predicted, part.axis)
        kit_from_assembly = assembly_from_kit.inverse()
        release, rest = kit_from_assembly @ trial.release_pose, kit_from_assembly @ trial.rest_pose
        return {
            "seating": _seating_row(seating_result(offset, part, pose, goal, kit.slot.depth, kit.slot.clearance)),
            "released": _outcome_row(classify_outcome(kit, release, release)) | {"held_up": trial.blocked},
            "physics": _outcome_row(classify_outcome(kit, release, rest)) | {"still": trial.at_rest},
        }


def study(root: str | Path, out: str | Path, sample: int = 16, true_only: int = 32, seed: int = 0) -> dict[str, Any]:
    """Run trials in slots of a dataset: `sample` slots with a true and eight wrong poses, `true_only` with a true one.

    Slots are spread over tilt. Writes the report, `insertions.json`, and the convex pieces of the parts to a folder
    `out`; pieces that are already there are reused. Progress goes to stderr. Returns the report.
    """
    if sample < 1 or true_only < 0:
        raise InputError(
            f"sample: expected 1 or more slots, and 0 or more true-only ones, got {sample} and {true_only}"
        )
    geometry, folder = Geometry(root), Path(out)
    slots = draw_slots(geometry, sample + true_only, seed)
    with locked(folder):
        rows: list[Row] = []
        for number, slot in enumerate(tqdm(slots, desc="slots", unit="", disable=None)):
            errors = TRIAL_ERRORS if number < sample else TRIAL_ERRORS[:1]
            rows += run_slot(geometry, slot, folder / PIECES_FOLDER, seed, errors)
        report = {"dataset_id": geometry.summary["dataset_id"], "seed": seed, "slots": len(slots)} | summarise(rows)
        write_json(folder / REPORT_FILE, report)
    return report


def draw_slots(geometry: Geometry, sample: int, seed: int) -> list[SlotReference]:
    """`sample` slots of a dataset, or all when it has fewer, in turn from the bins of TILTS_DEG."""
    slots = [slot for item_id, row in sorted(geometry.assemblies.items()) for slot in _assembly_slots(item_id, row)]
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
    """The rows of one slot: a prediction for each error, from a random goal in a random direction.

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


def summarise(rows: Sequence[Row]) -> Row:
    """The report of a study's rows: counts by error, outcomes of true poses by tilt and depth, and disagreements."""
    by_error = {str(error): [row for row in rows if row["error"] == asdict(error)] for error in TRIAL_ERRORS}
    true = [row for row in rows if row["error"]["kind"] == "true"]
    return {
        "agreement": {name: _agreement_counts(trials) for name, trials in by_error.items()},
        "outcomes": {name: _outcome_counts(trials) for name, trials in by_error.items()},
        "true_by_tilt_deg": _outcomes_by_bin(true, "tilt_deg", TILTS_DEG),
        "true_by_depth_mm": _outcomes_by_bin(true, "depth_mm", DEPTHS_MM),
        "disagreements": [row for row in rows if row["seating"]["seated"] != _seated_in_physics(row)],
        "trials": list(rows),
    }


def _seated_in_physics(row: Row) -> bool:
    return row["physics"]["outcome"] == "seated"


def _agreement_counts(rows: Sequence[Row]) -> dict[str, int]:
    counts = Counter((row["seating"]["seated"], _seated_in_physics(row)) for row in rows)
    return {
        "trials": len(rows),
        "both": counts[True, True],
        "test_alone": counts[True, False],
        "physics_alone": counts[False, True],
        "neither": counts[False, False],
    }


def _outcome_counts(rows: Sequence[Row]) -> dict[str, int]:
    counts = Counter(row["physics"]["outcome"] for row in rows)
    return {"trials": len(rows)} | {outcome: counts[outcome] for outcome in OUTCOMES}


def _outcomes_by_bin(rows: Sequence[Row], key: str, edges: Sequence[float]) -> dict[str, dict[str, int]]:
    index = partial(_bin_index, edges=edges)
    return {
        f"{low:g}-{high:g}": _outcome_counts([row for row in rows if index(row[key]) == k])
        for k, (low, high) in enumerate(pairwise(edges))
    }


def format_report(report: Row) -> str:
    """A report as text: four tables, and one line for each disagreement."""
    lines = _table("prediction", report["agreement"])
    lines += ["", "outcomes of true poses", *_table("tilt, degrees", report["true_by_tilt_deg"])]
    lines += ["", *_table("depth, mm", report["true_by_depth_mm"])]
    lines += ["", "outcomes of all trials", *_table("prediction", report["outcomes"])]
    lines += ["", f"{len(report['disagreements'])} disagreements", *map(_trial_line, report["disagreements"])]
    return "\n".join(lines)


def _table(title: str, counts: dict[str, dict[str, int]]) -> list[str]:
    columns = [column.replace("_", " ") for column in next(iter(counts.values()))]
    rows = [[name, *map(str, row.values())] for name, row in counts.items()]
    return [f"{name:16s}" + "".join(f"{cell:>15s}" for cell in cells) for name, *cells in [[title, *columns], *rows]]


def _trial_line(row: Row) -> str:
    test, release, physics = row["seating"], row["released"], row["physics"]
    rise = "free" if test["rise_mm"] is None else f"rise {test['rise_mm']:.2f} mm height {test['height_mm']:.2f} mm"
    return (
        f"{row['assembly']} mount {row['mount']} {row['family']} tilt {row['tilt_deg']:.0f},"
        f" depth {row['depth_mm']:.1f} mm, {TrialError(**row['error'])}: "
        f"test {'seated' if test['seated'] else 'not seated'} ({rise});"
        f" {'blocked' if release['held_up'] else 'released'} at height {release['height_mm']:.2f} mm,"
        f" angle {release['angle_deg']:.1f}; physics {physics['outcome']} (height {physics['height_mm']:.2f} mm,"
        f" offset {physics['aside_mm']:.2f} mm, angle {physics['angle_deg']:.1f}"
        f"{'' if physics['still'] else ', moving'})"
    )
