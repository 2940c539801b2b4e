"""Tests of verification: any changed byte is found and named, and scenes generated again are equal, or are named."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kit1000.cli import main
from kit1000.dataset.geometry import Geometry
from kit1000.dataset.json_rows import pose_of, pose_row
from kit1000.dataset.mcap_io import ObservationFile, ObservationWriter, TruthFile, TruthWriter
from kit1000.errors import InputError
from kit1000.files import json_bytes, read_json
from kit1000.generation.build import generate
from kit1000.generation.dataset_summary import library_versions, summary_bytes
from kit1000.generation.plan import dataset_id
from kit1000.generation.verify import scene_differences, verify, version_differences
from kit1000.pose import Pose
from tests.samples.mini import MINI, file_hashes, l_shape_sources


@pytest.fixture
def copy(mini: Path, tmp_path: Path) -> Path:
    """A dataset that a test may change."""
    return shutil.copytree(mini, tmp_path / "copy")


@pytest.fixture(scope="module")
def mesh_file_dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset whose parts are from mesh files."""
    folder = tmp_path_factory.mktemp("of_files")
    generate(replace(MINI, train=1), folder / "data", workers=1, sources=l_shape_sources(folder / "files"))
    return folder / "data"


def flip_bit(path: Path, place: int) -> None:
    data = bytearray(path.read_bytes())
    data[place] ^= 1 << place % 8
    path.write_bytes(data)


def only_fault(root: Path) -> str:
    """The only fault of a folder, or the error, as text."""
    try:
        (fault,) = verify(root).faults
        return fault
    except InputError as error:
        return str(error)


def test_an_intact_dataset_passes(mini: Path) -> None:
    report = verify(mini)
    assert report.faults == report.notes == report.rebuilt == ()
    assert report.files == len(file_hashes(mini)) - 1


def test_a_changed_byte_is_found_and_named_in_any_file(copy: Path) -> None:
    names = sorted(file_hashes(copy))
    assert {"dataset.json", "README.md", "croissant.json", "plan.json", "parts.json", "test/0000.three.mcap"} < set(
        names
    )
    rng = np.random.default_rng(0)
    for name in names:
        before = (copy / name).read_bytes()
        flip_bit(copy / name, int(rng.integers(len(before))))
        assert name in only_fault(copy)
        (copy / name).write_bytes(before)
    assert is_intact(copy)


def is_intact(root: Path) -> bool:
    return verify(root).faults == ()


def test_a_changed_byte_anywhere_in_the_index_is_found(copy: Path) -> None:
    path = copy / "dataset.json"
    before = path.read_bytes()
    for place in range(0, len(before), 41):
        flip_bit(path, place)
        assert "dataset.json" in only_fault(copy)
        path.write_bytes(before)


def test_missing_and_extra_files_are_named(copy: Path) -> None:
    (copy / "kits/val-0000.glb").unlink()
    (copy / "notes.txt").touch()
    (copy / "train/0001.mcap").touch()
    assert verify(copy).faults == (
        "kits/val-0000.glb: missing or unreadable",
        "notes.txt: not a file of this dataset",
        "train/0001.mcap: not a file of this dataset",
    )


def test_hidden_files_are_ignored(copy: Path) -> None:
    (copy / ".cache/hub").mkdir(parents=True)
    (copy / ".cache/hub/record").touch()
    (copy / ".gitattributes").touch()
    assert is_intact(copy)


def test_the_plan_of_another_dataset_is_found(copy: Path) -> None:
    plan = read_json(copy / "plan.json")
    replace_file(copy, "plan.json", json_bytes(plan | {"seed": 8}))
    assert only_fault(copy) == "plan.json: of another dataset"


def replace_file(root: Path, name: str, data: bytes) -> None:
    """Change a file, and its hash and checksum in dataset.json."""
    (root / name).write_bytes(data)
    summary = read_json(root / "dataset.json")
    summary["files"][name] = sha256(data).hexdigest()
    (root / "dataset.json").write_bytes(summary_bytes(summary))


def recorded_as(root: Path, made_with: dict[str, str] | None) -> Path:
    """The dataset as if it had been made with other versions of libraries; None: as if it did not say."""
    summary = {key: value for key, value in read_json(root / "dataset.json").items() if key != "made_with"}
    (root / "dataset.json").write_bytes(summary_bytes(summary | ({"made_with": made_with} if made_with else {})))
    return root


def test_versions_of_libraries_are_recorded_outside_identity(copy: Path) -> None:
    before = read_json(copy / "dataset.json")
    assert version_differences(before) == []
    assert {"python", "manifold3d", "numpy", "scipy", "pybullet"} < set(before["made_with"])
    recorded_as(copy, before["made_with"] | {"manifold3d": "3.2.0", "python": "3.9.0"})
    after = read_json(copy / "dataset.json")
    assert (after["dataset_id"], after["checksum"]) == (before["dataset_id"], before["checksum"])
    assert version_differences(after) == [f"manifold3d 3.2.0, here {before['made_with']['manifold3d']}"]
    assert is_intact(copy)


