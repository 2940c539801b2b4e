"""The study "released from the gripper": does physics agree with the seating test?

Parts of a dataset are put into their slots by a compliant hand and let go (`kit1000.sim.insertion`), in true poses and
in wrong ones, and what becomes of them is set beside the verdict of the seating test. Physics decides no score: the
study shows where the two part and why. One seed and one set of pieces give the same bytes.
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
from kit1000.sim.insertion import OUTCOMES, Obstacle, Standing, Workpiece, insert, judged, obstacles
from kit1000.sim.pieces import convex_pieces, key_of, packed, unpacked
from kit1000.values import Assembly, Mount, Part

SHIFTS_MM = (1, 2, 4, 8)
TURNS_DEG = (2, 5, 10, 20)
TILTS_DEG = (0, 5, 15, 30, 45)  # edges of the bins, of a slot in the world
DEPTHS_MM = (0, 8, 12, 16, 20)  # edges of the bins, of a cavity
REPORT = "insertions.json"
PIECES = "pieces"

Row = dict[str, Any]


@dataclass(frozen=True)
class Place:
    """A slot of an assembly."""

    assembly_id: str
    mount: int
    part_id: str
    tilt: float
    """[rad] of the slot's axis from the vertical."""


@dataclass(frozen=True)
class Error:
    """How far a prediction is off."""

    kind: str
    """true, shift or turn"""
    amount: float
    """[mm] or [degrees]"""

    def __str__(self) -> str:
        unit = {"true": "", "shift": f" {self.amount:g} mm", "turn": f" {self.amount:g} degrees"}
        return f"{self.kind}{unit[self.kind]}"


ERRORS = (
    Error("true", 0),
    *(Error("shift", amount) for amount in SHIFTS_MM),
    *(Error("turn", amount) for amount in TURNS_DEG),
)


class Site:
    """One slot with all that stands about it, ready for predictions."""

    def __init__(self, assembly: Assembly, mount: Mount, part: Part, workpiece: Workpiece) -> None:
        self.mount, self.part, self.workpiece = mount, part, workpiece
        self.edges: ConvexEdges = convex_edges(assembly.mesh)
        self.standing: Sequence[Obstacle] = obstacles(assembly)

    def tried(self, pose: Pose, goal: Pose) -> Row:
        """What the seating test says of a prediction about a goal (kit frame both), and what physics makes of it."""
        plug = InsertedPart.of(self.part.mesh, goal)
        assembly_from_kit = self.mount.assembly_from_kit
        predicted = assembly_from_kit @ pose
        slot = self.mount.kit.slot
        said = seating_result(contact_offset(plug, self.edges, predicted), plug, pose, goal, slot.depth)
        came = insert(self.workpiece, self.standing, predicted, plug.axis)
        back = assembly_from_kit.inverse()
        released, rest = back @ came.released, back @ came.rest
        return {
            "seating": _said(said),
            "released": _found(judged(self.mount.kit, released, released)) | {"held_up": came.held_up},
            "physics": _found(judged(self.mount.kit, released, rest)) | {"still": came.still},
        }


def study(root: str | Path, out: str | Path, sample: int = 16, more: int = 32, seed: int = 0) -> dict[str, Any]:
    """Try `sample` slots of a dataset in a true pose and eight wrong ones, and `more` in a true pose; the report.

    Slots are spread over tilt. Writes `insertions.json` and the convex pieces of the parts to a folder `out`; pieces
    that are there already serve again. Progress goes to stderr.
    """
    if sample < 1 or more < 0:
        raise InputError(f"sample: expected 1 or more slots and 0 or more besides, got {sample} and {more}")
    geometry, folder = Geometry(root), Path(out)
    places = drawn_places(geometry, sample + more, seed)
    with locked(folder):
        rows: list[Row] = []
        for number, place in enumerate(tqdm(places, desc="slots", unit="", disable=None)):
            rows += tried_place(geometry, place, folder / PIECES, seed, ERRORS if number < sample else ERRORS[:1])
        report = {"dataset_id": geometry.summary["dataset_id"], "seed": seed, "slots": len(places)} | summarised(rows)
        write_json(folder / REPORT, report)
    return report


