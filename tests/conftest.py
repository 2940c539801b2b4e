"""Fixtures of all tests: a small dataset, fake scenes, and the optional folder of real CAD parts."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from kit1000.generation import shards
from kit1000.generation.build import generate
from kit1000.generation.presets import PRESETS
from tests.samples.checkout import ROOT
from tests.samples.mini import HIDDEN, HIDDEN_SEED, MINI, Published, fake_scene, publish_by_command
from tests.samples.sources import loaded

settings.register_profile("kit1000", deadline=None)  # a busy machine may take its time
settings.load_profile("kit1000")

SLOW_TO_LOAD = {"torch", "playwright", "mlcroissant"}  # the browser comes by playwright
GENERATOR = "kit1000.generation.build"
GENERATED = {"mini", "withheld", "real_parts"}  # fixtures; those that build on them count too


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--quick", action="store_true", help="only tests without dataset, browser or torch (make check)")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """With --quick, whether a file loads what no quick test needs; such a file is not even imported."""
    if not config.getoption("--quick") or not collection_path.name.startswith("test_"):
        return None
    makes_datasets = f"from {GENERATOR} import" in collection_path.read_text(encoding="utf-8")
    return makes_datasets or not SLOW_TO_LOAD.isdisjoint(loaded(collection_path)) or None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """With --quick, leave out tests whose fixtures build on a generated dataset."""
    if config.getoption("--quick"):
        chosen, left_out = [], []
        for item in items:
            (chosen if GENERATED.isdisjoint(getattr(item, "fixturenames", ())) else left_out).append(item)
        config.hook.pytest_deselected(items=left_out)
        items[:] = chosen


def _folders() -> list[Path]:
    """The folder that KIT1000_REAL_PARTS names, else shared/parts/real beside the checkout, or none."""
    beside = ROOT.parent / "shared/parts/real"
    folder = Path(os.environ.get("KIT1000_REAL_PARTS") or beside)
    return [folder] if (folder / "manifest.csv").is_file() else []


@pytest.fixture(scope="session", autouse=True)
def no_sync() -> Iterator[None]:
    """Files are not forced onto the disk: no test pulls the plug, and thousands of small files would wait for it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda _: None)
        yield


@pytest.fixture(scope="session")
def mini(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The generated dataset MINI, with procedural parts and real scenes; read-only, one for all processes of a run."""
    own = tmp_path_factory.getbasetemp()
    shared = own.parent if "PYTEST_XDIST_WORKER" in os.environ else own
    with open(shared / "mini.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        generate(MINI, shared / "mini", workers=1)  # where another process was first, it finds it complete
    return shared / "mini"


@pytest.fixture(scope="session")
def withheld(tmp_path_factory: pytest.TempPathFactory) -> Published:
    """The generated dataset HIDDEN with a withheld test split; read-only, one for all processes of a run."""
    own = tmp_path_factory.getbasetemp()
    shared = own.parent if "PYTEST_XDIST_WORKER" in os.environ else own
    with open(shared / "withheld.lock", "w") as lock, pytest.MonkeyPatch.context() as patch:
        fcntl.flock(lock, fcntl.LOCK_EX)
        patch.setitem(PRESETS, "hidden", HIDDEN)
        return publish_by_command(shared / "withheld", "--seed", str(HIDDEN_SEED))


@pytest.fixture
def fake_scenes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replaces real scenes by fake ones, in this process."""
    monkeypatch.setattr(shards, "make_scene", fake_scene)


@pytest.fixture(scope="session", params=_folders(), ids=lambda folder: folder.name)
def real_parts(request: pytest.FixtureRequest) -> Path:
    """A folder of STL files with a manifest.csv that says which are closed; tests that ask for it need it."""
    return request.param
