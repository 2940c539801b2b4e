"""Publishing a dataset without the ground truth of its test split: a public folder beside the full one.

The public folder has everything of training and validation, and only the observations of the test split. Its
`dataset.json` commits to the withheld files by a salted hash; salt and seed stay in the full folder.

Every test scene has the queries of one track, and only the depth images of that track's sensor. Guesses about one part
from several tracks would narrow down its goal. A guess would reveal the slot to tracks that have no guess, and an image
without noise would reveal the answer to tracks with noisy images.
"""

from __future__ import annotations

import hashlib
import os
import secrets
import shutil
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from kit1000.dataset.mcap_io import ObservationFile, ObservationWriter
from kit1000.dataset.reader import WITHHELD_FILE
from kit1000.dataset.scene_data import Observation
from kit1000.errors import InputError
from kit1000.files import check_writable, json_bytes, locked, read_json, sha256, write_bytes, write_json
from kit1000.generation.dataset_summary import description_files, summary_bytes
from kit1000.generation.presets import Preset
from kit1000.generation.scene_files import EXTRA_VIEWS, OBSERVATIONS
from kit1000.pictures.scene_preview import scene_picture
from kit1000.rng import MIN_SECRET_ROOT, ROOT_LIMIT

HIDDEN_SPLIT = "test"
SALT_BYTES = 32  # as long as the hash: a shorter salt could be found by trial, and then a guessed seed tested
BEGUN_FILE = ".begun.json"  # in the public folder until it is complete: the id of its dataset
TABLES = ("parts", "kits", "assemblies")


def secret_seed(full: Path, given: int | None) -> int:
    """The seed of a dataset with a withheld test split: the given one, else that of its plan, else a random one.

    Raises InputError for a seed of fewer than 128 bits, which can be guessed.
    """
    plan = full / "plan.json"
    if given is None and not plan.is_file():
        return MIN_SECRET_ROOT + secrets.randbelow(ROOT_LIMIT - MIN_SECRET_ROOT)
    seed = read_json(plan)["seed"] if given is None else given
    if seed < MIN_SECRET_ROOT and given is None:
        raise InputError(
            f"--withhold: {full} was made from seed {seed}, which can be guessed: it has fewer than 128 bits; "
            "choose another folder"
        )
    if seed < MIN_SECRET_ROOT:
        raise InputError(
            f"--seed: {seed} can be guessed, and with it the withheld ground truth; expected at least 2**127, "
            "a number of 128 bits, or leave --seed out: a secret one is drawn and kept in the withheld folder"
        )
    return seed


def withheld_preset(preset: Preset) -> Preset:
    """The preset of a dataset with a withheld test split: one track a scene, and no curves."""
    return replace(preset, curve_scenes=0, one_track=True)


def check_separate(public_folder: Path, full: Path) -> None:
    """Raise InputError unless the public folder is outside the full one, writable, and empty or its public part."""
    one, other = public_folder.resolve(), full.resolve()
    if one == other or one in other.parents or other in one.parents:
        raise InputError(f"--withhold: expected a folder outside --out {public_folder}, got {full}")
    check_writable(public_folder)
    if not public_folder.is_dir():
        return
    if (public_folder / "plan.json").exists():
        raise InputError(f"{public_folder} contains a full dataset: choose another --out")
    empty = all(entry.name.startswith(".") for entry in public_folder.iterdir())
    if not empty and not _is_public_part_of(public_folder, full):
        raise InputError(f"{public_folder} is not empty and contains no public part of {full}: choose another --out")


def _is_public_part_of(public_folder: Path, full: Path) -> bool:
    """Whether a folder is the public part of a full one, finished or not."""
    if not (full / WITHHELD_FILE).is_file():
        return False
    present = [public_folder / name for name in (BEGUN_FILE, "dataset.json") if (public_folder / name).is_file()]
    return bool(present) and read_json(present[0]).get("dataset_id") == read_json(full / WITHHELD_FILE)["dataset_id"]


def publish(full: Path, public_folder: Path) -> dict[str, Any]:
    """Fill the public folder from a finished dataset; returns the contents of its `dataset.json`, written last."""
    summary = read_json(full / "dataset.json")
    tables = {name: read_json(full / f"{name}.json") for name in TABLES}
    secret = _secret(full, summary, tables)
    with locked(public_folder):
        write_json(public_folder / BEGUN_FILE, {"dataset_id": secret["dataset_id"]})
        files = {name: digest for name, digest in summary["files"].items() if _is_public(name, tables)}
        for name, digest in files.items():
            link_or_copy(full / name, public_folder / name, digest)
        files |= _publish_recordings(full, public_folder, summary["shards"])
        for name, rows in tables.items():
            public_rows = {i: row for i, row in rows.items() if row["split"] != HIDDEN_SPLIT}
            files[f"{name}.json"] = write_json(public_folder / f"{name}.json", public_rows)
        public = _public_summary(summary, secret) | {"files": files}
        for name, data in description_files(public).items():
            files[name] = write_bytes(public_folder / name, data)
        write_bytes(public_folder / "dataset.json", summary_bytes(public))
        (public_folder / BEGUN_FILE).unlink()
    return read_json(public_folder / "dataset.json")


