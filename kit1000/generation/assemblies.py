"""The job that makes one assembly: kits chosen so that no part seats in another's slot, placed so that it passes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import permutations
from pathlib import Path

from kit1000.dataset.json_rows import assembly_of, assembly_row, kit_of, part_of
from kit1000.dataset.mesh_files import glb_bytes, read_glb
from kit1000.errors import Redraw
from kit1000.files import read_json, sha256
from kit1000.generation.parts_and_kits import BUILD_FOLDER, Record, finished_record, save_record, write_mesh_file
from kit1000.generation.plan import MAX_CANDIDATES, draw_assembly_of
from kit1000.generation.presets import Preset
from kit1000.kits.assembly import build_assembly, check_assembly
from kit1000.kits.loose_fits import seats_in_other_slot
from kit1000.kits.prepared import PreparedKit, PreparedPart
from kit1000.values import Assembly, Kit, Part

MAX_ATTEMPTS = 60  # placements of the same kits before one kit is left out
CACHED_MEMBERS = 1000  # parts with their kits that a worker keeps in memory, about a third of a megabyte each
FEWER_KITS = "fewer kits than drawn"


@dataclass(frozen=True)
class AssemblyJob:
    """The arguments of a job: an assembly to make."""

    root: Path
    preset: Preset
    seed: int
    assembly_id: str
    split: str
    target: str
    kits: int
    candidates: tuple[str, ...]
    """Accepted parts of the split, in the order in which they are tried as neighbours of the target."""

    def __str__(self) -> str:
        return f"assembly {self.assembly_id}"


@dataclass(frozen=True, eq=False)
class Member:
    """A part and its kit, prepared for the test whether parts seat in each other's slots."""

    part: Part
    kit: Kit
    prepared_part: PreparedPart
    prepared_kit: PreparedKit


def make_assembly(job: AssemblyJob) -> Record:
    """Do the job unless its record exists; returns the record."""
    done = finished_record(job.root, "assemblies", job.assembly_id)
    if done is not None:
        return done
    members, rejected = _choose_members(job)
    assembly, redraws = _place_kits(job, members)
    if len(assembly.mounts) < job.kits:
        rejected.append(FEWER_KITS)
    name = f"assemblies/{job.assembly_id}.glb"
    record = {
        "id": job.assembly_id,
        "split": job.split,
        "target": job.target,
        "files": write_mesh_file(job.root, name, glb_bytes({job.assembly_id: assembly.mesh})),
        "redraws": redraws + rejected,
        "assembly": assembly_row(assembly) | {"attempt": len(redraws)},
    }
    return save_record(job.root, "assemblies", job.assembly_id, record)


def _place_kits(job: AssemblyJob, members: list[Member]) -> tuple[Assembly, list[str]]:
    """The first placement that passes, and the reasons of the rejected ones; leaves out the last kit when none does."""
    redraws: list[str] = []
    for kits in range(len(members), 0, -1):
        for _ in range(MAX_ATTEMPTS):
            order, plan = draw_assembly_of(job.preset, job.seed, job.assembly_id, kits, len(redraws))
            ordered = [members[i] for i in order]
            try:
                assembly = build_assembly(job.assembly_id, [member.kit for member in ordered], plan)
                check_assembly(assembly, {member.part.id: member.part for member in ordered})
                return assembly, redraws
            except Redraw as refusal:
                redraws.append(refusal.reason)
    raise Redraw(f"{job}: none of {len(redraws)} placements passes ({redraws[-1]})")


def _choose_members(job: AssemblyJob) -> tuple[list[Member], list[str]]:
    """The target and its neighbours, and the reasons of the rejected candidates."""
    members, rejected = [read_member(job.root, job.target)], []
    for tried, candidate_id in enumerate(job.candidates):
        if len(members) >= (job.kits if tried < MAX_CANDIDATES else job.preset.kits[0]):
            break
        candidate = read_member(job.root, candidate_id)
        pairs = [pair for other in members for pair in permutations((candidate, other))]
        if seats_in_other_slot([(part.prepared_part, kit.prepared_kit) for part, kit in pairs]):
            rejected.append("seats in a neighbour's slot")
        else:
            members.append(candidate)
    return members, rejected


def read_part_and_kit(root: Path, part_id: str) -> tuple[Part, Kit]:
    """A part and its kit, read from their record and meshes."""
    record = read_json(root / BUILD_FOLDER / "parts" / f"{part_id}.json")
    part = part_of(part_id, record["part"], read_glb(root / f"parts/{part_id}.glb")[part_id])
    return part, kit_of(part_id, record["kit"], read_glb(root / f"kits/{part_id}.glb")[part_id])


def read_member(root: Path, part_id: str) -> Member:
    """A part and its kit, prepared; cached until their record changes."""
    return _read_member(root, part_id, sha256(root / BUILD_FOLDER / "parts" / f"{part_id}.json"))


@lru_cache(maxsize=CACHED_MEMBERS)
def _read_member(root: Path, part_id: str, _record: str | None) -> Member:
    part, kit = read_part_and_kit(root, part_id)
    return Member(part, kit, PreparedPart(part.mesh), PreparedKit(kit))


def read_assembly(root: Path, assembly_id: str) -> tuple[Assembly, dict[str, Part]]:
    """An assembly and its parts by id, read from their records and meshes."""
    record = read_json(root / BUILD_FOLDER / "assemblies" / f"{assembly_id}.json")
    parts_and_kits = {m["kit_id"]: read_part_and_kit(root, m["kit_id"]) for m in record["assembly"]["mounts"]}
    mesh = read_glb(root / f"assemblies/{assembly_id}.glb")[assembly_id]
    assembly = assembly_of(assembly_id, record["assembly"], mesh, lambda kit_id: parts_and_kits[kit_id][1])
    return assembly, {part_id: part for part_id, (part, _) in parts_and_kits.items()}
