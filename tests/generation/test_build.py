"""Tests of generate: the same bytes after interruptions, other folders unchanged.

That two workers write the same bytes as one is a test of `tests/outside/test_portable.py`.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from kit1000 import files
from kit1000.dataset.geometry import Geometry
from kit1000.errors import InputError, Redraw
from kit1000.files import locked
from kit1000.generation import assemblies, build, parts_and_kits, scene_files
from kit1000.generation.build import generate
from kit1000.generation.plan import Sources
from kit1000.mesh import defect_float32
from tests.samples.checkout import ROOT
from tests.samples.mini import MINI, fake_scene, file_hashes, l_shape_sources

pytestmark = pytest.mark.usefixtures("fake_scenes")


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> Sources:
    return l_shape_sources(tmp_path_factory.mktemp("files"))


@pytest.fixture(scope="module")
def complete(sources: Sources, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of mesh files with fake scenes."""
    root = tmp_path_factory.mktemp("whole")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scene_files, "make_scene", fake_scene)
        generate(MINI, root, workers=1, sources=sources)
    return root


def test_a_finished_folder_has_exactly_the_listed_files(mini: Path, complete: Path) -> None:
    for root in (mini, complete):
        listed = json.loads((root / "dataset.json").read_bytes())["files"]
        assert file_hashes(root) == listed | {"dataset.json": file_hashes(root)["dataset.json"]}


def test_a_dataset_read_back_is_valid(mini: Path) -> None:
    geometry = Geometry(mini)
    sizes = {"train": 2, "val": 1, "test": 1}
    counts = {split: dict.fromkeys(("parts", "assemblies", "scenes"), n) for split, n in sizes.items()}
    assert geometry.summary["counts"] == counts
    for assembly_id, row in geometry.assemblies.items():
        assembly = geometry.assembly(assembly_id)
        ids = [mount.kit.slot.part_id for mount in assembly.mounts]
        assert row["target"] in ids
        assert {geometry.parts[i]["split"] for i in ids} == {row["split"]}
        for mesh in (assembly.mesh, *(m.kit.mesh for m in assembly.mounts), *(geometry.part(i).mesh for i in ids)):
            assert defect_float32(mesh) is None


