"""What the command `kit1000 label` does with a folder of own scenes: register, draw, confirm, write truth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kit1000.dataset.mcap_io import ObservationFile
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError, did_you_mean
from kit1000.files import check_writable, write_own
from kit1000.known_shapes.known_kits import KnownKits
from kit1000.known_shapes.registration import register_scene
from kit1000.labelling.label_records import (
    FOLDER,
    LabelRecord,
    confirmed,
    read_record,
    record_of,
    record_path,
    write_record,
)
from kit1000.labelling.labelled_folder import SPLIT, write_truth
from kit1000.labelling.residual_pictures import DrawnBody, residual_picture
from kit1000.perception.sensor_facts import SensorFacts, sensor_of
from kit1000.values import FIRST_PART_LABEL, LabelledDepth


@dataclass(frozen=True, eq=False)
class OwnScenes:
    """A folder of own scenes."""

    root: Path
    scene_ids: tuple[str, ...]
    """The scenes that are worked on."""

    @staticmethod
    def of(root: Path, scene_id: str | None = None) -> OwnScenes:
        """One scene of a folder, or all. Raises InputError for a folder without such scenes, or a generated one."""
        dataset = Dataset(root)
        known = tuple(dataset.shards(SPLIT))
        if (root / "plan.json").is_file():
            raise InputError(f"{root}: a generated dataset, whose truth is known: label folders of `kit1000 import`")
        if not known:
            raise InputError(f"{root}: no scenes in split {SPLIT}")
        if scene_id is not None and scene_id not in known:
            raise InputError(f"{root}: no scene {scene_id!r}; {did_you_mean(scene_id, known)}there are {known[0]} ...")
        return OwnScenes(root, known if scene_id is None else (scene_id,))

    def image(self, scene_id: str, view: str | None = None) -> tuple[str, LabelledDepth, SensorFacts]:
        """The key of a scene's view, the depth image with its masks, and its sensor; None: the first view."""
        dataset = Dataset(self.root)
        shard = dataset.shards(SPLIT)[scene_id]
        file = ObservationFile(self.root / f"{shard}.mcap")
        labels, keys = file.labels(scene_id), file.view_keys(scene_id)
        if labels is None or not keys:
            raise InputError(f"{self.root}: scene {scene_id} has no masks: import the image again")
        key = keys[0] if view is None else view
        return key, LabelledDepth(file.view(scene_id, key), labels), sensor_of(dataset.summary, key, scene_id)


def register(scenes: OwnScenes, kits: KnownKits, parts: Sequence[str] = ()) -> Iterator[LabelRecord]:
    """Register the shapes in each scene, write its record and picture, and yield the record.

    Args:
        scenes: the scenes.
        kits: the shapes that all of them show.
        parts: ids of the parts in them; all of the kits when empty, or fewer where a scene shows fewer.
    """
    check_writable(scenes.root / FOLDER)
    chosen = [kits.shape(name) for name in (parts or [part.id for part in kits.parts])]
    for scene_id in scenes.scene_ids:
        view, image, sensor = scenes.image(scene_id)
        try:
            found = register_scene(image, sensor, kits.kit_shape, chosen)
        except InputError as error:
            raise InputError(f"{scene_id}: {error}") from error
        record = record_of(scene_id, view, kits.source, found)
        store(scenes, record, kits, image)
        yield record


def store(scenes: OwnScenes, record: LabelRecord, kits: KnownKits, image: LabelledDepth) -> None:
    """Write a record and its picture."""
    drawn = [
        DrawnBody(body.name, body.label, kits.shape(body.name).mesh, body.camera_from_body) for body in record.bodies
    ]
    write_own(picture_path(scenes.root, record.scene_id), residual_picture(image, drawn, record.scale, record.scene_id))
    write_record(scenes.root, record)


def picture_path(root: Path, scene_id: str) -> Path:
    """The file of a scene's picture."""
    return record_path(root, scene_id).with_suffix(".png")


def confirm(scenes: OwnScenes, names: Sequence[str], person: str) -> list[LabelRecord]:
    """Confirm bodies of the scenes and write the truth of those whose bodies are all confirmed; returns the records.

    Raises InputError if a scene was not registered yet.
    """
    records = []
    for scene_id in scenes.scene_ids:
        if not record_path(scenes.root, scene_id).is_file():
            raise InputError(f"{scene_id}: no labels to confirm: register the shapes first, then look at the picture")
        records.append(confirmed(read_record(scenes.root, scene_id), names, person))
    for record in records:
        write_record(scenes.root, record)
    return records


def publish(scenes: OwnScenes, records: Sequence[LabelRecord]) -> list[str]:
    """Write the truth of the confirmed records; returns the scenes of the folder that are without truth."""
    complete = {record.scene_id: record for record in records if record.confirmed}
    if not complete:
        return list(Dataset(scenes.root).shards(SPLIT))
    without = write_truth(scenes.root, complete)
    for record in complete.values():
        write_record(scenes.root, numbered_as_written(record))
    return without


def numbered_as_written(record: LabelRecord) -> LabelRecord:
    """A record whose parts have the labels that they get in the masks when truth is written: without gaps."""
    parts = sorted(body.label for body in record.bodies if body.label >= FIRST_PART_LABEL)
    new = {label: FIRST_PART_LABEL + i for i, label in enumerate(parts)}
    return replace(record, bodies=tuple(replace(body, label=new.get(body.label, body.label)) for body in record.bodies))


def report_lines(record: LabelRecord) -> list[str]:
    """What a person is told about a registration: a line for the scale, and one for each body."""
    reach = max(float(np.linalg.norm(body.camera_from_body.xyz)) for body in record.bodies)
    off, spread = (record.scale - 1) * 1e2, record.scale_spread * 1e2
    shift, motion = abs(record.scale - 1) * reach * 1e3, abs(record.scale - 1) * 300
    lines = [
        f"{record.scene_id}: depths are {abs(off):.2f} % too {'far' if off > 0 else 'near'} (± {spread:.2f} %): "
        f"{shift:.1f} mm at {reach:.2f} m, {motion:.1f} mm over a motion of 300 mm; labels are in true lengths"
    ]
    for body in record.bodies:
        what = body.name if body.label < FIRST_PART_LABEL else f"{body.name} (part {body.label - FIRST_PART_LABEL})"
        fit = body.agreement
        numbers = f"{1 - fit.unexplained:.1%} of the pixels explained, depths {fit.depth * 1e3:.1f} mm off"
        state = f"confirmed by {body.confirmed_by}" if body.confirmed_by else ("sure" if body.sure else "not sure: ")
        lines.append(f"  {what}: {numbers}; {state}{'' if body.confirmed_by else '; '.join(body.doubts)}")
    return lines
