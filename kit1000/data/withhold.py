"""Publishing a dataset without the answers of its test split: an open folder beside the whole one.

The open folder holds all of training and validation, and of the test split the observations alone. Its
`dataset.json` commits to what is withheld by a salted hash; salt and seed stay with the whole dataset.
"""

from __future__ import annotations

import hashlib
import os
import secrets
import shutil
from pathlib import Path
from typing import Any

from kit1000.data.files import check_writable, json_bytes, locked, read_json, sha256, write_bytes, write_json
from kit1000.data.summary import described, sealed
from kit1000.errors import InputError

HIDDEN = "test"
SECRET = "withheld.json"  # in the whole folder: salt, commitment and the identity of the open one
GUESSABLE = 2**64  # a seed below can be found by trying: the training meshes tell when it is right
TABLES = ("parts", "kits", "assemblies")


def secret_seed(whole: Path, asked: int | None) -> int:
    """The seed of a dataset whose test split is to stay secret: the one begun with, else the one asked, else drawn.

    Raises InputError for one that can be guessed.
    """
    if asked is not None:
        if asked < GUESSABLE:
            raise InputError(
                f"--seed: {asked} can be guessed, and with it the withheld answers; expected at least 2**64, "
                "or leave --seed out: a secret one is drawn and kept in the withheld folder"
            )
        return asked
    begun = whole / "plan.json"
    return read_json(begun)["seed"] if begun.is_file() else secrets.randbits(128) | GUESSABLE


def check_apart(open_folder: Path, whole: Path) -> None:
    """Raise InputError when the two folders cannot be what they are meant to be."""
    one, other = open_folder.absolute(), whole.absolute()
    if one == other or one in other.parents or other in one.parents:
        raise InputError(f"--withhold: expected a folder apart from --out {open_folder}, got {whole}")
    check_writable(open_folder)
    if open_folder.is_dir() and (open_folder / "plan.json").exists():
        raise InputError(f"{open_folder} holds a whole dataset: choose another --out")
    if open_folder.is_dir() and any(not entry.name.startswith(".") for entry in open_folder.iterdir()):
        found = read_json(open_folder / "dataset.json") if (open_folder / "dataset.json").is_file() else {}
        secret = read_json(whole / SECRET) if (whole / SECRET).is_file() else {}
        if not secret or found.get("dataset_id") != secret["dataset_id"]:
            raise InputError(f"{open_folder} is not empty and holds no open part of {whole}: choose another --out")


def publish(whole: Path, open_folder: Path) -> dict[str, Any]:
    """Fill the open folder from a finished dataset; returns the contents of its `dataset.json`, written last."""
    summary = read_json(whole / "dataset.json")
    tables = {name: read_json(whole / f"{name}.json") for name in TABLES}
    secret = _secret(whole, summary)
    with locked(open_folder):
        files = {name: digest for name, digest in summary["files"].items() if _open(name, tables)}
        for name, digest in files.items():
            _copied(whole / name, open_folder / name, digest)
        for name, rows in tables.items():
            kept = {i: row for i, row in rows.items() if row["split"] != HIDDEN}
            files[f"{name}.json"] = write_json(open_folder / f"{name}.json", kept)
        public = _without_answers(summary, secret) | {"files": files}
        for name, data in described(public).items():
            files[name] = write_bytes(open_folder / name, data)
        write_bytes(open_folder / "dataset.json", sealed(public))
    return read_json(open_folder / "dataset.json")


def _open(name: str, tables: dict[str, Any]) -> bool:
    """Whether a file may be seen as it is: tables, card and Croissant are written anew."""
    folder, _, rest = name.partition("/")
    if folder in TABLES:
        return tables[folder][Path(rest).stem]["split"] != HIDDEN
    return folder in ("train", "val") or (folder == HIDDEN and not rest.endswith(".truth.mcap"))


def _secret(whole: Path, summary: dict[str, Any]) -> dict[str, Any]:
    """Salt, commitment and identity of the open part; drawn once."""
    path = whole / SECRET
    if path.is_file():
        return read_json(path)
    salt = secrets.token_hex(32)
    withheld = {name: digest for name, digest in summary["files"].items() if name.startswith(f"{HIDDEN}/")}
    withheld |= {name: summary["files"][name] for name in ("plan.json", *(f"{table}.json" for table in TABLES))}
    commitment = hashlib.sha256(salt.encode() + json_bytes(withheld)).hexdigest()
    identity = hashlib.sha256(salt.encode() + summary["dataset_id"].encode()).hexdigest()[:16]
    secret = {"salt": salt, "sha256": commitment, "dataset_id": identity, "files": withheld}
    write_json(path, secret)
    return secret


def _without_answers(summary: dict[str, Any], secret: dict[str, Any]) -> dict[str, Any]:
    """The summary as the public may read it."""
    hidden = ("seed", "checksum", "refused", "refused_scenes", "files")
    public = {key: value for key, value in summary.items() if key not in hidden}
    return public | {
        "dataset_id": secret["dataset_id"],
        "seed": None,
        "refused": {},
        "refused_scenes": {},
        "statistics": {split: rows for split, rows in summary["statistics"].items() if split != HIDDEN},
        "withheld": {"split": HIDDEN, "salted_sha256": secret["sha256"]},
    }


def _copied(source: Path, target: Path, digest: str) -> None:
    """A file in a second place, without a second copy of its bytes where the disk can do that."""
    if sha256(target) == digest:
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    target.unlink(missing_ok=True)
    try:
        os.link(source, target)
    except (OSError, TypeError):  # another disk, or no disk at all
        with source.open("rb") as reader, target.open("wb") as writer:
            shutil.copyfileobj(reader, writer)
