"""Datasets of mesh files: any name and any content gives parts or reasons, never an end of the run."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from manifold3d import Manifold

from kit1000.cli import main
from kit1000.cli.summaries import summary_text
from kit1000.dataset.geometry import Geometry
from kit1000.dataset.mesh_files import read_glb
from kit1000.errors import InputError
from kit1000.generation import parts_and_kits, scene_files, tried_files
from kit1000.generation.build import generate
from kit1000.generation.plan import Sources, draw_longest, file_order
from kit1000.generation.scenes import make_scene
from kit1000.generation.tried_files import FileJob, try_file
from kit1000.generation.verify import verify
from kit1000.mesh import Mesh, defect_float32, mesh_from_solid
from kit1000.parts.family import part_of_mesh
from kit1000.parts.files.read import mesh_files
from kit1000.queries.tracks import SPLITS
from tests.samples.mini import MINI, l_shape, l_shape_sources, write_stl

pytestmark = pytest.mark.usefixtures("fake_scenes")


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> Sources:
    return l_shape_sources(tmp_path_factory.mktemp("files"))


def test_invalid_files_are_refused_with_a_reason_and_do_not_stop_the_run(
    sources: Sources, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "files"
    good = [write_stl(folder / path.name, l_shape(20 + 3 * i)) for i, path in enumerate(sources.files.values())]
    write_stl(folder / "same.stl", l_shape(20).scaled(1.3))
    write_stl(folder / "flat.stl", Mesh(l_shape().vertices * (1, 1, 1e-4), l_shape().faces))
    write_stl(folder / "strange.stl", l_shape(40))
    (folder / "empty.stl").touch()
    listed = [*good, *(folder / f"{name}.stl" for name in ("same", "flat", "strange", "empty", "missing"))]
    original = parts_and_kits.accepted_kit

    def accepted(part, *of_preset):
        if abs(part.mesh.extents.min() / part.mesh.extents.max() - 30 / 40) < 1e-3:
            raise ZeroDivisionError("nobody thought\nof this")
        return original(part, *of_preset)

    monkeypatch.setattr(parts_and_kits, "accepted_kit", accepted)
    preset = replace(MINI, train=7)
    summary = generate(preset, tmp_path / "out", workers=1, sources=Sources.of(listed))
    refused = summary["refused"]
    assert refused["empty.stl"] == "empty file"
    assert refused["missing.stl"] == "cannot be read: no such file or directory"
    assert refused["flat.stl"] == "zero thickness"
    assert refused["strange.stl"].startswith("no kit: ZeroDivisionError: nobody thought of this (parts_and_kits.py:")
    twins = {"same.stl", "corner20.stl"} & set(refused)
    assert len(twins) == 1
    assert refused[twins.pop()].startswith("near-duplicate of ")
    assert len(refused) == 5
    assert set(Geometry(tmp_path / "out").parts).isdisjoint(refused)
    assert sum(n["parts"] for n in summary["counts"].values()) == 4


@pytest.mark.slow
def test_real_parts_become_a_dataset_that_verifies(real_parts: Path, tmp_path: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scene_files, "make_scene", make_scene)
        preset = replace(MINI, train=6, val=2, test=4, kits=(2, 3))
        summary = generate(preset, tmp_path / "out", sources=Sources.of(mesh_files(real_parts)))
    assert [summary["counts"][split]["scenes"] for split in SPLITS] == [6, 2, 4]
    assert summary["refused_scenes"] == {}
    assert verify(tmp_path / "out", sample=3).faults == ()


def file_job(folder: Path, name: str, body: Manifold, **drawn: tuple[float, float]) -> FileJob:
    path = write_stl(folder / f"{name}.stl", mesh_from_solid(body.scale((1e-3, 1e-3, 1e-3))))
    preset = replace(MINI, longest=(0.035, 0.05))
    return FileJob(folder / "out", replace(preset, **drawn), 0, path.name, path, None)


def test_a_part_refused_at_the_size_drawn_is_tried_at_the_largest(tmp_path: Path) -> None:
    """A bar of 50 x 22 x 7.6 mm is high enough from 47 mm on."""
    bar = Manifold.cube((50, 22, 7.6))
    preset = replace(MINI, longest=(0.035, 0.05))
    name = next(name for name in map(str, range(99)) if draw_longest(preset, 0, f"{name}.stl") < 0.046)
    job = file_job(tmp_path, name, bar)
    assert "refused" not in try_file(job)
    assert read_glb(tmp_path / f"out/parts/{job.id}.glb")[job.id].extents.max() == pytest.approx(0.05, abs=1e-6)
    assert try_file(file_job(tmp_path / "low", name, bar, longest=(0.035, 0.046)))["refused"]


def test_a_part_that_scaling_would_open_is_closed_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A slit at the origin, where float32 is fine, comes to lie where it is coarse."""
    cut = Manifold.cube((40, 22, 18)) - Manifold.cube((1e-7, 9, 5)).translate((1e-7, 8, 13))
    mesh = mesh_from_solid(cut.scale((1e-3, 1e-3, 1e-3)))
    assert defect_float32(part_of_mesh("cut", mesh, 0.04).mesh) is not None
    closed = tried_files.part_of_size("cut", mesh, 0.04)
    assert defect_float32(closed.mesh) is None
    assert np.abs(closed.mesh.bounds - part_of_mesh("cut", mesh, 0.04).mesh.bounds).max() < 1e-5
    monkeypatch.setattr(tried_files, "read_mesh", lambda *_: SimpleNamespace(mesh=mesh))
    monkeypatch.setattr(tried_files, "closed_on_grid", lambda mesh, _: (mesh, "3 open edges"))
    job = file_job(tmp_path, "cut", cut, longest=(0.04, 0.04))
    assert try_file(job)["refused"] == "opens when files round it to float32: 3 open edges"


