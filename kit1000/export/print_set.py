"""A set of kits to print for scenes of your own: parts of a dataset, their kits in pairs on brackets, as 3MF.

The folder is also read as the shapes of a scene: it has the tables and meshes of a dataset, without scenes. Every
assembly is a level plate with a second one tilted beside it, so one print of it fits a usual bed, and the angle of its
bracket is known exactly.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from kit1000.dataset.geometry import Geometry
from kit1000.dataset.mesh_files import glb_bytes
from kit1000.dataset.tables import FORMAT, Row, assembly_row, kit_row, part_row
from kit1000.errors import InputError, Redraw, did_you_mean
from kit1000.export.threemf import threemf_bytes
from kit1000.files import json_bytes, new_folder, with_checksum, write_bytes, write_json
from kit1000.kits.assembly import AssemblyPlan, SidePlate, build_assembly, check_assembly
from kit1000.kits.loose_fits import find_fit_in_other_slot
from kit1000.kits.prepared import PreparedKit, PreparedPart
from kit1000.mesh import Mesh
from kit1000.pose import Pose
from kit1000.values import Assembly, Kit, Part

BRACKETS_DEG = (10.0, 20.0, 30.0)  # one assembly of two kits each
BED = 0.22  # [m] side of the bed of a small desktop printer
SPLIT = "test"
PRINTS = "print"  # the folder of the 3MF files


@dataclass(frozen=True, eq=False)
class _Member:
    """A part with its kit, prepared for the test whether parts seat in each other's slots."""

    part: Part
    kit: Kit
    prepared_part: PreparedPart
    prepared_kit: PreparedKit

    @staticmethod
    def of(geometry: Geometry, part_id: str) -> _Member:
        part, kit = geometry.part(part_id), geometry.kit(part_id)
        return _Member(part, kit, PreparedPart(part.mesh), PreparedKit(kit))

    def seats_apart_from(self, other: _Member) -> bool:
        """Whether neither part seats in the other's slot."""
        return (
            find_fit_in_other_slot(self.prepared_part, other.prepared_kit) is None
            and find_fit_in_other_slot(other.prepared_part, self.prepared_kit) is None
        )


def write_print_set(
    data: Path, out: Path, ids: Sequence[str] = (), brackets_deg: Sequence[float] = BRACKETS_DEG
) -> dict[str, list[str]]:
    """Write a print set to a new folder; returns the ids of its assemblies, each with those of its parts.

    Args:
        data: dataset folder.
        out: folder, which must not exist.
        ids: two part ids for each bracket, in their order; the first of the test split that go together when empty.
        brackets_deg: angle of the second plate of each assembly, 10 to 45.

    Raises:
        InputError: an unknown id, an angle out of range, two parts that do not go together, or a folder that exists.
    """
    geometry = Geometry(data)
    for angle in brackets_deg:
        if not 10 <= angle <= 45:
            raise InputError(f"--brackets: expected angles of 10 to 45 degrees, got {angle:g}")
    made = list(_given(geometry, ids, brackets_deg) if ids else _chosen(geometry, brackets_deg))
    with new_folder(out, "prints") as folder:
        _write(folder, geometry, made)
    return {assembly.id: [member.part.id for member in members] for assembly, members in made}


def _given(
    geometry: Geometry, ids: Sequence[str], brackets_deg: Sequence[float]
) -> Iterator[tuple[Assembly, list[_Member]]]:
    """The assemblies of given parts."""
    if len(ids) != 2 * len(brackets_deg) or len(set(ids)) != len(ids):
        raise InputError(f"--ids: expected {2 * len(brackets_deg)} different parts, two a bracket, got {len(ids)}")
    for name in ids:
        if name not in geometry.parts:
            raise InputError(f"--ids {name}: no such part; {did_you_mean(name, geometry.parts)}see parts.json")
    for angle, first, second in zip(brackets_deg, ids[::2], ids[1::2], strict=True):
        pair = [_Member.of(geometry, name) for name in (first, second)]
        try:
            yield _joined(pair, angle), pair
        except Redraw as refusal:
            raise InputError(f"--ids {first} {second}: {refusal.reason}: choose another pair") from None


