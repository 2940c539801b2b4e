"""Reading a dataset: its summary, its tables, and parts, kits and assemblies by id, each loaded on first use."""

from __future__ import annotations

from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, NoReturn

from kit1000.dataset.json_rows import Row, assembly_of, check_format, kit_of, part_of, slot_of
from kit1000.dataset.mesh_files import read_glb
from kit1000.errors import InputError
from kit1000.files import read_json
from kit1000.mesh import Mesh
from kit1000.values import Assembly, Kit, Part, Slot, TrueGeometry, Truth

REPAIR = "add it, or make the dataset again"
OBJECTS = ("config", "counts", "files", "shards")  # of dataset.json, by name
CACHED = 1024  # parts, and as many assemblies, in memory: all of a training split; 0.2 MB and 3 ms of reading each


class Geometry:
    """The parts, kits and assemblies of a finished dataset, by id: `part`, `kit`, `slot` and `assembly`."""

    def __init__(self, root: str | Path) -> None:
        """Open a dataset folder. Raises InputError when it is no dataset, or an unfinished one."""
        self.root = Path(root)
        if not (self.root / "dataset.json").is_file():
            raise InputError(f"{self.root}: no dataset ({self._missing()})")
        summary = read_json(self.root / "dataset.json")
        version = summary.get("format") if isinstance(summary, dict) else None
        check_format(version, f"{self.root}: dataset.json")
        self.summary: dict[str, Any] = JsonObject(summary, f"{self.root}: dataset.json", REPAIR)
        for name in OBJECTS:
            if not isinstance(self.summary.get(name, {}), dict):
                raise InputError(f"{self.root}: dataset.json: {name}: expected an object; {REPAIR}")
        self.part = lru_cache(maxsize=CACHED)(self._part)
        self.kit = lru_cache(maxsize=64)(self._kit)
        self.assembly = lru_cache(maxsize=CACHED)(self._assembly)
        self.slot = lru_cache(maxsize=4096)(self._slot)

    @cached_property
    def parts(self) -> dict[str, Row]:
        """Rows of the table `parts`, by id."""
        return self._table("parts")

    @cached_property
    def kits(self) -> dict[str, Row]:
        """Rows of the table `kits`, by id, which is that of the part."""
        return self._table("kits")

    @cached_property
    def assemblies(self) -> dict[str, Row]:
        """Rows of the table `assemblies`, by id."""
        return self._table("assemblies")

    def true_geometry(self, truth: Truth) -> TrueGeometry:
        """The meshes and poses of a query's part and assembly, without its goals."""
        assembly = self.assembly(truth.assembly_id)
        mount = next(mount for mount in assembly.mounts if mount.kit.id == truth.part_id)
        world_from_assembly = truth.world_from_kit @ mount.assembly_from_kit.inverse()
        return TrueGeometry(self.part(truth.part_id).mesh, truth.world_from_part, assembly.mesh, world_from_assembly)

    def _table(self, name: str) -> dict[str, Row]:
        """A table; it is empty if nothing is known but images, as of an own camera."""
        path = self.root / f"{name}.json"
        rows = read_json(path)
        if not isinstance(rows, dict) or not all(isinstance(row, dict) for row in rows.values()):
            raise InputError(f"{path}: expected an object with a row for each id; {REPAIR}")
        return JsonObject(rows, str(path), REPAIR)

    def _missing(self) -> str:
        if not self.root.is_dir():
            return "it is a file" if self.root.exists() else "there is no such folder"
        if (self.root / "plan.json").is_file():
            return "not finished: run the same `kit1000 generate` again"
        return "no dataset.json in it"

    def _part(self, part_id: str) -> Part:
        return part_of(part_id, self._row("parts", part_id), self._mesh("parts", part_id))

    def _kit(self, kit_id: str) -> Kit:
        return kit_of(kit_id, self._row("kits", kit_id), self._mesh("kits", kit_id))

    def _slot(self, part_id: str) -> Slot:
        """The slot of a part, read from the table without opening a mesh."""
        return slot_of(self._row("kits", part_id))

    def _assembly(self, assembly_id: str) -> Assembly:
        """An assembly with its kits."""
        row, mesh = self._row("assemblies", assembly_id), self._mesh("assemblies", assembly_id)
        return assembly_of(assembly_id, row, mesh, self.kit)

    def _row(self, table: str, item_id: str) -> Row:
        rows: dict[str, Row] = getattr(self, table)
        if item_id not in rows:
            near = f" ({', '.join(sorted(rows)[:3])}, ...)" if rows else ""
            raise InputError(f"{self.root}: no {item_id!r} among {len(rows)} {table}{near}")
        return rows[item_id]

    def _mesh(self, kind: str, item_id: str) -> Mesh:
        return next(iter(read_glb(self.root / kind / f"{item_id}.glb").values()))


class JsonObject(dict[str, Any]):
    """A JSON object, in which a missing entry raises InputError; objects in it are such objects too."""

    def __init__(self, values: dict[str, Any], place: str, repair: str) -> None:
        """place: of the object, such as a file; begins messages. repair: how to mend it; ends them."""
        super().__init__(
            (key, JsonObject(each, f"{place}: {key}", repair) if isinstance(each, dict) else each)
            for key, each in values.items()
        )
        self.place, self.repair = place, repair

    def __missing__(self, key: str) -> NoReturn:
        raise InputError(f"{self.place}: has no {key!r}; {self.repair}")
