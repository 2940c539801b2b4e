"""CPU seconds of `kit1000 kit` by stage, over the mesh files of a folder.

    python bench/speed/kit_profile.py FOLDER --out results/speed-kit-profile.json

Each file is a process of its own, as for a user: its start, the imports and the loading of compiled loops count. Stages
exclude the stages inside them; `other` is all that no stage covers.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import tyro
from tqdm import tqdm

from kit1000.errors import InputError, Kit1000Error
from kit1000.parts.files.read import mesh_files

STAGES = {
    "reading": [("kit1000.export.own_part", "read_mesh")],
    "choice of faces": [("kit1000.kits.choice", "insertion_faces"), ("kit1000.kits.choice", "sure_refusal")],
    "sweep": [("kit1000.kits.cavity", "grown_sweep")],
    "cavity": [("kit1000.kits.kit", "cut_cavity")],
    "plate": [("kit1000.kits.kit", "plate_mesh")],
    "clearance": [("kit1000.kits.kit", "measure_clearance")],
    "shadows and goals": [("kit1000.kits.choice", "design_slot")],
    "trials": [("kit1000.kits.choice", "check_pair")],
    "loose fits": [("kit1000.kits.acceptance", "find_loose_fit")],
    "files": [("kit1000.export.own_part", "kit_files")],
    "preview": [("kit1000.pictures.previews", "kit_preview")],
}
"""The functions of a stage, where their callers find them."""
START, OTHER, ALL = "start and imports", "other", "all"


@dataclass(frozen=True)
class KitProfile:
    """Profile the command."""

    folder: tyro.conf.Positional[Path]
    """Folder of mesh files."""
    every: int = 1
    """Only every n-th file."""
    one: bool = False
    """Profile the single file FOLDER in this process and print its seconds as JSON."""
    out: Path | None = None
    """JSON file of the table, such as results/speed-kit-profile.json."""


def main(options: KitProfile) -> None:
    """Print a table."""
    if options.one:
        print(json.dumps(profiled(options.folder)))
        return
    from benchmark.measurements import Column, Measurement  # only here: it is no part of what is measured

    files = mesh_files(options.folder)[:: options.every]
    profiled_apart(files[0])  # compiles and caches the loops
    rows = [profiled_apart(path) for path in tqdm(files, desc="files", disable=None)]
    measurement = Measurement.begin()
    title = f"CPU seconds of a kit by stage, {len(rows)} files"
    columns = [Column("stage", "stage"), Column("median", "median", 2), Column("p90", "90th percentile", 2)]
    table = measurement.table("stages", title, *columns, Column("most", "largest", 2))
    for stage in (START, *STAGES, OTHER, ALL):
        seconds = np.array([row.get(stage, 0.0) for row in rows])
        table.add(stage=stage, median=np.median(seconds), p90=np.quantile(seconds, 0.9), most=seconds.max())
    measurement.report(options.out)


def profiled_apart(path: Path) -> dict[str, float]:
    """CPU seconds by stage of one file, in a process of its own."""
    command = [sys.executable, __file__, str(path), "--one"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise InputError(f"{path}: {done.stderr.strip().splitlines()[-1] if done.stderr else 'died'}")
    return json.loads(done.stdout.splitlines()[-1])


def profiled(path: Path) -> dict[str, float]:
    """CPU seconds by stage of one file, in this process."""
    from kit1000.export.own_part import InexactKit, make_kit_from_file

    seconds: dict[str, float] = {}
    inner: list[float] = []
    for stage, places in STAGES.items():
        for module, name in places:
            _time(stage, module, name, seconds, inner)
    seconds[START] = time.process_time()
    with TemporaryDirectory() as folder, suppress(InputError, InexactKit):  # a refusal takes time too
        make_kit_from_file(path, Path(folder) / "kit")
    seconds[ALL] = time.process_time()
    seconds[OTHER] = seconds[ALL] - sum(value for stage, value in seconds.items() if stage != ALL)
    return seconds


def _time(stage: str, module: str, name: str, seconds: dict[str, float], inner: list[float]) -> None:
    """Replace a function by one that adds its CPU seconds, without those of stages inside, to its stage."""
    place = __import__(module, fromlist=[name])
    function: Callable[..., Any] = getattr(place, name)

    def timed(*arguments: Any, **options: Any) -> Any:
        start = time.process_time()
        inner.append(0.0)
        try:
            return function(*arguments, **options)
        finally:
            passed = time.process_time() - start
            seconds[stage] = seconds.get(stage, 0.0) + passed - inner.pop()
            if inner:
                inner[-1] += passed

    setattr(place, name, timed)


if __name__ == "__main__":
    try:
        main(tyro.cli(KitProfile))
    except Kit1000Error as error:
        raise SystemExit(f"kit_profile: {error}") from error