def drawn_places(geometry: Geometry, sample: int, seed: int) -> list[Place]:
    """Slots of a dataset, the bins of TILTS_DEG taking turns; as many as there are when fewer than asked."""
    found = [place for item_id, row in sorted(geometry.assemblies.items()) for place in _places(item_id, row)]
    order = stream(seed, "insertions", "places").permutation(len(found))
    bins: list[list[Place]] = [[] for _ in TILTS_DEG[1:]]
    for i in order:
        bins[_bin(np.degrees(found[i].tilt), TILTS_DEG)].append(found[i])
    turns = [(depth, k, place) for k, places in enumerate(bins) for depth, place in enumerate(places)]
    return [place for _, _, place in sorted(turns, key=lambda turn: turn[:2])[:sample]]


def _places(assembly_id: str, row: Row) -> Iterator[Place]:
    for i, mount in enumerate(row["mounts"]):
        up = pose_of(mount["assembly_from_kit"]).rotation_matrix()[:, 2]
        yield Place(assembly_id, i, mount["kit_id"], float(np.arctan2(np.hypot(up[0], up[1]), up[2])))


def _bin(value: float, edges: Sequence[float]) -> int:
    return int(np.clip(np.searchsorted(edges, value, side="right") - 1, 0, len(edges) - 2))


def tried_place(
    geometry: Geometry, place: Place, pieces: Path, seed: int, errors: Sequence[Error] = ERRORS
) -> list[Row]:
    """The rows of one slot: a prediction for each error, about a goal and in a direction that are drawn."""
    assembly = geometry.assembly(place.assembly_id)
    mount = assembly.mounts[place.mount]
    slot = mount.kit.slot
    part = geometry.part(slot.part_id)
    site = Site(assembly, mount, part, Workpiece.of(part, kept_pieces(part.mesh, pieces)))
    about = {
        "assembly": place.assembly_id,
        "mount": place.mount,
        "part": part.id,
        "family": part.family,
        "tilt_deg": round(float(np.degrees(place.tilt)), 3),
        "depth_mm": round(slot.depth * 1e3, 3),
    }
    rng = stream(seed, "insertions", place.assembly_id, place.mount)
    rows = []
    for error in errors:
        goal = slot.goals[int(rng.integers(len(slot.goals)))]
        rows.append(about | {"error": asdict(error)} | site.tried(_off(goal, error, rng), goal))
    return rows


def _off(goal: Pose, error: Error, rng: np.random.Generator) -> Pose:
    """A goal (kit frame) with an error: moved along the plate, or turned about the part's own origin."""
    angle, axis = rng.uniform(0, 2 * np.pi), rng.standard_normal(3)
    if error.kind == "shift":
        return Pose.from_translation(error.amount * 1e-3 * np.array([np.cos(angle), np.sin(angle), 0.0])) @ goal
    return rotated_about_centroid(goal, np.radians(error.amount) * axis / np.linalg.norm(axis))


def _said(said: SeatingResult) -> Row:
    seen = np.isfinite(said.contact_offset)
    return {
        "seated": said.seated,
        "strict": said.strict,
        "rise_mm": round(said.contact_offset * 1e3, 3) if seen else None,
        "height_mm": round(said.contact_height * 1e3, 3) if seen else None,
    }


def _found(found: Standing) -> Row:
    return {
        "outcome": found.outcome,
        "height_mm": round(found.height * 1e3, 3),
        "aside_mm": round(found.aside * 1e3, 3),
        "angle_deg": round(float(np.degrees(found.angle)), 3),
        "turned_deg": round(float(np.degrees(found.turned)), 3),
    }


