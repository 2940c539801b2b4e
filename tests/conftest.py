"""Fixtures of all tests: a small dataset, fake scenes, and the optional folder of real CAD parts."""

from __future__ import annotations

import atexit
import fcntl
import itertools
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

from kit1000.dataset.reader import Dataset
from kit1000.errors import Redraw
from kit1000.export import own_part
from kit1000.generation import parts_and_kits, scene_files
from kit1000.generation.build import generate
from kit1000.generation.presets import PRESETS
from kit1000.generation.withhold import publish
from kit1000.kits.kit import KitDesign, Plate
from kit1000.kits.kit_trials import Attempt, PairCheck, accepted_kit, attempts
from kit1000.pictures import lighting, shading
from kit1000.values import LabelledDepth, Part
from tests.samples.checkout import ROOT
from tests.samples.mini import HIDDEN, HIDDEN_SEED, MINI, Published, fake_scene, publish_by_command

settings.register_profile("kit1000", deadline=None, max_examples=12)  # a busy machine may take its time
settings.load_profile("kit1000")

# The processes of a run share the cores: further threads of torch would busily wait for each other.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# The last thing that a process prints are objects that manifold3d takes for leaked, since some outlive the interpreter.
atexit.register(lambda: os.dup2(os.open(os.devnull, os.O_WRONLY), 2))

GENERATED = {"mini", "withheld", "real_parts"}  # fixtures; those that build on them count too
LONG = 0.15  # [s] of processor time for a test function with all its cases
MEASURED = "kit1000/seconds"  # where pytest's cache keeps the seconds of each test function, as last measured here


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--quick", action="store_true", help=f"only tests without dataset that took at most {LONG} s here")


def pytest_configure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput"):  # the process that gathers the reports of all others
        config.pluginmanager.register(Times(config), "times")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """With --quick, leave out tests that took long at their last run, and those that need a generated dataset."""
    if not config.getoption("--quick"):
        return
    seconds = _measured(config)
    quick: list[pytest.Item] = []
    left_out: list[pytest.Item] = []
    for item in items:
        generated = not GENERATED.isdisjoint(getattr(item, "fixturenames", ()))
        (left_out if generated or seconds.get(_function(item.nodeid), 0) > LONG else quick).append(item)
    config.hook.pytest_deselected(items=left_out)
    items[:] = quick


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    before = os.times()
    try:
        return (yield)
    finally:
        item.user_properties.append(("seconds", sum(os.times()[:4]) - sum(before[:4])))  # and those of children


class Times:
    """Adds up the seconds of each test function and keeps them in pytest's cache, with those of earlier runs."""

    def __init__(self, config: pytest.Config) -> None:
        self.config = config
        self.seconds: dict[str, float] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "call":
            name = _function(report.nodeid)
            self.seconds[name] = self.seconds.get(name, 0.0) + float(str(dict(report.user_properties)["seconds"]))

    def pytest_sessionfinish(self) -> None:
        cache = getattr(self.config, "cache", None)  # -p no:cacheprovider: there is none
        if cache is not None:
            cache.set(MEASURED, _measured(self.config) | self.seconds)


def _measured(config: pytest.Config) -> dict[str, float]:
    cache = getattr(config, "cache", None)
    return cache.get(MEASURED, None) or {} if cache is not None else {}


def _function(node_id: str) -> str:
    """The test function without its case."""
    return node_id.partition("[")[0]


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


@pytest.fixture(scope="session", autouse=True)
def kits_once() -> Iterator[None]:
    """A process makes each kit once, for datasets and for own parts: most tests make the same few parts many times.

    That a kit is the same whenever it is made is tested with kits, and by datasets that other processes generate.
    """
    made: dict[tuple[Any, ...], Any] = {}
    begun: dict[tuple[Any, ...], tuple[list[Attempt], Iterator[Attempt]]] = {}

    def key_of(part: Part, *options: Any) -> tuple[Any, ...]:
        return part.id, part.family, part.mesh.vertices.tobytes(), part.mesh.faces.tobytes(), *options

    def attempts_once(part: Part, *options: Any) -> Iterator[Attempt]:
        earlier, further = begun.setdefault(key_of(part, *options), ([], attempts(part, *options)))
        for number in itertools.count():
            if number == len(earlier):
                attempt = next(further, None)
                if attempt is None:
                    return
                earlier.append(attempt)
            yield earlier[number]

    def once(part: Part, clearance: float, plate: Plate) -> tuple[KitDesign, PairCheck]:
        key = key_of(part, clearance, plate)
        if key not in made:
            try:
                made[key] = accepted_kit(part, clearance, plate)
            except Redraw as refusal:
                made[key] = refusal.reason
        if isinstance(made[key], str):
            raise Redraw(made[key])
        return made[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(parts_and_kits, "accepted_kit", once)
        patch.setattr(own_part, "attempts", attempts_once)
        yield
    begun.clear()


@pytest.fixture(scope="session")
def mini(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The generated dataset MINI, with procedural parts and real scenes; read-only, one for all processes of a run."""
    own = tmp_path_factory.getbasetemp()
    shared = own.parent if "PYTEST_XDIST_WORKER" in os.environ else own
    with open(shared / "mini.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        generate(MINI, shared / "mini", workers=1)  # where another process was first, it finds it complete
    return shared / "mini"


@pytest.fixture(scope="module")
def data(mini: Path) -> Dataset:
    """The same, opened."""
    return Dataset(mini)


@pytest.fixture(scope="session")
def exact(mini: Path) -> LabelledDepth:
    """The exact image of a scene, which tests of restoration measure by noisy sensors."""
    return next(iter(Dataset(mini).split("val"))).labelled_depth("ideal")


@pytest.fixture(scope="session")
def withheld(tmp_path_factory: pytest.TempPathFactory) -> Published:
    """The generated dataset HIDDEN with a withheld test split; read-only, one for all processes of a run."""
    own = tmp_path_factory.getbasetemp()
    shared = own.parent if "PYTEST_XDIST_WORKER" in os.environ else own
    with open(shared / "withheld.lock", "w") as lock, pytest.MonkeyPatch.context() as patch:
        fcntl.flock(lock, fcntl.LOCK_EX)
        patch.setitem(PRESETS, "hidden", HIDDEN)
        return publish_by_command(shared / "withheld", "--seed", str(HIDDEN_SEED))


@pytest.fixture(scope="session")
def public(mini: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The public part of a copy of the generated dataset, its test split withheld."""
    folder = tmp_path_factory.mktemp("published")
    publish(shutil.copytree(mini, folder / "whole"), folder / "open")
    return folder / "open"


@pytest.fixture
def fake_scenes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replaces real scenes by fake ones, in this process."""
    monkeypatch.setattr(scene_files, "make_scene", fake_scene)


@pytest.fixture
def quick_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures have one sample, and few lamps with coarse shadows; what they show stays."""
    monkeypatch.setattr(shading, "SHIFTS", shading.SHIFTS[:1])
    monkeypatch.setattr(lighting, "KEY_LAMPS", 3)
    monkeypatch.setattr(lighting, "SKY_LAMPS", 5)
    monkeypatch.setattr(lighting, "MAP_SIZE", 64)


@pytest.fixture(scope="session", params=_folders(), ids=lambda folder: folder.name)
def real_parts(request: pytest.FixtureRequest) -> Path:
    """A folder of STL files with a manifest.csv that says which are closed; tests that ask for it need it."""
    return request.param
