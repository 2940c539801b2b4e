"""Laws of verification: any changed byte is found and named, and scenes built again are the same, or are named."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mini import MINI, contents, corners

from kit1000.cli import main
from kit1000.dataset.geometry import Geometry
from kit1000.dataset.mcap_io import ObservationFile, ObservationWriter, TruthFile, TruthWriter
from kit1000.dataset.schema import Observation, SceneTruth
from kit1000.dataset.tables import pose_of, pose_row
from kit1000.errors import InputError
from kit1000.files import json_bytes, read_json
from kit1000.generation import rebuild
from kit1000.generation.build import generate
from kit1000.generation.rebuild import observation_differences, scene_differences, truth_differences
from kit1000.generation.summary import summary_bytes
from kit1000.generation.verify import verify
from kit1000.pose import Pose
from kit1000.values import View


@pytest.fixture
def copy(mini: Path, tmp_path: Path) -> Path:
    """A dataset that may be harmed."""
    return shutil.copytree(mini, tmp_path / "copy")


@pytest.fixture(scope="module")
def of_files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset whose parts come from files."""
    folder = tmp_path_factory.mktemp("of_files")
    generate(MINI, folder / "data", workers=1, sources=corners(folder / "files"))
    return folder / "data"


def flipped(path: Path, place: int) -> None:
    data = bytearray(path.read_bytes())
    data[place] ^= 1 << place % 8
    path.write_bytes(data)


def said_of(root: Path) -> str:
    """The one line that verification says of a folder with one fault."""
    try:
        (fault,) = verify(root).faults
        return fault
    except InputError as error:
        return str(error)


def test_a_sound_dataset_passes(mini: Path) -> None:
    found = verify(mini)
    assert found.faults == found.notes == found.rebuilt == ()
    assert found.files == len(contents(mini)) - 1


def test_a_changed_byte_is_found_and_named_in_any_file(copy: Path) -> None:
    names = sorted(contents(copy))
    assert {"dataset.json", "README.md", "croissant.json", "plan.json", "parts.json", "test/0000.three.mcap"} < set(
        names
    )
    rng = np.random.default_rng(0)
    for name in names:
        before = (copy / name).read_bytes()
        flipped(copy / name, int(rng.integers(len(before))))
        assert name in said_of(copy)
        (copy / name).write_bytes(before)
    assert said_nothing(copy)


def said_nothing(root: Path) -> bool:
    return verify(root).faults == ()


def test_a_changed_byte_anywhere_in_the_index_is_found(copy: Path) -> None:
    path = copy / "dataset.json"
    before = path.read_bytes()
    for place in range(0, len(before), 41):
        flipped(path, place)
        assert "dataset.json" in said_of(copy)
        path.write_bytes(before)


def test_a_number_that_becomes_infinite_is_found(copy: Path) -> None:
    path = copy / "dataset.json"
    path.write_bytes(path.read_bytes().replace(b"0.0025", b"1e9999"))
    assert said_of(copy) == "dataset.json: changed since it was written"


def test_missing_and_extra_files_are_named(copy: Path) -> None:
    (copy / "kits/val-0000.glb").unlink()
    (copy / "notes.txt").touch()
    (copy / "train/0001.mcap").touch()
    assert verify(copy).faults == (
        "kits/val-0000.glb: missing or unreadable",
        "notes.txt: not a file of this dataset",
        "train/0001.mcap: not a file of this dataset",
    )


def test_what_is_hidden_is_of_no_account(copy: Path) -> None:
    (copy / ".cache/hub").mkdir(parents=True)
    (copy / ".cache/hub/record").touch()
    (copy / ".gitattributes").touch()
    assert said_nothing(copy)


def test_the_plan_of_another_dataset_is_found(copy: Path) -> None:
    plan = read_json(copy / "plan.json")
    resealed(copy, "plan.json", json_bytes(plan | {"seed": 8}))
    assert said_of(copy) == "plan.json: of another dataset"


def resealed(root: Path, name: str, data: bytes) -> None:
    """Change a file, and everything that speaks of it."""
    (root / name).write_bytes(data)
    summary = read_json(root / "dataset.json")
    summary["files"][name] = sha256(data).hexdigest()
    (root / "dataset.json").write_bytes(summary_bytes(summary))


def exactly(patch: pytest.MonkeyPatch) -> None:
    """No difference is small enough."""
    for name, value in {"DEPTH_TOLERANCE": 0, "PIXELS_ALIKE": 1, "POSE_TOLERANCE": 0, "SIZE_TOLERANCE": 0}.items():
        patch.setattr(rebuild, name, value)
    patch.setattr(rebuild, "TOLERANCES", {})


