"""The folder of a kit: what an earlier run wrote there is replaced, and nothing else ever is.

The report lists the SHA-256 of the files beside it and of itself. While files are written, a hidden record lists those
before and after, so that a folder of an interrupted run is known again.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from kit1000.errors import InputError
from kit1000.files import clear_partial, sha256, with_checksum, write_bytes, write_json

REPORT = "report.json"  # written last: when it exists, the other files are complete and of the same part
WRITING = ".kit1000-writing.json"
FILES = "files"
STAYS = "is there already and of another origin: it stays; choose another --out"


def check_kit_folder(out: Path, names: Iterable[str], source: Path) -> None:
    """Raise InputError where a kit in a folder would replace the file of its part, or one that no earlier run wrote."""
    known = _known(out)
    paths = {name: out / name for name in (REPORT, *names)}  # the report first: it tells what the others are
    for path in paths.values():
        if path.exists() and path.resolve() == source.resolve():
            raise InputError(
                f"{path}: is the part itself, which a kit in this folder would replace; choose another --out"
            )
    for name, path in paths.items():
        if path.exists() and not (_is_ours(path) if name == REPORT else sha256(path) in known.get(name, ())):
            raise InputError(f"{path}: {STAYS}")


def check_reports(out: Path) -> None:
    """Raise InputError where the report of several kits would replace one of another origin."""
    path = out / REPORT
    reports = _read(path)
    ours = isinstance(reports, dict) and all(
        isinstance(report, str) or (isinstance(report, dict) and FILES in report) for report in reports.values()
    )
    if path.exists() and not (ours or _is_ours(path)):
        raise InputError(f"{path}: {STAYS}")


def write_kit_folder(out: Path, files: Mapping[str, bytes], report: dict[str, Any]) -> dict[str, Any]:
    """Write the files of a kit and its report, and delete those of an earlier kit; returns the report as written."""
    known, new = _known(out), {name: hashlib.sha256(data).hexdigest() for name, data in files.items()}
    clear_partial(out, *files, REPORT, WRITING)
    names = sorted({*known, *new})
    write_json(
        out / WRITING, {name: sorted({*known.get(name, ()), *([new[name]] if name in new else [])}) for name in names}
    )
    with suppress(OSError):  # the next write reports any error
        (out / REPORT).unlink()
    for name in known:
        if name not in files and sha256(out / name) in known[name]:
            (out / name).unlink(missing_ok=True)
    for name, data in files.items():
        write_bytes(out / name, data)
    complete = with_checksum(report | {FILES: new})
    write_json(out / REPORT, complete)
    (out / WRITING).unlink(missing_ok=True)
    return complete


def _known(out: Path) -> dict[str, set[str]]:
    """The hashes of the files that earlier runs wrote, by name."""
    known: dict[str, set[str]] = {}
    report, writing = _read(out / REPORT), _read(out / WRITING)
    if isinstance(report, dict) and _is_ours(out / REPORT):
        known = {name: {digest} for name, digest in report[FILES].items()}
    if isinstance(writing, dict):
        for name, digests in writing.items():
            known.setdefault(name, set()).update(digests)
    return known


def _is_ours(path: Path) -> bool:
    """Whether a report is as a run wrote it."""
    report = _read(path)
    return isinstance(report, dict) and isinstance(report.get(FILES), dict) and report == with_checksum(report)


def _read(path: Path) -> Any:
    """The value of a JSON file; None where there is none."""
    try:
        return json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError):
        return None
