"""Labels of a scene before and after a person confirms them: one JSON file a scene, in the folder `labels`.

A record holds where its shapes come from, the pose of each body in the camera frame and in true lengths, how well it
explains the image, and who confirmed it. Truth is written from confirmed records alone.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from kit1000.dataset.json_rows import Row, pose_of, pose_row
from kit1000.dataset.own_scenes import LABELS
from kit1000.errors import InputError
from kit1000.files import json_bytes, read_json, write_bytes
from kit1000.known_shapes.registration import Agreement, RegisteredScene
from kit1000.pose import Pose

FORMAT = "kit1000-label/2"
FOLDER = LABELS
FILES = ("shapes", "kit", "part")  # keys of a source that are paths, in a file relative to the dataset's folder


@dataclass(frozen=True, eq=False)
class LabelledBody:
    """A body of a record."""

    name: str
    """`kits`, or the id of a part."""
    label: int
    """Its value in the masks; a part that no mask shows has one beyond them."""
    camera_from_body: Pose
    agreement: Agreement
    doubts: tuple[str, ...]
    """Why the image alone does not settle the pose; empty if it does."""
    moved: bool = False
    """Whether a person moved it."""
    confirmed_by: str | None = None
    """Name of who confirmed it."""

    @property
    def sure(self) -> bool:
        """Whether the image alone settles the pose."""
        return not self.doubts


@dataclass(frozen=True, eq=False)
class LabelRecord:
    """The labels of a scene."""

    scene_id: str
    view: str
    """Key of the view that was labelled."""
    source: dict[str, Any]
    """Where the shapes come from, see `kit1000.known_shapes.known_kits.read_known_kits`."""
    scale: float
    scale_spread: float
    bodies: tuple[LabelledBody, ...]
    """The kits first."""

    @property
    def confirmed(self) -> bool:
        """Whether a person confirmed all bodies."""
        return all(body.confirmed_by for body in self.bodies)


def record_of(scene_id: str, view: str, source: dict[str, Any], scene: RegisteredScene) -> LabelRecord:
    """The record of a registration."""
    free = itertools.count(1 + max(body.label for body in scene.bodies))
    bodies = tuple(
        LabelledBody(
            body.name,
            body.label or next(free),
            scene.camera_from_body(body),
            body.agreement,
            scene.doubts(body),
        )
        for body in scene.bodies
    )
    return LabelRecord(scene_id, view, source, scene.scale, scene.scale_spread, bodies)


def confirmed(record: LabelRecord, names: Sequence[str], person: str) -> LabelRecord:
    """A record of which a person confirms some bodies: `all`, `sure`, or by name. Raises InputError for others."""
    known = [body.name for body in record.bodies]
    unknown = sorted(set(names) - {"all", "sure", *known})
    if unknown:
        raise InputError(f"--confirm {unknown[0]}: {record.scene_id} has {', '.join(known)}; or all, or sure")
    if not person.strip():
        raise InputError("--by: expected the name of who confirms")

    def chosen(body: LabelledBody) -> bool:
        return "all" in names or body.name in names or ("sure" in names and body.sure)

    bodies = (replace(body, confirmed_by=person) if chosen(body) else body for body in record.bodies)
    return replace(record, bodies=tuple(bodies))


def record_path(root: Path, scene_id: str) -> Path:
    """The file of a scene's labels."""
    return root / FOLDER / f"{scene_id}.json"


def write_record(root: Path, record: LabelRecord) -> Path:
    """Write a record; returns its file."""
    path = record_path(root, record.scene_id)
    row = {
        "format": FORMAT,
        "scene_id": record.scene_id,
        "view": record.view,
        "shapes": {key: _relative(value, root) if key in FILES else value for key, value in record.source.items()},
        "scale": record.scale,
        "scale_spread": record.scale_spread,
        "bodies": [_body_row(body) for body in record.bodies],
    }
    write_bytes(path, json_bytes(row))
    return path


def read_record(root: Path, scene_id: str) -> LabelRecord:
    """The record of a scene. Raises InputError if it is missing or damaged."""
    path = record_path(root, scene_id)
    row = read_json(path)
    found = row.get("format") if isinstance(row, dict) else None
    if found != FORMAT:
        raise InputError(f"{path}: format {found!r}, expected {FORMAT!r}: label the scene again")
    try:
        bodies = tuple(map(_body_of, row["bodies"]))
        numbers = float(row["scale"]), float(row["scale_spread"])
        shapes = {key: str((root / v).resolve()) if key in FILES else v for key, v in row["shapes"].items()}
        return LabelRecord(row["scene_id"], row["view"], shapes, *numbers, bodies)
    except (KeyError, TypeError, ValueError, InputError) as error:
        raise InputError(f"{path}: damaged ({type(error).__name__}: {error}): label the scene again") from error


def _relative(path: str, root: Path) -> str:
    """A path from a folder: records are published, and whose home it is says nothing."""
    return Path(os.path.relpath(Path(path).resolve(), root.resolve())).as_posix()


def _body_row(body: LabelledBody) -> Row:
    plain = {key: getattr(body, key) for key in ("name", "label", "moved", "confirmed_by")}
    return plain | {
        "camera_from_body": pose_row(body.camera_from_body),
        "agreement": asdict(body.agreement),
        "doubts": list(body.doubts),
    }


def _body_of(row: Row) -> LabelledBody:
    rest = {key: row[key] for key in ("name", "label", "moved", "confirmed_by")}
    return LabelledBody(
        camera_from_body=pose_of(row["camera_from_body"]),
        agreement=Agreement(**row["agreement"]),
        doubts=tuple(row["doubts"]),
        **rest,
    )
