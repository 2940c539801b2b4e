"""Check of a dataset's parts and kits from its files, with exact booleans, which generation does not use.

    python bench/quality/pairs.py data/kit1000 --count 100

Every plate: closed and one body after float32 rounding and vertex merging, clearance within its bounds. A sample: the
part never overlaps the plate on its way in; by booleans it is seated at every goal and at none of the wrong poses.
Exits with 1 when anything fails.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from manifold3d import Manifold

from kit1000.dataset.geometry import Geometry
from kit1000.kits.acceptance import is_goal, poses_beyond_keyedness, wrong_poses
from kit1000.kits.kit import MAX_EXCESS_CLEARANCE
from kit1000.kits.seating import HOVER, InsertedPart, contact_offset_by_booleans, seating_result, swept_solid
from kit1000.kits.sweep import SAGITTA
from kit1000.mesh import body_count, defect_float32, solid_from_mesh
from kit1000.pose import Pose
from kit1000.values import Kit, Part

FLOAT32_GAP = 0.2e-6  # [m] by which a part on the cavity's floor is raised, for the rounding of files to float32


@dataclass(frozen=True)
class PairCheckRun:
    """Check the parts and kits of a dataset."""

    data: tyro.conf.Positional[Path]
    """Dataset folder."""
    count: int = 100
    """Pairs checked with booleans, drawn at random; all are checked for closedness and clearance."""
    seed: int = 0
    """Of the random choice."""


def main(run: PairCheckRun) -> int:
    """Print the counts; 1 when something fails."""
    geometry, faults = Geometry(run.data), Counter()
    started = time.perf_counter()
    for kit_id, row in geometry.kits.items():
        mesh = geometry.kit(kit_id).mesh
        faults["plate not closed in float32"] += defect_float32(mesh) is not None
        faults["plate of several bodies"] += body_count(mesh) != 1
        faults["clearance out of bounds"] += not _in_bounds(row)
    sample = np.random.default_rng(run.seed).choice(sorted(geometry.kits), min(run.count, len(geometry.kits)), False)
    counts: Counter[str] = Counter()
    for part_id in sample:
        _check_pair(geometry.part(part_id), geometry.kit(part_id), geometry.kits[part_id]["keyedness"], faults, counts)
    reports = [row["report"] for row in geometry.kits.values()]
    low, high = min(r["clearance_smallest_mm"] for r in reports), max(r["clearance_largest_mm"] for r in reports)
    print(f"{len(reports)} plates: clearance {low:.3f} to {high:.3f} mm")
    print(f"{len(sample)} pairs by booleans: " + ", ".join(f"{n} {what}" for what, n in counts.items()))
    print("faults: " + (", ".join(f"{n} {what}" for what, n in faults.items() if n) or "none"))
    print(f"{time.perf_counter() - started:.0f} s")
    return int(any(faults.values()))


def _in_bounds(row: dict) -> bool:
    report, nominal = row["report"], row["clearance"] * 1e3
    low, high = nominal - SAGITTA * 1e3, nominal + MAX_EXCESS_CLEARANCE * 1e3
    return low <= report["clearance_smallest_mm"] and report["clearance_largest_mm"] <= high


def _check_pair(part: Part, kit: Kit, keyedness: float | None, faults: Counter[str], counts: Counter[str]) -> None:
    design, plate = kit.slot.goals[0], solid_from_mesh(kit.mesh)
    body = solid_from_mesh(part.mesh).transform(design.matrix()[:3])
    for lift in np.linspace(FLOAT32_GAP, HOVER, 8):
        counts["heights on the way in"] += 1
        faults["overlap on the way in"] += not (body.translate((0, 0, lift)) ^ plate).is_empty()
    for goal in kit.slot.goals:
        counts["goals"] += 1
        faults["goal that does not seat"] += not _seats(*swept_part(part, goal), kit, goal, goal)
    swept = swept_part(part, design)
    wrong = [(pose, None) for _, pose in wrong_poses(kit)] + [
        (pose, keyedness) for pose in poses_beyond_keyedness(kit, keyedness)
    ]
    for pose, max_angle in wrong:
        if not is_goal(pose, kit, max_angle):
            counts["wrong poses"] += 1
            faults["wrong pose that seats"] += _seats(*swept, kit, pose, design)


def swept_part(part: Part, goal: Pose) -> tuple[Manifold, InsertedPart]:
    """The swept solid of a part along its insertion axis at a goal, and the part with this axis."""
    inserted = InsertedPart.of(part.mesh, goal)
    return swept_solid(part.mesh, inserted.axis), inserted


def _seats(swept: Manifold, inserted: InsertedPart, kit: Kit, pose: Pose, goal: Pose) -> bool:
    offset = contact_offset_by_booleans(swept, inserted, solid_from_mesh(kit.mesh), pose)
    return seating_result(offset, inserted, pose, goal, kit.slot.depth).seated


if __name__ == "__main__":
    sys.exit(main(tyro.cli(PairCheckRun, description=__doc__)))