@pytest.mark.parametrize(("made_with", "faults"), [({}, 1), ({"manifold3d": "3.2.0"}, 0), (None, 1)])
def test_differences_are_no_faults_if_another_library_explains_them(
    copy: Path, monkeypatch: pytest.MonkeyPatch, made_with: dict | None, faults: int
) -> None:
    monkeypatch.setattr("kit1000.generation.verify.scene_differences", lambda *_: ["parts/val-0000.glb"])
    report = verify(recorded_as(copy, None if made_with is None else library_versions() | made_with), 1)
    assert len(report.faults) == faults
    assert any("manifold3d" in note for note in report.notes) == bool(made_with)
    assert any("parts/val-0000.glb" in line for line in (*report.faults, *report.notes))
    flip_bit(copy / "parts.json", 40)  # damage stays a fault
    assert verify(copy, 1).faults == ("parts.json: changed since it was written",)


def test_a_scene_generated_again_is_equal_to_the_bit(mini: Path) -> None:
    assert scene_differences(Geometry(mini), read_json(mini / "plan.json"), "test-s0000") == []


@pytest.mark.slow
def test_all_scenes_generated_again_are_equal_to_the_bit(mini: Path) -> None:
    report = verify(mini, sample=99)
    assert report.rebuilt == ("test-s0000", "train-s0000", "train-s0001", "val-s0000")
    assert report.faults == ()


def test_scenes_of_parts_from_files_are_generated_again(mesh_file_dataset: Path) -> None:
    report = verify(mesh_file_dataset, sample=3)
    assert len(report.rebuilt) == 3
    assert report.faults == ()
    assert report.notes == ("parts are from mesh files: stored parts are used",)


def change_part(root: Path) -> str:
    """Move a part in the truth of the validation scene, with all hashes; returns what differs."""
    path = root / "val/0000.truth.mcap"
    truth = TruthFile(path).truth("val-s0000")
    first, *others = truth.parts
    moved = first | {"world_from_part": shifted(first["world_from_part"])}
    with TruthWriter(path) as writer:
        writer.add(replace(truth, parts=(moved, *others)))
    replace_file(root, "val/0000.truth.mcap", path.read_bytes())
    return "val/0000.truth.mcap: another content"


def change_depth(root: Path) -> str:
    """Move a pixel by a step of the depth grid."""
    path = root / "val/0000.mcap"
    observation = ObservationFile(path).observation("val-s0000")
    view = observation.views["d415"]
    depth = view.depth.copy()
    depth[100, 100] += np.float32(2**-13)
    with ObservationWriter(path) as writer:
        writer.add(replace(observation, views={**observation.views, "d415": replace(view, depth=depth)}))
    replace_file(root, "val/0000.mcap", path.read_bytes())
    return "val/0000.mcap: another content"


def change_goal(root: Path) -> str:
    kits = read_json(root / "kits.json")
    kits["val-0000"]["goals"][0] = shifted(kits["val-0000"]["goals"][0])
    replace_file(root, "kits.json", json_bytes(kits))
    return "part val-0000: another row"


def change_mesh(root: Path) -> str:
    replace_file(root, "parts/val-0000.glb", (root / "parts/train-0000.glb").read_bytes())
    return "parts/val-0000.glb"


def shifted(row: dict[str, Any]) -> dict[str, Any]:
    return pose_row(Pose.from_translation([5e-5, 0.0, 0.0]) @ pose_of(row))


@pytest.mark.parametrize("change", [change_part, change_depth, change_goal, change_mesh])
def test_what_was_changed_with_all_its_hashes_is_found(copy: Path, change: Callable[[Path], str]) -> None:
    expected = change(copy)
    assert is_intact(copy)
    assert scene_differences(Geometry(copy), read_json(copy / "plan.json"), "val-s0000") == [expected]


def test_content_of_another_version_is_not_generated_again(copy: Path) -> None:
    plan = read_json(copy / "plan.json") | {"data_version": "0.1.9"}
    replace_file(copy, "plan.json", json_bytes(plan))
    summary = read_json(copy / "dataset.json") | {"dataset_id": dataset_id(plan)}
    (copy / "dataset.json").write_bytes(summary_bytes(summary))
    report = verify(copy, sample=1)
    assert (report.faults, report.rebuilt) == ((), ())
    assert "0.1.9" in report.notes[0]


def test_the_command_prints_the_faults(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verify", str(copy), "--sample", "0"]) == 0
    count = len(file_hashes(copy)) - 1
    assert capsys.readouterr().out == f"{count} files checked, 0 scenes generated again (none)\nfaults: none\n"
    flip_bit(copy / "kits.json", 9)
    assert main(["verify", str(copy)]) == 1
    assert capsys.readouterr().out.splitlines() == [
        "kits.json: changed since it was written",
        f"{count} files checked, 0 scenes generated again (none)",
        "note: no scene generated again: files are damaged",
        "faults: 1",
    ]
