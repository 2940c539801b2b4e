"""Records of labels: round trips, confirmation by name, and damaged files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from kit1000.errors import InputError
from kit1000.labelling.label_records import LabelRecord, confirmed, read_record, record_path, write_record
from tests.samples.labelled_scenes import SCENE, sample_scene, true_record

SOURCE = {"shapes": "/prints", "assembly": "bracket"}


def same(a: LabelRecord, b: LabelRecord) -> bool:
    poses = all(
        np.array_equal(one.camera_from_body.matrix(), other.camera_from_body.matrix())
        for one, other in zip(a.bodies, b.bodies, strict=True)
    )
    rest = [[(x.name, x.label, x.agreement, x.doubts, x.moved, x.confirmed_by) for x in r.bodies] for r in (a, b)]
    return poses and rest[0] == rest[1] and (a.scene_id, a.view, a.source, a.scale) == (
        b.scene_id, b.view, b.source, b.scale)  # fmt: skip


def test_a_record_is_read_as_it_was_written(tmp_path: Path) -> None:
    record = true_record(sample_scene(), SOURCE, "A. Person")
    assert write_record(tmp_path, record) == record_path(tmp_path, SCENE)
    assert same(read_record(tmp_path, SCENE), record)


def test_a_record_names_shapes_from_its_folder_and_moves_with_them(tmp_path: Path) -> None:
    before, after = tmp_path / "before", tmp_path / "after"
    source = {"kit": str(before / "print/kit.stl"), "part": str(before / "print/part.stl"), "clearance": 1e-3}
    path = write_record(before / "scenes", true_record(sample_scene(), source, "A. Person"))
    assert str(tmp_path) not in path.read_text()  # whose home it is says nothing
    before.rename(after)
    moved = source | {name: str(after / f"print/{name}.stl") for name in ("kit", "part")}
    assert read_record(after / "scenes", SCENE).source == moved


def test_a_person_confirms_all_the_sure_or_some() -> None:
    record = true_record(sample_scene(), SOURCE)
    assert not record.confirmed
    assert confirmed(record, ["all"], "A").confirmed
    assert confirmed(record, ["sure"], "A").confirmed  # none has a doubt
    one = confirmed(record, ["tee"], "A")
    assert [body.confirmed_by for body in one.bodies] == [None, None, "A"]
    assert confirmed(one, ["kits", "bracket"], "B").confirmed
    with pytest.raises(InputError, match=r"--confirm teee: .*kits, bracket, tee; or all, or sure"):
        confirmed(record, ["teee"], "A")
    with pytest.raises(InputError, match="--by"):
        confirmed(record, ["all"], "  ")


@pytest.mark.parametrize(
    "damage",
    [
        lambda row: row.pop("bodies"),
        lambda row: row["bodies"][0].pop("camera_from_body"),
        lambda row: row["bodies"][0]["agreement"].update(more=1.0),
        lambda row: row["bodies"][1]["camera_from_body"].update(wxyz=[0, 0, 0, 0]),
        lambda row: row.update(format="kit1000-label/0"),
        lambda row: row.update(scale="far"),
    ],
)
def test_a_damaged_record_says_to_label_again(damage, tmp_path: Path) -> None:
    path = write_record(tmp_path, true_record(sample_scene(), SOURCE))
    row = json.loads(path.read_bytes())
    damage(row)
    path.write_text(json.dumps(row))
    with pytest.raises(InputError, match=r"test-s0000.json: .*label the scene again"):
        read_record(tmp_path, SCENE)


def test_a_missing_record_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no file"):
        read_record(tmp_path, SCENE)