def commitment(salt: str, files: dict[str, str]) -> str:
    """SHA-256 of the salt and the hashes of the withheld files; it reveals nothing until the salt is published."""
    return hashlib.sha256(salt.encode() + json_bytes(files)).hexdigest()


def public_id(salt: str, dataset_id: str) -> str:
    """The id of the public dataset: salted, as the id of the full one would allow testing of guessed seeds."""
    return hashlib.sha256(salt.encode() + dataset_id.encode()).hexdigest()[:16]


def secret_fault(summary: dict[str, Any], secret: dict[str, Any]) -> str | None:
    """What is wrong with the contents of WITHHELD_FILE in a full folder; None when they are consistent."""
    if not isinstance(secret, dict) or set(secret) != {"salt", "sha256", "dataset_id", "files"}:
        return "no record of what is withheld"
    if any(summary["files"].get(name) != digest for name, digest in secret["files"].items()):
        return "lists other files than this dataset has"
    known = commitment(secret["salt"], secret["files"]), public_id(secret["salt"], summary["dataset_id"])
    return None if known == (secret["sha256"], secret["dataset_id"]) else "changed since it was written"


def _is_public(name: str, tables: dict[str, Any]) -> bool:
    """Whether a file is published unchanged; tables, test recordings, data card and Croissant file are written for the
    public folder."""
    folder, _, rest = name.partition("/")
    if folder in TABLES:
        return tables[folder][Path(rest).stem]["split"] != HIDDEN_SPLIT
    return folder in ("train", "val")


def _publish_recordings(full: Path, public_folder: Path, shards: Iterable[str]) -> dict[str, str]:
    """Write the observations of the hidden split for the public folder; returns the SHA-256 of each file."""
    files = {}
    for name in (name for name in shards if name.startswith(f"{HIDDEN_SPLIT}/")):
        primary = ObservationFile(full / name)
        sensors = {i: {row["sensor"] for row in primary.queries(i)} for i in primary.scene_ids}
        for path in (name, name.removesuffix(OBSERVATIONS) + EXTRA_VIEWS):
            if not (full / path).is_file():
                continue
            recording = ObservationFile(full / path)
            with ObservationWriter(public_folder / path) as writer:
                for scene_id in recording.scene_ids:
                    writer.add(_with_sensors(recording.observation(scene_id), sensors[scene_id]))
            assert writer.sha256 is not None, "a shard has a scene"
            files[path] = writer.sha256
    return files


def _with_sensors(observation: Observation, sensors: set[str]) -> Observation:
    """An observation without the views of other sensors, its preview drawn from the rest."""
    views = {key: view for key, view in observation.views.items() if key.rpartition("/")[2] in sensors}
    seen = replace(observation, views=views, preview=None)
    return seen if observation.preview is None else replace(seen, preview=scene_picture(seen))


def _secret(full: Path, summary: dict[str, Any], tables: dict[str, Any]) -> dict[str, Any]:
    """Salt, commitment and public id; read from WITHHELD_FILE, or drawn and written there."""
    path = full / WITHHELD_FILE
    if path.is_file():
        secret = read_json(path)
        fault = secret_fault(summary, secret)
        if fault is not None:
            raise InputError(f"{path}: {fault}; restore it, or delete it to publish under another identity")
        return secret
    salt = secrets.token_hex(SALT_BYTES)
    rewritten = description_files(summary)
    withheld = {i: digest for i, digest in summary["files"].items() if i not in rewritten and not _is_public(i, tables)}
    dataset_id = public_id(salt, summary["dataset_id"])
    secret = {"salt": salt, "sha256": commitment(salt, withheld), "dataset_id": dataset_id, "files": withheld}
    write_json(path, secret)
    return secret


def _public_summary(summary: dict[str, Any], secret: dict[str, Any]) -> dict[str, Any]:
    """The contents of the public `dataset.json`, without `files`."""
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


def link_or_copy(source: Path, target: Path, digest: str) -> None:
    """Hard-link a file to a second place, or copy it where links are not possible."""
    if sha256(target) == digest:
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    target.unlink(missing_ok=True)
    try:
        os.link(source, target)
    except (OSError, TypeError):  # another disk, or no disk at all
        with source.open("rb") as reader, target.open("wb") as writer:
            shutil.copyfileobj(reader, writer)
