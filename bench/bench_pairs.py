"""Parts and kits of a dataset, proved again from its files with exact booleans, which had no say when they were made.

    python bench/bench_pairs.py data/kit1000 --count 100

Every plate: closed and one body after float32 rounding and vertex merging, clearance within its bounds. A sample: the
part never overlaps the plate on its way in, the boolean judge seats it at every goal and at none of the wrong poses.
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

FILM = 0.2e-6  # [m] a part that rests on its floor is raised by, against the rounding of files to float32


@dataclass(frozen=True)
class Proof:
    """Prove a dataset's parts and kits."""

    data: tyro.conf.Positional[Path]
    """Dataset folder."""
    count: int = 100
    """Pairs proved with booleans, drawn at random; all are checked for closedness and clearance."""
    seed: int = 0
    """Of the drawing."""


def main(proof: Proof) -> int:
    """Print the table; 1 when something fails."""
    geometry, faults = Geometry(proof.data), Counter()
    started = time.perf_counter()
    for kit_id, row in geometry.kits.items():
        mesh = geometry.kit(kit_id).mesh
        faults["plate not closed in float32"] += defect_float32(mesh) is not None
        faults["plate of several bodies"] += body_count(mesh) != 1
        faults["clearance out of bounds"] += not _in_bounds(row)
    sample = np.random.default_rng(proof.seed).choice(
        sorted(geometry.kits), min(proof.count, len(geometry.kits)), False
    )
    tried: Counter[str] = Counter()
    for part_id in sample:
        _prove(geometry.part(part_id), geometry.kit(part_id), geometry.kits[part_id]["keyedness"], faults, tried)
    reports = [row["report"] for row in geometry.kits.values()]
    low, high = min(r["clearance_smallest_mm"] for r in reports), max(r["clearance_largest_mm"] for r in reports)
    print(f"{len(reports)} plates: clearance {low:.3f} to {high:.3f} mm")
    print(f"{len(sample)} pairs by booleans: " + ", ".join(f"{n} {what}" for what, n in tried.items()))
    print("faults: " + (", ".join(f"{n} {what}" for what, n in faults.items() if n) or "none"))
    print(f"{time.perf_counter() - started:.0f} s")
    return int(any(faults.values()))


def _in_bounds(row: dict) -> bool:
    report, asked = row["report"], row["clearance"] * 1e3
    low, high = asked - SAGITTA * 1e3, asked + MAX_EXCESS_CLEARANCE * 1e3
    return low <= report["clearance_smallest_mm"] and report["clearance_largest_mm"] <= high


def _prove(part: Part, kit: Kit, keyedness: float | None, faults: Counter[str], tried: Counter[str]) -> None:
    design, plate = kit.slot.goals[0], solid_from_mesh(kit.mesh)
    body = solid_from_mesh(part.mesh).transform(design.matrix()[:3])
    for rise in np.linspace(FILM, HOVER, 8):
        tried["heights on the way in"] += 1
        faults["overlap on the way in"] += not (body.translate((0, 0, rise)) ^ plate).is_empty()
    for goal in kit.slot.goals:
        tried["goals"] += 1
        faults["goal that does not seat"] += not _seats(*judge_of(part, goal), kit, goal, goal)
    judge = judge_of(part, design)
    wrong = [(pose, None) for _, pose in wrong_poses(kit)] + [
        (pose, keyedness) for pose in poses_beyond_keyedness(kit, keyedness)
    ]
    for pose, reach in wrong:
        if not is_goal(pose, kit, reach):
            tried["wrong poses"] += 1
            faults["wrong pose that seats"] += _seats(*judge, kit, pose, design)


def judge_of(part: Part, goal: Pose) -> tuple[Manifold, InsertedPart]:
    """The part swept out along the axis that a goal carries."""
    plug = InsertedPart.of(part.mesh, goal)
    return swept_solid(part.mesh, plug.axis), plug


def _seats(swept: Manifold, plug: InsertedPart, kit: Kit, pose: Pose, goal: Pose) -> bool:
    rise = contact_offset_by_booleans(swept, plug, solid_from_mesh(kit.mesh), pose)
    return seating_result(rise, plug, pose, goal, kit.slot.depth).seated


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Proof, description=__doc__)))