def test_a_scene_built_again_is_the_same_to_the_bit(mini: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    exactly(monkeypatch)
    assert scene_differences(Geometry(mini), read_json(mini / "plan.json"), "val-s0000") == []


@pytest.mark.slow
def test_all_scenes_built_again_are_the_same_to_the_bit(mini: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    exactly(monkeypatch)
    found = verify(mini, sample=99)
    assert found.rebuilt == ("test-s0000", "train-s0000", "train-s0001", "val-s0000")
    assert found.faults == ()


def test_scenes_of_parts_from_files_are_built_again(of_files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    exactly(monkeypatch)
    found = verify(of_files, sample=4)
    assert len(found.rebuilt) == 4
    assert found.faults == ()
    assert found.notes == ("parts come from files: they are taken as stored",)


def test_a_sample_is_the_same_whenever_it_is_drawn(of_files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("kit1000.generation.verify.scene_differences", lambda *_: [])
    samples = [verify(of_files, sample).rebuilt for sample in (1, 2, 3)]
    assert samples == [verify(of_files, sample).rebuilt for sample in (1, 2, 3)]
    assert set(samples[0]) < set(samples[1]) < set(samples[2])


def rewritten(root: Path, change: Callable[[SceneTruth], SceneTruth]) -> None:
    """Change the truth of the validation scene, and everything that speaks of it."""
    truth = change(TruthFile(root / "val/0000.truth.mcap").truth("val-s0000"))
    with TruthWriter(root / "val/0000.truth.mcap") as writer:
        writer.add(truth)
    resealed(root, "val/0000.truth.mcap", (root / "val/0000.truth.mcap").read_bytes())


def test_a_pose_changed_with_all_its_hashes_is_found(of_files: Path, tmp_path: Path) -> None:
    root = shutil.copytree(of_files, tmp_path / "copy")
    rewritten(root, lambda truth: with_part(truth, "world_from_part", shifted))
    assert said_nothing(root)
    found = verify(root, sample=99)
    assert found.faults == ("val-s0000: part 0: differs",)
    assert main(["verify", str(root), "--sample", "99"]) == 1


def test_a_depth_changed_with_all_its_hashes_is_found(of_files: Path, tmp_path: Path) -> None:
    root = shutil.copytree(of_files, tmp_path / "copy")
    seen = ObservationFile(root / "val/0000.mcap").observation("val-s0000")
    with ObservationWriter(root / "val/0000.mcap") as writer:
        writer.add(with_view(seen, "d415", lambda view: View(view.camera, view.world_from_camera, raised(view.depth))))
    resealed(root, "val/0000.mcap", (root / "val/0000.mcap").read_bytes())
    assert said_nothing(root)
    faults = scene_differences(Geometry(root), read_json(root / "plan.json"), "val-s0000")
    assert faults == ["d415: depths differ"]


def test_a_goal_changed_with_all_its_hashes_is_found(copy: Path) -> None:
    kits = read_json(copy / "kits.json")
    kits["val-0000"]["goals"][0] = shifted(kits["val-0000"]["goals"][0])
    resealed(copy, "kits.json", json_bytes(kits))
    assert said_nothing(copy)
    faults = scene_differences(Geometry(copy), read_json(copy / "plan.json"), "val-s0000")
    assert faults == ["kit val-0000: differs"]


def raised(depth: np.ndarray) -> np.ndarray:
    """A strip of two hundredths of an image (H, W) moved by three steps of the grid."""
    moved = depth.copy()
    moved[: len(moved) // 50] += np.float32(3 * 2**-13)
    return moved


def shifted(row: dict[str, Any], metres: float = 5e-5) -> dict[str, Any]:
    return pose_row(Pose.from_translation([metres, 0.0, 0.0]) @ pose_of(row))


def with_view(seen: Observation, key: str, change: Callable[[View], View]) -> Observation:
    return replace(seen, views={**seen.views, key: change(seen.views[key])})


def with_query(seen: Observation, key: str, change: Callable[[Any], Any]) -> Observation:
    first, *others = seen.queries
    return replace(seen, queries=({**first, key: change(first[key])}, *others))


def with_part(truth: SceneTruth, key: str, change: Callable[[Any], Any]) -> SceneTruth:
    first, *others = truth.parts
    return replace(truth, parts=({**first, key: change(first[key])}, *others))


def moved(view: View, metres: float) -> View:
    return View(view.camera, Pose(view.world_from_camera.wxyz, view.world_from_camera.xyz + metres), view.depth)


def spotted(image: np.ndarray, share: float) -> np.ndarray:
    """A share of the pixels of an image (H, W) changed."""
    changed = image.copy()
    changed.ravel()[: round(share * image.size)] += 1
    return changed


SEEN: dict[str, Callable[[Observation], Observation]] = {
    "d415: depths differ": lambda seen: with_view(seen, "d415", lambda view: replace(view, depth=raised(view.depth))),
    "ideal: another camera pose": lambda seen: with_view(seen, "ideal", lambda view: moved(view, 3e-5)),
    "ideal: another camera": lambda seen: with_view(
        seen, "ideal", lambda view: replace(view, camera=replace(view.camera, fx=926.0))
    ),
    "masks differ": lambda seen: replace(seen, labels=spotted(seen.labels, 0.002)),  # type: ignore[arg-type]
    "views": lambda seen: replace(seen, views={"ideal": seen.views["ideal"]}),
    "query val-s0000-p": lambda seen: replace(seen, queries=seen.queries[1:]),
    "query val-s0000-p0-snap: differs": lambda seen: with_query(seen, "pivot", lambda at: [at[0] + 3e-4, *at[1:]]),
    "query val-s0000-p0-snap: differs ": lambda seen: with_query(seen, "guess", lambda row: shifted(row, 3e-4)),
    "query val-s0000-p0-snap: differs  ": lambda seen: with_query(seen, "drawn", lambda drawn: not drawn),
}
TRUE: dict[str, Callable[[SceneTruth], SceneTruth]] = {
    "assembly val-0001": lambda truth: replace(truth, assembly_id="val-0001"),
    "the assembly stands elsewhere": lambda truth: replace(
        truth, world_from_assembly=pose_of(shifted(pose_row(truth.world_from_assembly)))
    ),
    "part 0: differs": lambda truth: with_part(truth, "world_from_part", shifted),
    "part 0: differs ": lambda truth: with_part(truth, "rest_mode", lambda _: "flying"),
    "part 0: differs  ": lambda truth: with_part(truth, "pixels", lambda pixels: pixels + 50),
    "truth of val-s0000-p": lambda truth: replace(truth, queries=dict(list(truth.queries.items())[1:])),
    "segmentation differs": lambda truth: replace(truth, seg=spotted(truth.seg, 0.002)),
    "other models": lambda truth: replace(truth, models={}),
    "goals differ": lambda truth: replace(truth, goals=None),
}


@pytest.fixture(scope="module")
def recorded(mini: Path) -> tuple[Observation, SceneTruth]:
    seen = ObservationFile(mini / "val/0000.mcap").observation("val-s0000")
    return seen, TruthFile(mini / "val/0000.truth.mcap").truth("val-s0000")


@pytest.mark.parametrize("said", SEEN)
def test_a_difference_in_what_was_seen_is_named(said: str, recorded: tuple[Observation, SceneTruth]) -> None:
    (fault,) = observation_differences(recorded[0], SEEN[said](recorded[0]))
    assert fault.startswith(said.strip())


@pytest.mark.parametrize("said", TRUE)
def test_a_difference_in_what_is_so_is_named(said: str, recorded: tuple[Observation, SceneTruth]) -> None:
    (fault,) = truth_differences(recorded[1], TRUE[said](recorded[1]))
    assert fault.startswith(said.strip())


def test_what_another_processor_may_do_is_no_fault(recorded: tuple[Observation, SceneTruth]) -> None:
    seen, truth = recorded
    flips = with_query(
        with_query(seen, "pivot", lambda at: [at[0] + 1e-4, *at[1:]]), "guess", lambda g: shifted(g, 1e-4)
    )
    specks = with_view(flips, "ideal", lambda view: moved(replace(view, depth=spotted(view.depth, 9e-4)), 1e-6))
    assert observation_differences(seen, replace(specks, labels=spotted(seen.labels, 9e-4))) == []  # type: ignore[arg-type]
    near = with_part(with_part(truth, "world_from_part", lambda row: shifted(row, 9e-6)), "pixels", lambda n: n + 3)
    assert truth_differences(truth, replace(near, seg=spotted(truth.seg, 9e-4))) == []


def test_data_of_another_version_is_not_built_again(copy: Path) -> None:
    summary = read_json(copy / "dataset.json") | {"data_version": "0.1.9"}
    (copy / "dataset.json").write_bytes(summary_bytes(summary))
    found = verify(copy, sample=1)
    assert (found.faults, found.rebuilt) == ((), ())
    assert found.notes[0].startswith("nothing built again: made as data version 0.1.9, this kit1000 makes ")


def test_the_command_says_what_was_found(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verify", str(copy), "--sample", "0"]) == 0
    count = len(contents(copy)) - 1
    assert capsys.readouterr().out == f"{count} files checked, 0 scenes built again (none)\nall is as it was made\n"
    flipped(copy / "kits.json", 9)
    assert main(["verify", str(copy)]) == 1
    assert capsys.readouterr().out.splitlines() == [
        "kits.json: changed since it was written",
        f"{count} files checked, 0 scenes built again (none)",
        "note: nothing built again: files are damaged",
        "faults: 1",
    ]
