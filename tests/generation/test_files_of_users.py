"""Meshes of users in a dataset: names of any bytes, leftover files for short splits, and a missing physics engine."""

from __future__ import annotations

import builtins
import json
import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from kit1000.cli import main
from kit1000.cli.summaries import summary_text
from kit1000.dataset.geometry import Geometry
from kit1000.errors import InputError
from kit1000.generation.build import generate
from kit1000.generation.plan import Sources, file_order
from kit1000.generation.verify import verify
from kit1000.sim.world import PhysicsMissing
from tests.samples.mini import MINI, l_shape, write_stl

ODD = [b"Geh\xe4use.stl", b"a|b.stl", b"<b>.stl", b"two\nlines.stl", b"tab\t.stl", "Gehäuse.stl".encode()]


def odd_files(folder: Path) -> list[Path]:
    """Files of such names: the first four are parts, the others near-duplicates of them, so that all are named."""
    paths = [Path(os.fsdecode(os.fsencode(folder) + b"/" + name)) for name in ODD]
    for i, path in enumerate(paths):
        write_stl(path, l_shape((20, 24, 28, 33)[i % 4]))
    return paths


@pytest.mark.usefixtures("fake_scenes")
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


@pytest.mark.usefixtures("fake_scenes")
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


@pytest.mark.usefixtures("fake_scenes")
def test_one_good_file_among_many_is_found(tmp_path: Path) -> None:
    preset = replace(MINI, train=1, val=0, test=0)
    files = [tmp_path / f"a{i:02d}.stl" for i in range(30)]
    for path in files:
        path.touch()
    write_stl(files[-1], l_shape(24))
    summary = generate(preset, tmp_path / "out", workers=1, sources=Sources.of(files))
    assert summary["counts"]["train"]["parts"] == 1


def without_physics(monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    """As where pybullet is not installed, or is built for another system."""
    imported = builtins.__import__

    def refuse(name: str, *rest: Any, **options: Any) -> Any:
        if name == "pybullet":
            raise error
        return imported(name, *rest, **options)

    monkeypatch.delitem(sys.modules, "pybullet", raising=False)
    monkeypatch.setattr(builtins, "__import__", refuse)


@pytest.mark.parametrize("error", [ImportError("no module"), OSError("invalid ELF header")])
def test_a_missing_physics_engine_is_no_fault_of_a_dataset(
    mini: Path, error: Exception, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    without_physics(monkeypatch, error)
    report = verify(mini, sample=1)
    assert (report.faults, report.rebuilt) == ((), ())
    (note,) = report.notes
    assert note.startswith("no scene generated again: physics: pybullet is missing or does not load")
    assert "kit1000[sim]" in note
    assert main(["verify", str(mini), "--sample", "1"]) == 0
    assert "faults: none" in capsys.readouterr().out


def test_generate_names_the_missing_engine_before_any_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    without_physics(monkeypatch, ImportError())
    with pytest.raises(PhysicsMissing, match=r"pip install 'kit1000\[sim\]'; it has wheels for Python 3.10 and 3.11"):
        generate(MINI, tmp_path / "out", workers=1)
    assert not (tmp_path / "out/plan.json").exists()
    assert issubclass(PhysicsMissing, InputError)
