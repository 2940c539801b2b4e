"""Tests of shards: their scenes follow from the plan alone, and a refused scene affects no other."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kit1000.dataset.mcap_io import ObservationFile, TruthFile
from kit1000.dataset.reader import Dataset
from kit1000.dataset.scene_data import SCENES_PER_SHARD
from kit1000.errors import Redraw
from kit1000.files import read_json
from kit1000.generation import scene_files as module
from kit1000.generation.build import generate
from kit1000.generation.plan import scene_id_of
from kit1000.generation.readme import readme_bytes
from kit1000.generation.scene_files import EXTRA_VIEWS, TRUTH, make_shard, shard_jobs
from kit1000.generation.statistics import add_up, scene_statistics
from kit1000.generation.verify import verify
from tests.samples.mini import MINI, fake_scene, file_hashes, l_shape_sources

ROOT = Path("root")


def planned(count: int) -> list[str]:
    return [f"train-{k:04d}" for k in range(count)]


@given(st.integers(0, 120), st.sets(st.integers(0, 119)))
def test_shards_contain_every_usable_assembly_once(count: int, gone: set[int]) -> None:
    usable = {i for k, i in enumerate(planned(count)) if k not in gone}
    jobs = shard_jobs(ROOT, MINI, 7, "train", planned(count), usable)
    assert [i for job in jobs for i in job.assemblies] == sorted(usable)
    assert all(0 < len(job.assemblies) <= SCENES_PER_SHARD for job in jobs)


@given(st.integers(1, 120), st.sets(st.integers(0, 119)))
def test_an_unusable_assembly_moves_no_other_to_another_shard(count: int, gone: set[int]) -> None:
    usable = {i for k, i in enumerate(planned(count)) if k not in gone}
    whole = {i: job.id for job in shard_jobs(ROOT, MINI, 7, "train", planned(count), set(planned(count)))
             for i in job.assemblies}  # fmt: skip
    left = {i: job.id for job in shard_jobs(ROOT, MINI, 7, "train", planned(count), usable) for i in job.assemblies}
    assert left == {i: whole[i] for i in usable}


def refusing_scene(*assembly_ids: str) -> Callable[..., Any]:
    """`fake_scene`, except that some assemblies are refused."""

    def make(preset: Any, seed: int, split: str, assembly: Any, parts: Any, extra_views: bool) -> Any:
        if assembly.id in assembly_ids:
            raise Redraw("none of 60 layouts passes, mostly: parts touch")
        return fake_scene(preset, seed, split, assembly, parts, extra_views)

    return make


def generated(folder: Path, *refused: str) -> Path:
    """A dataset with fake scenes, some of them refused."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "make_scene", refusing_scene(*refused))
        generate(MINI, folder / "data", workers=1, sources=l_shape_sources(folder / "files"))
    return folder / "data"


def test_a_refused_scene_is_reported_and_the_others_are_made(tmp_path: Path) -> None:
    root, whole = generated(tmp_path / "a", "train-0001"), generated(tmp_path / "b")
    summary = read_json(root / "dataset.json")
    assert summary["refused_scenes"] == {"train-s0001": "none of 60 layouts passes, mostly: parts touch"}
    assert summary["counts"]["train"] == {"parts": 2, "assemblies": 2, "scenes": 1}
    assert summary["shards"]["train/0000.mcap"] == ["train-s0000"]
    seen, same = (ObservationFile(folder / "train/0000.mcap") for folder in (root, whole))
    assert seen.scene_ids == ("train-s0000",)
    assert seen.content_hash("train-s0000") == same.content_hash("train-s0000")
    assert TruthFile(root / "train/0000.truth.mcap").scene_ids == ("train-s0000",)
    assert [scene.id for scene in Dataset(root).split("train")] == ["train-s0000"]
    assert verify(root).faults == ()
    assert b"none of 60 layouts passes, mostly: parts touch" in readme_bytes(summary)


def test_a_shard_without_a_scene_has_no_files(tmp_path: Path) -> None:
    root = generated(tmp_path, "test-0000")
    summary = read_json(root / "dataset.json")
    assert not [name for name in file_hashes(root) if name.startswith("test/")]
    assert list(summary["shards"]) == ["train/0000.mcap", "val/0000.mcap"]
    assert summary["counts"]["test"] == {"parts": 1, "assemblies": 1, "scenes": 0}
    assert verify(root).faults == ()


def test_redraws_and_statistics_are_those_of_the_scenes(tmp_path: Path) -> None:
    summary = read_json(generated(tmp_path, "val-0000") / "dataset.json")
    scenes = [i for scene_ids in summary["shards"].values() for i in scene_ids]
    kits = read_json(tmp_path / "data/assemblies.json")
    sizes = [len(kits[i.replace("-s", "-")]["mounts"]) + MINI.seed % 2 for i in scenes]  # as in `fake_scene`
    assert summary["redraws"]["scenes"] == {"parts touch": sum(sizes)}
    for split in ("train", "val", "test"):
        paths = [tmp_path / "data" / name for name in summary["shards"] if name.startswith(split)]
        files = [TruthFile(path.with_suffix(TRUTH)) for path in paths]
        figures = add_up(scene_statistics([file.truth(i)]) for file in files for i in file.scene_ids)
        assert figures.items() <= summary["statistics"][split].items()


def test_the_files_of_a_shard_have_the_same_scenes(mini: Path) -> None:
    for shard, scene_ids in read_json(mini / "dataset.json")["shards"].items():
        path = mini / shard
        assert list(ObservationFile(path).scene_ids) == list(TruthFile(path.with_suffix(TRUTH)).scene_ids) == scene_ids
        extra_views = path.with_suffix(EXTRA_VIEWS)
        assert extra_views.is_file() == shard.startswith("test/")
        assert not extra_views.is_file() or list(ObservationFile(extra_views).scene_ids) == scene_ids


def test_a_finished_shard_is_not_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fake_scenes: None) -> None:
    jobs = []
    original = make_shard
    monkeypatch.setattr("kit1000.generation.build.make_shard", lambda job: jobs.append(job) or original(job))
    monkeypatch.setattr("kit1000.generation.build.write_summary", lambda *_: {})
    generate(MINI, tmp_path / "data", workers=1, sources=l_shape_sources(tmp_path / "files"))
    records = [make_shard(job) for job in jobs]
    monkeypatch.setattr(module, "make_scene", refusing_scene("train-0000", "train-0001", "val-0000", "test-0000"))
    assert [make_shard(job) for job in jobs] == records
    assert [str(job) for job in jobs] == ["shard train/0000", "shard test/0000", "shard val/0000"]
    (tmp_path / "data/train/0000.truth.mcap").unlink()
    again = make_shard(jobs[0])
    assert again["refused"] == dict.fromkeys(
        map(scene_id_of, jobs[0].assemblies), "none of 60 layouts passes, mostly: parts touch"
    )
