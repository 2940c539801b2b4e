"""Check of a dataset's parts and kits from its files, with exact booleans, which generation does not use.

    python bench/quality/pairs.py data/kit1000 --count 100

Every plate: closed and one body after float32 rounding and vertex merging, clearance within its bounds. A sample: the
part never overlaps the plate on its way in; by booleans it is seated at every goal and at none of the wrong poses.
Exits with 1 when anything fails.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tyro
from manifold3d import Manifold
from tqdm import tqdm

from bench.exact_offset import contact_offset_by_booleans, swept_solid
from benchmark.measurements import Column, Measurement, rate
from kit1000.dataset.reader import Dataset
from kit1000.kits.acceptance import is_goal, poses_beyond_keyedness, wrong_poses
from kit1000.kits.kit import MAX_EXCESS_CLEARANCE
from kit1000.kits.seating import HOVER, InsertedPart, seating_result
from kit1000.kits.sweep import SAGITTA
from kit1000.mesh import body_count, defect_float32, solid_from_mesh
from kit1000.pose import Pose
from kit1000.values import Kit, Part

FLOAT32_GAP = 0.2e-6  # [m] by which a part on the cavity's floor is raised, for the rounding of files to float32
CLOSED, ONE_BODY, IN_BOUNDS = "plates closed in float32", "plates of one body", "plates with clearance in its bounds"
FREE, SEATED_GOALS = "heights on the way in without overlap", "goals that seat"
WRONG = "wrong poses that do not seat"

HEIGHTS = np.linspace(FLOAT32_GAP, HOVER, 8)  # [m] above the goal at which overlap is looked for
LIFTS = (0.5e-6, 1e-6, 2e-6, 5e-6, 10e-6, 20e-6, 50e-6, 100e-6)  # [m] tried to end an overlap
OVERLAP_COLUMNS = (
    Column("part", "part"),
    Column("family", "family"),
    Column("height_mm", "height, mm", 4),
    Column("volume_mm3", "volume, mm³", 6),
    Column("lift_um", "ended by a lift of, µm", 1),
)
CLEARANCE = {
    "nominal": "nominal",
    "smallest": "smallest",
    "median": "smallest of a plate, median",
    "largest": "largest",
}


@dataclass(frozen=True)
class PairCheckRun:
    """Check the parts and kits of a dataset."""

    data: tyro.conf.Positional[Path]
    """Dataset folder."""
    count: int = 100
    """Pairs checked with booleans, drawn at random; all are checked for closedness and clearance."""
    seed: int = 0
    """Seed of the random choice."""
    out: Path | None = None
    """JSON file of the tables, such as results/pairs.json."""


class Overlap(NamedTuple):
    """A part in its plate at a height on the way in."""

    part: str
    family: str
    height_mm: float
    volume_mm3: float
    lift_um: float | None
    """Least of LIFTS that ends it; None: none of them."""


def main(run: PairCheckRun) -> int:
    """Print the counts; 1 when something fails."""
    dataset = Dataset(run.data)
    geometry, passed = dataset.geometry, defaultdict(list)
    for kit_id, row in geometry.kits.items():
        mesh = geometry.kit(kit_id).mesh
        passed[CLOSED].append(defect_float32(mesh) is None)
        passed[ONE_BODY].append(body_count(mesh) == 1)
        passed[IN_BOUNDS].append(_in_bounds(row))
    sample = np.random.default_rng(run.seed).choice(sorted(geometry.kits), min(run.count, len(geometry.kits)), False)
    overlaps: list[Overlap] = []
    for part_id in tqdm(sample, desc="pairs", unit="", disable=None):
        part, kit = geometry.part(part_id), geometry.kit(part_id)
        found = _overlaps(part, kit)
        passed[FREE] += [overlap is None for overlap in found]
        overlaps += [overlap for overlap in found if overlap is not None]
        _check_poses(part, kit, geometry.kits[part_id]["keyedness"], passed)
    measurement = Measurement.begin(dataset)
    title = f"All plates, and {len(sample)} pairs by exact booleans"
    columns = (
        Column("check", "check"),
        Column("n", "n"),
        Column("faults", "faults", 0),
        Column("passed", "passed, %", 2, True),
    )
    checks = measurement.table("checks", title, *columns)
    for check, values in passed.items():
        checks.add(check=check, n=len(values), faults=len(values) - sum(values), passed=rate(values))
    table = measurement.table("overlaps", "Overlaps on the way in", *OVERLAP_COLUMNS)
    for overlap in overlaps:
        table.add(**overlap._asdict())
    _add_clearance(measurement, list(geometry.kits.values()))
    measurement.report(run.out)
    return int(not all(all(values) for values in passed.values()))


def _add_clearance(measurement: Measurement, rows: Sequence[dict]) -> None:
    """Add the clearance of all plates between part and wall, by its nominal value."""
    columns = [Column("n", "plates")] + [Column(key, f"{heading}, mm", 3) for key, heading in CLEARANCE.items()]
    table = measurement.table("clearance", "Clearance between part and wall", *columns)
    for nominal in sorted({row["clearance"] for row in rows}):
        reports = [row["report"] for row in rows if row["clearance"] == nominal]
        smallest = [report["clearance_smallest_mm"] for report in reports]
        largest = [report["clearance_largest_mm"] for report in reports]
        ends = {"smallest": min(smallest), "median": np.median(smallest), "largest": max(largest)}
        table.add(n=len(reports), nominal=nominal * 1e3, **ends)


def _in_bounds(row: dict) -> bool:
    report, nominal = row["report"], row["clearance"] * 1e3
    low, high = nominal - SAGITTA * 1e3, nominal + MAX_EXCESS_CLEARANCE * 1e3
    return low <= report["clearance_smallest_mm"] and report["clearance_largest_mm"] <= high


def _overlaps(part: Part, kit: Kit) -> list[Overlap | None]:
    """Overlap of a part with its plate at each of HEIGHTS above its goal; None where there is none."""
    plate = solid_from_mesh(kit.mesh)
    body = solid_from_mesh(part.mesh).transform(kit.slot.goals[0].matrix()[:3])

    def common(height: float) -> Manifold:
        return body.translate((0, 0, height)) ^ plate

    found: list[Overlap | None] = []
    for height in HEIGHTS:
        shared = common(height)
        if shared.is_empty():
            found.append(None)
            continue
        lift = next((lift for lift in LIFTS if common(height + lift).is_empty()), None)
        found.append(Overlap(part.id, part.family, height * 1e3, shared.volume() * 1e9, lift and lift * 1e6))
    return found


def _check_poses(part: Part, kit: Kit, keyedness: float | None, passed: dict[str, list[bool]]) -> None:
    """Add to the lists by check whether goals seat and wrong poses do not."""
    design = kit.slot.goals[0]
    for goal in kit.slot.goals:
        passed[SEATED_GOALS].append(_seats(*swept_part(part, goal), kit, goal, goal))
    swept = swept_part(part, design)
    wrong = [(pose, None) for _, pose in wrong_poses(kit.slot)] + [
        (pose, keyedness) for pose in poses_beyond_keyedness(kit.slot, keyedness)
    ]
    for pose, max_angle in wrong:
        if not is_goal(pose, kit.slot, max_angle):
            passed[WRONG].append(not _seats(*swept, kit, pose, design))


def swept_part(part: Part, goal: Pose) -> tuple[Manifold, InsertedPart]:
    """The swept solid of a part along its insertion axis at a goal, and the part with this axis."""
    inserted = InsertedPart.of(part.mesh, goal)
    return swept_solid(part.mesh, inserted.axis), inserted


def _seats(swept: Manifold, inserted: InsertedPart, kit: Kit, pose: Pose, goal: Pose) -> bool:
    offset = contact_offset_by_booleans(swept, inserted, solid_from_mesh(kit.mesh), pose)
    return seating_result(offset, inserted, pose, goal, kit.slot.depth).seated


if __name__ == "__main__":
    sys.exit(main(tyro.cli(PairCheckRun, description=__doc__)))