def kept_pieces(mesh: Mesh, folder: Path) -> list[np.ndarray]:
    """The convex pieces of a mesh from a folder, cut and written there when they are missing or damaged."""
    path = folder / f"{key_of(mesh)}.npz"
    found = unpacked(path.read_bytes()) if path.is_file() else None
    if found is None:
        found = convex_pieces(mesh)
        write_bytes(path, packed(found))
    return found


def summarised(rows: Sequence[Row]) -> Row:
    """The report of a study's rows: counts by error, shares of outcomes of true poses, and where the two part."""
    true = [row for row in rows if row["error"]["kind"] == "true"]
    return {
        "agreement": {str(error): _agreement([r for r in rows if r["error"] == asdict(error)]) for error in ERRORS},
        "outcomes": {str(error): _outcomes([r for r in rows if r["error"] == asdict(error)]) for error in ERRORS},
        "true_by_tilt_deg": _binned(true, "tilt_deg", TILTS_DEG),
        "true_by_depth_mm": _binned(true, "depth_mm", DEPTHS_MM),
        "disagreements": [row for row in rows if row["seating"]["seated"] != _physically(row)],
        "trials": list(rows),
    }


def _physically(row: Row) -> bool:
    return row["physics"]["outcome"] == "seated"


def _agreement(rows: Sequence[Row]) -> dict[str, int]:
    counts = Counter((row["seating"]["seated"], _physically(row)) for row in rows)
    return {
        "trials": len(rows),
        "both": counts[True, True],
        "test_alone": counts[True, False],
        "physics_alone": counts[False, True],
        "neither": counts[False, False],
    }


def _outcomes(rows: Sequence[Row]) -> dict[str, int]:
    counts = Counter(row["physics"]["outcome"] for row in rows)
    return {"trials": len(rows)} | {outcome: counts[outcome] for outcome in OUTCOMES}


def _binned(rows: Sequence[Row], key: str, edges: Sequence[float]) -> dict[str, dict[str, int]]:
    inside = partial(_bin, edges=edges)
    return {
        f"{low:g}-{high:g}": _outcomes([row for row in rows if inside(row[key]) == k])
        for k, (low, high) in enumerate(pairwise(edges))
    }


def described(report: Row) -> str:
    """A report as text: three tables, and one line for each disagreement."""
    lines = _table("prediction", report["agreement"])
    lines += ["", "what became of true poses", *_table("tilt, degrees", report["true_by_tilt_deg"])]
    lines += ["", *_table("depth, mm", report["true_by_depth_mm"])]
    lines += ["", "what became of all", *_table("prediction", report["outcomes"])]
    lines += ["", f"{len(report['disagreements'])} disagreements", *map(_line, report["disagreements"])]
    return "\n".join(lines)


def _table(title: str, counts: dict[str, dict[str, int]]) -> list[str]:
    columns = [column.replace("_", " ") for column in next(iter(counts.values()))]
    rows = [[name, *map(str, row.values())] for name, row in counts.items()]
    return [f"{name:16s}" + "".join(f"{cell:>15s}" for cell in cells) for name, *cells in [[title, *columns], *rows]]


def _line(row: Row) -> str:
    said, let_go, found = row["seating"], row["released"], row["physics"]
    rise = "free" if said["rise_mm"] is None else f"rise {said['rise_mm']:.2f} mm height {said['height_mm']:.2f} mm"
    return (
        f"{row['assembly']} mount {row['mount']} {row['family']} tilt {row['tilt_deg']:.0f},"
        f" depth {row['depth_mm']:.1f} mm, {Error(**row['error'])}: "
        f"test {'seated' if said['seated'] else 'not seated'} ({rise});"
        f" let go{' where held up,' if let_go['held_up'] else ''} at height {let_go['height_mm']:.2f} mm,"
        f" angle {let_go['angle_deg']:.1f}; physics {found['outcome']} (height {found['height_mm']:.2f} mm,"
        f" aside {found['aside_mm']:.2f} mm, angle {found['angle_deg']:.1f}{'' if found['still'] else ', moving'})"
    )