def test_no_usable_file_is_one_line_and_the_folder_can_be_used_again(sources: Sources, tmp_path: Path) -> None:
    for name in "abcd":
        (tmp_path / f"{name}.stl").touch()
    with pytest.raises(InputError) as caught:
        generate(MINI, tmp_path / "out", workers=1, sources=Sources.of(sorted(tmp_path.glob("*.stl"))))
    assert str(caught.value).startswith("none of 4 mesh files can be a part: 4x empty file (")
    assert str(caught.value).endswith(".stl: empty file; and 1 more)")
    generate(MINI, tmp_path / "out", workers=1, sources=sources)


def test_few_files_give_empty_splits_and_single_kits(tmp_path: Path) -> None:
    summary = generate(MINI, tmp_path / "out", workers=1, sources=l_shape_sources(tmp_path / "files", (24,)))
    assert summary["counts"] == {
        "train": {"parts": 1, "assemblies": 1, "scenes": 1},
        "val": {"parts": 0, "assemblies": 0, "scenes": 0},
        "test": {"parts": 0, "assemblies": 0, "scenes": 0},
    }
    assert len(Geometry(tmp_path / "out").assembly("train-0000").mounts) == 1


def test_an_unreadable_dataset_is_refused_with_the_reason(
    sources: Sources, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, ready = tmp_path / "whole", tmp_path / "ready"
    generate(MINI, whole, workers=1, sources=sources)
    ready.mkdir()
    (ready / "plan.json").write_bytes((whole / "plan.json").read_bytes())
    (tmp_path / "file").touch()
    for folder, said in (
        (tmp_path, "no dataset.json in it"),
        (tmp_path / "none", "there is no such folder"),
        (tmp_path / "file", "it is a file"),
        (ready, "not finished: run the same `kit1000 generate` again"),
    ):
        with pytest.raises(InputError, match=f"no dataset \\({said}"):
            Geometry(folder)
    (tmp_path / "dataset.json").write_text("[]")
    with pytest.raises(InputError, match=r"has format None.*'kit1000/2'"):
        Geometry(tmp_path)
    with pytest.raises(InputError, match=r"no 'x' among 4 parts \(test-0000, "):
        Geometry(whole).part("x")


ODD = [b"Geh\xe4use.stl", b"a|b.stl", b"<b>.stl", b"two\nlines.stl", b"tab\t.stl", "Gehäuse.stl".encode()]


def odd_files(folder: Path) -> list[Path]:
    """Files of such names: the first four are parts, the others near-duplicates of them, so that all are named."""
    paths = [Path(os.fsdecode(os.fsencode(folder) + b"/" + name)) for name in ODD]
    for i, path in enumerate(paths):
        write_stl(path, l_shape((20, 24, 28, 33)[i % 4]))
    return paths


def test_names_of_any_bytes_never_end_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    summary = generate(MINI, tmp_path / "out", workers=1, sources=Sources.of(odd_files(tmp_path)))
    assert sum(count["parts"] for count in summary["counts"].values()) == 4
    assert len(summary["refused"]) == 2
    card = (tmp_path / "out/README.md").read_text("utf-8")
    rows = [line for line in card.splitlines() if "near-duplicate of" in line]
    assert rows
    for row in rows:  # one line, three columns
        assert row.replace("\\|", "").count("|") == 4
        assert "<b>" not in row
    json.loads((tmp_path / "out/croissant.json").read_bytes())
    printed = summary_text(summary)
    assert len(printed.splitlines()) == len(summary_text(summary | {"refused": {"a": "b", "c": "d"}}).splitlines())
    printed.encode("utf-8")
    assert main(["info", str(tmp_path / "out")]) == 0
    assert capsys.readouterr().out.rstrip("\n") == printed
    again = generate(MINI, tmp_path / "out", workers=1, sources=Sources.of(odd_files(tmp_path)))
    assert again == summary


def test_files_are_tried_in_the_drawn_order_until_there_are_enough_parts(tmp_path: Path) -> None:
    files = [write_stl(tmp_path / f"good{width}.stl", l_shape(width)) for width in (20, 22, 24, 26, 28, 31, 33, 35)]
    for i in range(8):
        (tmp_path / f"bad{i}.stl").touch()
        files.append(tmp_path / f"bad{i}.stl")
    sources = Sources.of(files)
    summary = generate(MINI, tmp_path / "out", workers=1, sources=sources)
    assert sum(count["parts"] for count in summary["counts"].values()) == 4
    refused, order = summary["refused"], file_order(MINI.seed, sources)
    assert {reason for name, reason in refused.items() if "bad" in name} <= {"empty file"}
    assert summary["untried_files"] == len(files) - 4 - len(refused) > 0
    assert f"{summary['untried_files']} more not tried" in summary_text(summary)
    used = [row["source"] for row in Geometry(tmp_path / "out").parts.values()]
    assert {*used, *refused} == {*order[: 4 + len(refused)]}
    assert generate(MINI, tmp_path / "again", workers=1, sources=Sources.of(files[::-1])) == summary
