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
from kit1000.dataset.mcap_io import ObservationFile, ObservationWriter, TruthFile, TruthWriter
from kit1000.dataset.schema import Observation, SceneTruth
from kit1000.dataset.tables import pose_of, pose_row
from kit1000.errors import InputError
from kit1000.files import json_bytes, read_json
from kit1000.generation import rebuild
from kit1000.generation.build import generate
from kit1000.generation.dataset_summary import summary_bytes
from kit1000.generation.library_versions import library_versions, version_differences
from kit1000.generation.rebuild import (
    observation_differences,
    preview_differences,
    scene_differences,
    truth_differences,
)
from kit1000.generation.verify import verify
from kit1000.pose import Pose
from kit1000.values import View
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


def test_a_number_that_becomes_infinite_is_found(copy: Path) -> None:
    path = copy / "dataset.json"
    path.write_bytes(path.read_bytes().replace(b"0.0025", b"1e9999"))
    assert only_fault(copy) == "dataset.json: changed since it was written"


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


def test_differences_are_no_faults_where_another_library_explains_them(
    copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("kit1000.generation.verify.scene_differences", lambda *_: ["part: other triangles"])
    made_with = read_json(copy / "dataset.json")["made_with"]
    assert len(verify(copy, 1).faults) == 1
    report = verify(recorded_as(copy, made_with | {"manifold3d": "3.2.0"}), 1)
    assert report.faults == ()
    assert report.notes[0].endswith(": part: other triangles")
    assert "manifold3d 3.2.0, here " in report.notes[1]
    flip_bit(copy / "parts.json", 40)
    assert verify(copy, 1).faults == ("parts.json: changed since it was written",)


def test_differences_of_a_dataset_without_versions_are_faults_with_a_note(
    copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("kit1000.generation.verify.scene_differences", lambda *_: ["part: other triangles"])
    report = verify(recorded_as(copy, None), 1)
    assert len(report.faults) == 1
    assert "another version than manifold3d " in report.notes[0]
    here = library_versions() | {"manifold3d": "3.4.1"}
    monkeypatch.setattr("kit1000.generation.library_versions.library_versions", lambda: here)
    report = verify(copy, 1)
    assert report.faults == ()
    assert "manifold3d 3.5, here 3.4.1" in report.notes[1]


def without_tolerance(patch: pytest.MonkeyPatch) -> None:
    """Set all tolerances to zero."""
    for name, value in {"DEPTH_TOLERANCE": 0, "MATCHING_PIXELS": 1, "POSE_TOLERANCE": 0, "SIZE_TOLERANCE": 0}.items():
        patch.setattr(rebuild, name, value)
    patch.setattr(rebuild, "TOLERANCES", {})


def test_a_scene_generated_again_is_equal_to_the_bit(mini: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    without_tolerance(monkeypatch)
    assert scene_differences(Geometry(mini), read_json(mini / "plan.json"), "val-s0000") == []


@pytest.mark.slow
def test_all_scenes_generated_again_are_equal_to_the_bit(mini: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    without_tolerance(monkeypatch)
    report = verify(mini, sample=99)
    assert report.rebuilt == ("test-s0000", "train-s0000", "train-s0001", "val-s0000")
    assert report.faults == ()


def test_scenes_of_parts_from_files_are_generated_again(
    mesh_file_dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_tolerance(monkeypatch)
    report = verify(mesh_file_dataset, sample=3)
    assert len(report.rebuilt) == 3
    assert report.faults == ()
    assert report.notes == ("parts are from mesh files: stored parts are used",)


def test_a_sample_is_always_the_same(mesh_file_dataset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("kit1000.generation.verify.scene_differences", lambda *_: [])
    samples = [verify(mesh_file_dataset, sample).rebuilt for sample in (1, 2, 3)]
    assert samples == [verify(mesh_file_dataset, sample).rebuilt for sample in (1, 2, 3)]
    assert set(samples[0]) < set(samples[1]) < set(samples[2])


def change_truth(root: Path, change: Callable[[SceneTruth], SceneTruth]) -> None:
    """Change the truth of the validation scene, and its hashes."""
    truth = change(TruthFile(root / "val/0000.truth.mcap").truth("val-s0000"))
    with TruthWriter(root / "val/0000.truth.mcap") as writer:
        writer.add(truth)
    replace_file(root, "val/0000.truth.mcap", (root / "val/0000.truth.mcap").read_bytes())


def test_a_pose_changed_with_all_its_hashes_is_found(
    mesh_file_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = shutil.copytree(mesh_file_dataset, tmp_path / "copy")
    change_truth(root, lambda truth: with_part(truth, "world_from_part", shifted))
    assert is_intact(root)
    assert main(["verify", str(root), "--sample", "99"]) == 1
    (fault,) = (line for line in capsys.readouterr().out.splitlines() if "differ" in line)
    assert fault.endswith("val-s0000: part 0: differs")


def test_a_depth_changed_with_all_its_hashes_is_found(mesh_file_dataset: Path, tmp_path: Path) -> None:
    root = shutil.copytree(mesh_file_dataset, tmp_path / "copy")
    observation = ObservationFile(root / "val/0000.mcap").observation("val-s0000")
    with ObservationWriter(root / "val/0000.mcap") as writer:
        writer.add(
            with_view(
                observation,
                "d415",
                lambda view: View(view.camera, view.world_from_camera, with_raised_strip(view.depth)),
            )
        )
    replace_file(root, "val/0000.mcap", (root / "val/0000.mcap").read_bytes())
    assert is_intact(root)
    faults = scene_differences(Geometry(root), read_json(root / "plan.json"), "val-s0000")
    assert faults == ["d415: depths differ"]


def test_another_preview_is_named(mini: Path, recorded: tuple[Observation, SceneTruth]) -> None:
    seen, truth = recorded
    mesh = Geometry(mini).part(truth.assembly_id).mesh
    assert preview_differences(seen, truth, mesh) == []
    swapped = replace(seen, preview=truth.preview), replace(truth, preview=seen.preview)
    assert preview_differences(*swapped, mesh) == ["preview differs", "preview of the goals differs"]
    assert preview_differences(replace(seen, preview=None), truth, mesh) == ["preview differs"]


def test_a_goal_changed_with_all_its_hashes_is_found(copy: Path) -> None:
    kits = read_json(copy / "kits.json")
    kits["val-0000"]["goals"][0] = shifted(kits["val-0000"]["goals"][0])
    replace_file(copy, "kits.json", json_bytes(kits))
    assert is_intact(copy)
    faults = scene_differences(Geometry(copy), read_json(copy / "plan.json"), "val-s0000")
    assert faults == ["kit val-0000: differs"]


def with_raised_strip(depth: np.ndarray) -> np.ndarray:
    """A strip of two hundredths of an image (H, W) moved by three steps of the grid."""
    moved = depth.copy()
    moved[: len(moved) // 50] += np.float32(3 * 2**-13)
    return moved


def shifted(row: dict[str, Any], metres: float = 5e-5) -> dict[str, Any]:
    return pose_row(Pose.from_translation([metres, 0.0, 0.0]) @ pose_of(row))


def with_view(observation: Observation, key: str, change: Callable[[View], View]) -> Observation:
    return replace(observation, views={**observation.views, key: change(observation.views[key])})


def with_query(observation: Observation, key: str, change: Callable[[Any], Any]) -> Observation:
    first, *others = observation.queries
    return replace(observation, queries=({**first, key: change(first[key])}, *others))


def with_part(truth: SceneTruth, key: str, change: Callable[[Any], Any]) -> SceneTruth:
    first, *others = truth.parts
    return replace(truth, parts=({**first, key: change(first[key])}, *others))


def moved(view: View, metres: float) -> View:
    return View(view.camera, Pose(view.world_from_camera.wxyz, view.world_from_camera.xyz + metres), view.depth)


def with_changed_pixels(image: np.ndarray, share: float) -> np.ndarray:
    """A share of the pixels of an image (H, W) changed."""
    changed = image.copy()
    changed.ravel()[: round(share * image.size)] += 1
    return changed


OBSERVATION_CHANGES: dict[str, Callable[[Observation], Observation]] = {
    "d415: depths differ": lambda observation: with_view(
        observation, "d415", lambda view: replace(view, depth=with_raised_strip(view.depth))
    ),
    "ideal: another camera pose": lambda observation: with_view(observation, "ideal", lambda view: moved(view, 3e-5)),
    "ideal: another camera": lambda observation: with_view(
        observation, "ideal", lambda view: replace(view, camera=replace(view.camera, fx=926.0))
    ),
    "masks differ": lambda observation: replace(observation, labels=with_changed_pixels(observation.labels, 0.002)),  # type: ignore[arg-type]
    "views": lambda observation: replace(observation, views={"ideal": observation.views["ideal"]}),
    "query val-s0000-p": lambda observation: replace(observation, queries=observation.queries[1:]),
    "query val-s0000-p0-snap: differs": lambda observation: with_query(
        observation, "pivot", lambda at: [at[0] + 3e-4, *at[1:]]
    ),
    "query val-s0000-p0-snap: differs ": lambda observation: with_query(
        observation, "guess", lambda row: shifted(row, 3e-4)
    ),
    "query val-s0000-p0-snap: differs  ": lambda observation: with_query(observation, "drawn", lambda drawn: not drawn),
}
TRUTH_CHANGES: dict[str, Callable[[SceneTruth], SceneTruth]] = {
    "assembly val-0001": lambda truth: replace(truth, assembly_id="val-0001"),
    "another pose of the assembly": lambda truth: replace(
        truth, world_from_assembly=pose_of(shifted(pose_row(truth.world_from_assembly)))
    ),
    "part 0: differs": lambda truth: with_part(truth, "world_from_part", shifted),
    "part 0: differs ": lambda truth: with_part(truth, "rest_mode", lambda _: "flying"),
    "part 0: differs  ": lambda truth: with_part(truth, "pixels", lambda pixels: pixels + 50),
    "truth of val-s0000-p": lambda truth: replace(truth, queries=dict(list(truth.queries.items())[1:])),
    "segmentation differs": lambda truth: replace(truth, seg=with_changed_pixels(truth.seg, 0.002)),
    "other models": lambda truth: replace(truth, models={}),
    "goals differ": lambda truth: replace(truth, goals=None),
}


@pytest.fixture(scope="module")
def recorded(mini: Path) -> tuple[Observation, SceneTruth]:
    observation = ObservationFile(mini / "val/0000.mcap").observation("val-s0000")
    return observation, TruthFile(mini / "val/0000.truth.mcap").truth("val-s0000")


@pytest.mark.parametrize("name", OBSERVATION_CHANGES)
def test_a_difference_in_an_observation_is_named(name: str, recorded: tuple[Observation, SceneTruth]) -> None:
    (fault,) = observation_differences(recorded[0], OBSERVATION_CHANGES[name](recorded[0]))
    assert fault.startswith(name.strip())


@pytest.mark.parametrize("name", TRUTH_CHANGES)
def test_a_difference_in_the_truth_is_named(name: str, recorded: tuple[Observation, SceneTruth]) -> None:
    (fault,) = truth_differences(recorded[1], TRUTH_CHANGES[name](recorded[1]))
    assert fault.startswith(name.strip())


def test_differences_between_processors_are_no_faults(recorded: tuple[Observation, SceneTruth]) -> None:
    observation, truth = recorded
    flips = with_query(
        with_query(observation, "pivot", lambda at: [at[0] + 1e-4, *at[1:]]), "guess", lambda g: shifted(g, 1e-4)
    )
    specks = with_view(
        flips, "ideal", lambda view: moved(replace(view, depth=with_changed_pixels(view.depth, 9e-4)), 1e-6)
    )
    assert observation.labels is not None
    changed = replace(specks, labels=with_changed_pixels(observation.labels, 9e-4))
    assert observation_differences(observation, changed) == []
    truth_nearby = with_part(
        with_part(truth, "world_from_part", lambda row: shifted(row, 9e-6)), "pixels", lambda n: n + 3
    )
    assert truth_differences(truth, replace(truth_nearby, seg=with_changed_pixels(truth.seg, 9e-4))) == []


def test_data_of_another_version_is_not_generated_again(copy: Path) -> None:
    summary = read_json(copy / "dataset.json") | {"data_version": "0.1.9"}
    (copy / "dataset.json").write_bytes(summary_bytes(summary))
    report = verify(copy, sample=1)
    assert (report.faults, report.rebuilt) == ((), ())
    assert report.notes[0].startswith("no scene generated again: data version 0.1.9, this kit1000 makes ")


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