def _chosen(geometry: Geometry, brackets_deg: Sequence[float]) -> Iterator[tuple[Assembly, list[_Member]]]:
    """The assemblies of the first parts of the test split that go together."""
    left = sorted(part_id for part_id, row in geometry.parts.items() if row["split"] == SPLIT)
    members: dict[str, _Member] = {}
    for angle in brackets_deg:
        reason = f"{len(left)} are left"
        for names in combinations(left, 2):
            pair = [members.setdefault(name, _Member.of(geometry, name)) for name in names]
            try:
                yield _joined(pair, angle), pair
            except Redraw as refusal:
                reason = refusal.reason
                continue
            left = [name for name in left if name not in names]
            break
        else:
            raise InputError(
                f"{geometry.root}: its {SPLIT} split has no pair of parts for a bracket of {angle:g}°: {reason}"
            )


def _joined(pair: Sequence[_Member], angle_deg: float) -> Assembly:
    """A level plate with a tilted one beside it. Raises Redraw with the reason when they do not go together."""
    first, second = pair
    if not first.seats_apart_from(second):
        raise Redraw("one of the parts seats in the other's slot")
    plan = AssemblyPlan(0.0, 0.0, (SidePlate(0, float(np.radians(angle_deg))),))
    assembly = build_assembly(first.part.id, [first.kit, second.kit], plan)
    check_assembly(assembly, {member.part.id: member.part for member in pair})
    if assembly.mesh.extents[:2].max() > BED:
        raise Redraw(f"larger than a bed of {BED * 1e3:.0f} mm")
    return assembly


def _write(folder: Path, geometry: Geometry, made: Sequence[tuple[Assembly, Sequence[_Member]]]) -> None:
    """Write meshes, prints, tables, and `dataset.json` last."""
    tables: dict[str, dict[str, Row]] = {"parts": {}, "kits": {}, "assemblies": {}}
    files: dict[str, str] = {}

    def add(kind: str, item_id: str, row: Row, mesh: Mesh) -> None:
        tables[kind][item_id] = row | {"split": SPLIT, "redraws": []}
        files[f"{kind}/{item_id}.glb"] = write_bytes(folder / kind / f"{item_id}.glb", glb_bytes({item_id: mesh}))

    for assembly, members in made:
        add("assemblies", assembly.id, assembly_row(assembly), assembly.mesh)
        files |= _print(folder, f"kits-{assembly.id}", assembly.mesh)
        for member in members:
            add("parts", member.part.id, part_row(member.part), member.part.mesh)
            add("kits", member.kit.id, kit_row(member.kit), member.kit.mesh)
            files |= _print(folder, f"part-{member.part.id}", _standing(member.part, member.kit))
    files |= {f"{name}.json": write_json(folder / f"{name}.json", rows) for name, rows in tables.items()}
    write_bytes(folder / "dataset.json", json_bytes(_summary(geometry.summary, tables, files)))


def _print(folder: Path, name: str, mesh: Mesh) -> dict[str, str]:
    """Write one 3MF; returns its entry for `files`."""
    path = f"{PRINTS}/{name}.3mf"
    return {path: write_bytes(folder / path, threemf_bytes(name, mesh))}


def _standing(part: Part, kit: Kit) -> Mesh:
    """The part on its insertion face, the lowest point at z = 0: its largest flat face is mostly there."""
    turned = part.mesh.moved(Pose(kit.slot.kit_from_part.wxyz, np.zeros(3)))
    return turned.moved(Pose.from_translation((0.0, 0.0, -turned.bounds[0, 2]))).rounded_float32()


def _summary(
    source: Mapping[str, Any], tables: Mapping[str, Mapping[str, Row]], files: Mapping[str, str]
) -> dict[str, Any]:
    """The contents of `dataset.json`: a dataset of shapes without scenes."""
    nothing = {"parts": 0, "assemblies": 0, "scenes": 0}
    digest = hashlib.sha256(json_bytes(dict(files))).hexdigest()
    plain = {
        "format": FORMAT,
        "preset": "print",
        "dataset_id": digest[:16],
        "data_version": source["data_version"],
        "licence": source.get("licence", ""),
        "seed": source.get("seed"),
        "source": source["dataset_id"],
        "config": source["config"],
        "counts": {
            "train": nothing,
            "val": nothing,
            SPLIT: nothing | {name: len(tables[name]) for name in ("parts", "assemblies")},
        },
        "redraws": {},
        "refused": {},
        "refused_scenes": {},
        "shards": {},
        "files": dict(files),
    }
    return with_checksum(plain)
