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

from kit1000.errors import InputError
from kit1000.files import check_writable, is_url, json_bytes, locked, read_json, sha256, write_bytes, write_json
from kit1000.generation.summary import description_files, summary_bytes
from kit1000.rng import MIN_SECRET_ROOT

HIDDEN_SPLIT = "test"
SECRET_FILE = "withheld.json"  # in the whole folder: salt, commitment and the identity of the open one
BEGUN_FILE = ".begun.json"  # in the open folder while it is being filled: whose open part it is to be
TABLES = ("parts", "kits", "assemblies")


def secret_seed(whole: Path, asked: int | None) -> int:
    """The seed of a dataset whose test split is to stay secret: the one begun with, else the one asked, else drawn.

    Raises InputError for one that can be guessed.
    """
    begun = whole / "plan.json"
    if asked is None and not begun.is_file():
        return secrets.randbits(128) | MIN_SECRET_ROOT
    seed = read_json(begun)["seed"] if asked is None else asked
    if seed < MIN_SECRET_ROOT and asked is None:
        raise InputError(f"--withhold: {whole} was made from seed {seed}, which can be guessed; choose another folder")
    if seed < MIN_SECRET_ROOT:
        raise InputError(
            f"--seed: {seed} can be guessed, and with it the withheld answers; expected at least 2**64, "
            "or leave --seed out: a secret one is drawn and kept in the withheld folder"
        )
    return seed


def check_separate(open_folder: Path, whole: Path) -> None:
    """Raise InputError when the two folders cannot be what they are meant to be."""
    one, other = (folder if is_url(folder) else folder.resolve() for folder in (open_folder, whole))
    if one == other or one in other.parents or other in one.parents:
        raise InputError(f"--withhold: expected a folder apart from --out {open_folder}, got {whole}")
    check_writable(open_folder)
    if not open_folder.is_dir():
        return
    if (open_folder / "plan.json").exists():
        raise InputError(f"{open_folder} holds a whole dataset: choose another --out")
    empty = all(entry.name.startswith(".") for entry in open_folder.iterdir())
    if not empty and not _is_public_part_of(open_folder, whole):
        raise InputError(f"{open_folder} is not empty and holds no open part of {whole}: choose another --out")


def _is_public_part_of(open_folder: Path, whole: Path) -> bool:
    """Whether a folder is the open part of a whole one, finished or begun."""
    if not (whole / SECRET_FILE).is_file():
        return False
    told = [open_folder / name for name in (BEGUN_FILE, "dataset.json") if (open_folder / name).is_file()]
    return bool(told) and read_json(told[0]).get("dataset_id") == read_json(whole / SECRET_FILE)["dataset_id"]


def publish(whole: Path, open_folder: Path) -> dict[str, Any]:
    """Fill the open folder from a finished dataset; returns the contents of its `dataset.json`, written last."""
    summary = read_json(whole / "dataset.json")
    tables = {name: read_json(whole / f"{name}.json") for name in TABLES}
    secret = _secret(whole, summary, tables)
    with locked(open_folder):
        write_json(open_folder / BEGUN_FILE, {"dataset_id": secret["dataset_id"]})
        files = {name: digest for name, digest in summary["files"].items() if _is_public(name, tables)}
        for name, digest in files.items():
            _link_or_copy(whole / name, open_folder / name, digest)
        for name, rows in tables.items():
            kept = {i: row for i, row in rows.items() if row["split"] != HIDDEN_SPLIT}
            files[f"{name}.json"] = write_json(open_folder / f"{name}.json", kept)
        public = _public_summary(summary, secret) | {"files": files}
        for name, data in description_files(public).items():
            files[name] = write_bytes(open_folder / name, data)
        write_bytes(open_folder / "dataset.json", summary_bytes(public))
        (open_folder / BEGUN_FILE).unlink()
    return read_json(open_folder / "dataset.json")


def commitment(salt: str, files: dict[str, str]) -> str:
    """What the open part says of the withheld files, given by their hashes: nothing, before the salt is told."""
    return hashlib.sha256(salt.encode() + json_bytes(files)).hexdigest()


def public_id(salt: str, dataset_id: str) -> str:
    """The identity of the open part: that of the whole one is a hash of the seed, and seeds are tried faster."""
    return hashlib.sha256(salt.encode() + dataset_id.encode()).hexdigest()[:16]


def secret_fault(summary: dict[str, Any], secret: dict[str, Any]) -> str | None:
    """What is wrong with what a whole folder holds in SECRET; None when all of it holds."""
    if not isinstance(secret, dict) or set(secret) != {"salt", "sha256", "dataset_id", "files"}:
        return "no record of what is withheld"
    if any(summary["files"].get(name) != digest for name, digest in secret["files"].items()):
        return "speaks of other files than this dataset has"
    known = commitment(secret["salt"], secret["files"]), public_id(secret["salt"], summary["dataset_id"])
    return None if known == (secret["sha256"], secret["dataset_id"]) else "changed since it was written"


def _is_public(name: str, tables: dict[str, Any]) -> bool:
    """Whether a file may be seen as it is: tables, card and Croissant are written anew."""
    folder, _, rest = name.partition("/")
    if folder in TABLES:
        return tables[folder][Path(rest).stem]["split"] != HIDDEN_SPLIT
    return folder in ("train", "val") or (folder == HIDDEN_SPLIT and not rest.endswith(".truth.mcap"))


def _secret(whole: Path, summary: dict[str, Any], tables: dict[str, Any]) -> dict[str, Any]:
    """Salt, commitment and identity of the open part; drawn once."""
    path = whole / SECRET_FILE
    if path.is_file():
        secret = read_json(path)
        fault = secret_fault(summary, secret)
        if fault is not None:
            raise InputError(f"{path}: {fault}; restore it, or delete it to publish under another identity")
        return secret
    salt = secrets.token_hex(32)
    told = description_files(summary)
    withheld = {i: digest for i, digest in summary["files"].items() if i not in told and not _is_public(i, tables)}
    identity = public_id(salt, summary["dataset_id"])
    secret = {"salt": salt, "sha256": commitment(salt, withheld), "dataset_id": identity, "files": withheld}
    write_json(path, secret)
    return secret


def _public_summary(summary: dict[str, Any], secret: dict[str, Any]) -> dict[str, Any]:
    """The summary as the public may read it."""
    hidden = ("seed", "checksum", "refused", "files")
    public = {key: value for key, value in summary.items() if key not in hidden}
    return public | {
        "dataset_id": secret["dataset_id"],
        "seed": None,
        "refused": {},
        "refused_scenes": {i: why for i, why in summary["refused_scenes"].items() if not i.startswith(HIDDEN_SPLIT)},
        "statistics": {split: rows for split, rows in summary["statistics"].items() if split != HIDDEN_SPLIT},
        "withheld": {"split": HIDDEN_SPLIT, "salted_sha256": secret["sha256"]},
    }


def _link_or_copy(source: Path, target: Path, digest: str) -> None:
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