def test_a_finished_dataset_is_not_changed(
    complete: Path, sources: Sources, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    times = {path: path.stat().st_mtime_ns for path in complete.rglob("*") if path.name != ".lock"}
    for name in ("make_part_and_kit", "make_assembly", "make_shard"):
        monkeypatch.setattr(build, name, None)
    summary = generate(MINI, complete, workers=1, sources=sources)
    assert summary == json.loads((complete / "dataset.json").read_bytes())
    assert capsys.readouterr() == ("", f"{complete} is complete: nothing to do\n")
    assert times == {path: path.stat().st_mtime_ns for path in complete.rglob("*") if path.name != ".lock"}


@pytest.mark.parametrize("name", ["parts/train-0000.glb", "test/0000.three.mcap", "README.md", "dataset.json"])
@pytest.mark.parametrize("harm", [Path.unlink, lambda path: path.write_bytes(path.read_bytes()[:-9])])
def test_a_finished_dataset_with_a_damaged_file_is_repaired(
    name: str, harm: Callable[[Path], None], complete: Path, sources: Sources, tmp_path: Path
) -> None:
    root = shutil.copytree(complete, tmp_path / "copy")
    harm(root / name)
    generate(MINI, root, workers=1, sources=sources)
    assert file_hashes(root) == file_hashes(complete)


class Stop(BaseException):
    """An exception that no code handles."""


def test_a_run_stopped_at_any_write_ends_with_the_same_bytes(
    complete: Path, sources: Sources, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    replace, left = os.replace, 0

    def failing_replace(source: Path, target: Path) -> None:
        nonlocal left
        left -= 1
        if left < 0:
            raise Stop
        replace(source, target)

    stops = 0
    monkeypatch.setattr(files.os, "replace", failing_replace)
    for allowed in range(100):
        left = allowed
        try:
            generate(MINI, tmp_path, workers=1, sources=sources)
            break
        except Stop:
            stops += 1
            assert not (tmp_path / "dataset.json").exists()
    assert stops >= 10
    assert file_hashes(tmp_path) == file_hashes(complete)


RUN = """
import os, signal, sys
from pathlib import Path
from tests.samples.mini import MINI, fake_scene, l_shape_sources
from kit1000 import files
from kit1000.generation import scene_files
from kit1000.generation.build import generate

if sys.argv[5] == "fake":  # also in the workers, which run these lines
    scene_files.make_scene = fake_scene

def main(root, folder, workers, allowed):
    replace, count = os.replace, 0
    def failing_replace(source, target):
        nonlocal count
        count += 1
        if count > allowed:
            os.kill(os.getpid(), signal.SIGKILL)
        replace(source, target)
    files.os.replace = failing_replace
    generate(MINI, Path(root), workers=workers, sources=l_shape_sources(Path(folder)))

if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))
"""


def start_run(folder: Path, root: Path, workers: int, allowed: int, scenes: str = "fake") -> subprocess.Popen[str]:
    """A run in its own process group, killed between its last allowed write and the rename of the next file."""
    script = folder / "run.py"
    script.write_text(RUN)
    paths = str(ROOT)
    return subprocess.Popen(
        [sys.executable, script, root, folder / "files", str(workers), str(allowed), scenes],
        env=os.environ | {"PYTHONPATH": paths},
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def test_a_run_killed_between_write_and_rename_ends_with_the_same_bytes(
    complete: Path, sources: Sources, tmp_path: Path
) -> None:
    root = tmp_path / "out"
    run = start_run(tmp_path, root, 1, 16)
    run.communicate(timeout=120)
    assert run.returncode == -signal.SIGKILL
    assert list(root.rglob(f".*{files.PARTIAL}"))
    generate(MINI, root, workers=1, sources=sources)
    assert file_hashes(root) == file_hashes(complete)


def test_a_full_disk_is_one_line_and_the_next_run_continues(complete: Path, sources: Sources, tmp_path: Path) -> None:
    unlimited = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (6000, unlimited[1]))
    try:
        with pytest.raises(InputError, match=r"^[^\n]*File too large[^\n]*$"):
            generate(MINI, tmp_path, workers=1, sources=sources)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, unlimited)
    assert not (tmp_path / "dataset.json").exists()
    generate(MINI, tmp_path, workers=1, sources=sources)
    assert file_hashes(tmp_path) == file_hashes(complete)


def make_unfinished(root: Path, sources: Sources, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make a folder with everything except the tables."""

    def stop(*_: object) -> None:
        raise Stop

    with monkeypatch.context() as patch:
        patch.setattr(build, "write_summary", stop)
        with pytest.raises(Stop):
            generate(MINI, root, workers=1, sources=sources)


RECORDS = [f"{parts_and_kits.BUILD_FOLDER}/{name}.json" for name in ("assemblies/train-0001", "shards/val/0000")]
MADE = ["parts/train-0000.glb", "kits/val-0000.glb", "assemblies/test-0000.glb", "train/0000.mcap"]
NO_RECORDS = [b"", b"null", b"{}\n", b'{"files": {"parts/train-0000.glb": "0"}}']


@pytest.mark.parametrize(
    ("name", "data"),
    [(name, None) for name in (*MADE, "test/0000.truth.mcap", *RECORDS)] + [(RECORDS[1], data) for data in NO_RECORDS],
)
def test_damaged_files_are_made_again(
    name: str, data: bytes | None, unfinished: Path, complete: Path, sources: Sources, tmp_path: Path
) -> None:
    root = shutil.copytree(unfinished, tmp_path / "copy")
    half = (root / name).read_bytes()[: (root / name).stat().st_size // 2]
    (root / name).write_bytes(half if data is None else data)
    generate(MINI, root, workers=1, sources=sources)
    assert file_hashes(root) == file_hashes(complete)


@pytest.fixture(scope="module")
def unfinished(sources: Sources, tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("ready")
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(scene_files, "make_scene", fake_scene)
        make_unfinished(root, sources, monkeypatch)
    return root


def test_unlisted_and_partial_files_are_deleted_when_a_dataset_is_finished(
    unfinished: Path, complete: Path, sources: Sources, tmp_path: Path
) -> None:
    root = shutil.copytree(unfinished, tmp_path / "copy")
    (root / "parts/train-0009.glb").touch()
    (root / "train/0007.truth.mcap").touch()
    (root / f"kits/.train-0000.glb.99{files.PARTIAL}").touch()
    generate(MINI, root, workers=1, sources=sources)
    assert file_hashes(root) == file_hashes(complete)


def test_a_folder_with_other_files_is_not_changed(sources: Sources, tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("ten years")
    with pytest.raises(InputError, match="is not empty and contains no dataset: choose another --out"):
        generate(MINI, tmp_path, workers=1, sources=sources)
    assert os.listdir(tmp_path) == ["thesis.tex"]


@pytest.mark.parametrize(
    ("seed", "named", "said"), [(8, "mini", "seed 7, expected 8"), (7, "maxi", "preset mini, expected maxi")]
)
def test_another_plan_is_refused_and_the_dataset_not_changed(
    seed: int, named: str, said: str, complete: Path, sources: Sources
) -> None:
    before = file_hashes(complete)
    with pytest.raises(InputError, match=rf"another dataset \({said}\).*--out"):
        generate(build.replace(MINI, name=named), complete, seed, workers=1, sources=sources)
    assert file_hashes(complete) == before


def test_a_file_in_place_of_the_folder_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("")
    for out in (tmp_path / "out", tmp_path / "out/deeper"):
        with pytest.raises(InputError, match=r"cannot write to .*: Not a directory"):
            generate(MINI, out, workers=1)
    assert os.listdir(tmp_path) == ["out"]


def test_a_second_run_in_one_folder_is_refused(sources: Sources, tmp_path: Path) -> None:
    with locked(tmp_path), pytest.raises(InputError, match="is being written by another process"):
        generate(MINI, tmp_path, workers=1, sources=sources)


def test_one_process_may_build_two_datasets_in_one_place(complete: Path, sources: Sources, tmp_path: Path) -> None:
    generate(MINI, tmp_path / "a", 1, workers=1, sources=sources)
    shutil.rmtree(tmp_path / "a")
    generate(MINI, tmp_path / "a", workers=1, sources=sources)
    assert file_hashes(tmp_path / "a") == file_hashes(complete)


def test_neighbours_that_cannot_be_placed_are_left_out(
    sources: Sources, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def check(assembly, _):
        if len(assembly.mounts) > 1:
            raise Redraw("too narrow")

    monkeypatch.setattr(assemblies, "MAX_ATTEMPTS", 5)
    monkeypatch.setattr(assemblies, "check_assembly", check)
    monkeypatch.setattr(assemblies, "seats_in_other_slot", lambda *_: False)
    preset = build.replace(MINI, kits=(2, 2))
    summary = generate(preset, tmp_path, workers=1, sources=sources)
    assert summary["redraws"]["assemblies"] == {"too narrow": 2 * assemblies.MAX_ATTEMPTS, assemblies.FEWER_KITS: 4}
