"""Tests of generate with a URL: the bytes are those on disk, files are repaired, and missing files are reported."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from kit1000.engines import ParallelMap
from kit1000.errors import InputError
from kit1000.files import parse_folder, remove_folder, sha256
from kit1000.generation import shards
from kit1000.generation.build import generate
from kit1000.generation.plan import Sources
from tests.samples.mini import MINI, fake_scene, file_hashes, l_shape_sources

pytestmark = pytest.mark.usefixtures("fake_scenes")


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> Sources:
    return l_shape_sources(tmp_path_factory.mktemp("files"))


@pytest.fixture(scope="module")
def on_disk(sources: Sources, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The file hashes of a dataset on disk."""
    root = tmp_path_factory.mktemp("disk")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(shards, "make_scene", fake_scene)
        generate(MINI, root, workers=1, sources=sources)
    return file_hashes(root)


@pytest.fixture(params=["memory", "local"])
def remote(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Path]:
    """A folder behind a URL: without folders, as in object stores, and with folders that must be created."""
    place = parse_folder(f"{request.param}://{tmp_path}/root")
    yield place
    remove_folder(place)


def hashes(root: Path) -> dict[str, str | None]:
    """The SHA-256 of every file below a folder, by name."""
    return {str(path)[len(str(root)) + 1 :]: sha256(path) for path in root.rglob("*") if path.is_file()}


def test_a_dataset_has_the_bytes_of_one_on_disk_and_is_repaired(
    remote: Path, sources: Sources, on_disk: dict[str, str]
) -> None:
    summary = generate(MINI, remote, workers=1, sources=sources)
    assert hashes(remote) == on_disk
    (remote / "parts/train-0000.glb").unlink()
    assert generate(MINI, remote, workers=1, sources=sources) == summary
    assert hashes(remote) == on_disk


def test_another_folder_and_another_plan_are_refused(sources: Sources, tmp_path: Path) -> None:
    place = parse_folder(f"memory://{tmp_path}/thesis")
    (place / "thesis.tex").write_bytes(b"ten years")
    with pytest.raises(InputError, match="is not empty and contains no dataset: choose another --out"):
        generate(MINI, place, workers=1, sources=sources)
    (place / "plan.json").write_bytes(b'{"format": "of another program"}')
    with pytest.raises(InputError, match=r"^memory://.*thesis contains another dataset \(format"):
        generate(MINI, place, workers=1, sources=sources)


@contextmanager
def other_folder_engine(place: Path) -> Iterator[ParallelMap]:
    """An engine whose workers write to another folder, as with a disk of their own."""
    yield lambda function, jobs: (function(replace(job, root=place)) for job in jobs)


def test_files_written_to_the_disk_of_a_node_are_reported(sources: Sources, tmp_path: Path) -> None:
    out, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
    with pytest.raises(InputError, match=r"^parts/.*\.glb .*another machine.*out"):
        generate(MINI, out, sources=sources, engine=other_folder_engine(elsewhere))
    assert not (out / "dataset.json").exists()
