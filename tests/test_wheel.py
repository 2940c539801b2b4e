"""The wheel alone, outside the checkout: generates, imports, predicts, runs the robot, opens the page."""

from __future__ import annotations

import re
import subprocess
import sys
import sysconfig
from collections.abc import Callable
from pathlib import Path
from urllib.request import urlopen

import numpy as np
import pytest
from PIL import Image

from kit1000.dataset.reader import Dataset

ROOT = Path(__file__).resolve().parents[1]
Command = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An empty folder beside an environment `env` with the wheel and what it depends on, and without the checkout."""
    place = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", str(place / "dist")]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(place / "env")], check=True)
    site = next((place / "env/lib").glob("python*/site-packages"))
    (site / "dependencies.pth").write_text(sysconfig.get_paths()["purelib"] + "\n")  # its own .pth files are not read
    wheel = next((place / "dist").glob("*.whl"))
    install = [sys.executable, "-m", "pip", "--python", str(place / "env"), "install", "--no-deps", "--quiet"]
    subprocess.run([*install, "--no-index", "--ignore-installed", str(wheel)], check=True)
    (place / "empty").mkdir()
    return place / "empty"


@pytest.fixture(scope="module")
def kit1000(folder: Path) -> Command:
    """Runs the installed command in the empty folder; returns what it printed."""

    def run(*words: str) -> subprocess.CompletedProcess[str]:
        done = subprocess.run([folder.parent / "env/bin/kit1000", *words], cwd=folder, capture_output=True, text=True)
        assert done.returncode in (0, 1), done.stderr
        return done

    return run


@pytest.fixture(scope="module")
def tiny(folder: Path, kit1000: Command) -> Path:
    assert kit1000("generate", "tiny", "--out", "tiny", "--workers", "1").returncode == 0  # two compile the same loops
    return folder / "tiny"


@pytest.mark.slow
@pytest.mark.usefixtures("tiny")
def test_the_wheel_predicts_by_networks_and_lets_the_robot_run(kit1000: Command) -> None:
    predict = ("predict", "registration-completed", "--data", "tiny", "--tracks")
    assert "predictions of registration-completed (snap)" in kit1000(*predict, "snap", "--out", "mine").stdout
    assert "no faults" in kit1000("check", "mine", "--data", "tiny").stdout
    found = kit1000(*predict, "snap-d415", "--masks", "predicted", "--limit", "1", "--out", "found")
    assert "1 predictions" in found.stdout
    assert " seated" in kit1000("run", "tiny", "--predictions", "mine", "--scene", "test-s0000").stdout


@pytest.mark.slow
@pytest.mark.usefixtures("tiny")
@pytest.mark.parametrize("snap", [(), ("--snap", "registration-completed")])
def test_the_wheel_opens_the_page(folder: Path, snap: tuple[str, ...]) -> None:
    check_page(folder, "tiny", "--scene", "test-s0000", *snap)


@pytest.mark.slow
def test_the_wheel_imports_an_image_and_predicts_for_it(folder: Path, kit1000: Command, tiny: Path) -> None:
    view = Dataset(tiny).split("test").scene("test-s0000").labelled_depth("d415").view
    millimetres = np.rint(1e3 * view.depth).astype(np.uint16)
    Image.fromarray(millimetres).save(folder / "depth.png")
    numbers = [str(value) for value in (view.camera.fx, view.camera.fy, view.camera.cx, view.camera.cy)]
    listed = kit1000("import", "depth.png", "--intrinsics", *numbers, "--stream", "raw", "--out", "own").stdout
    assert "kit\n" in listed
    predict = ("predict", "registration-completed", "--data", "own", "--limit", "1", "--out", "own-answers")
    assert "1 predictions of registration-completed" in kit1000(*predict).stdout
    check_page(folder, "own", "--out", "own-edits")
    check_moves(folder, "own")


def check_moves(folder: Path, data: str) -> None:
    """Confirm a part as the page does when it is edited and ended, and read moves.json by the lines of the docs."""
    place = folder / "confirmed"
    place.mkdir()
    confirm = [folder.parent / "env/bin/python", "-c", CONFIRM, str(folder / data)]
    done = subprocess.run(confirm, cwd=place, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    where = Path(done.stdout.split()[0])
    assert where.is_relative_to(folder.parent / "env"), "the wheel, not the checkout"
    assert (place / "edits/predictions.csv").read_text("utf-8").count("-p0-") == 2  # of both tracks
    page = (ROOT / "docs/reference/moves.md").read_text("utf-8")
    (lines,) = re.findall(r"^```py\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    read = subprocess.run([sys.executable, "-c", lines], cwd=place, capture_output=True, text=True)
    assert read.returncode == 0, read.stderr
    rows = [line.split() for line in read.stdout.splitlines()]
    assert [row[:3] for row in rows] == [["test-s0000", "0", name] for name in ("pick", "hover", "seated")]
    hover, seated = (np.array(row[3:6], float) for row in rows[1:])
    assert np.linalg.norm(hover - seated) == pytest.approx(0.1)


CONFIRM = """
import sys
from pathlib import Path
import kit1000
from kit1000.editor.serve import Options, editing
from kit1000.pose import Pose
options = Options(Path(sys.argv[1]), "test-s0000", Path("edits"), "d415")
with editing(options, moves=True) as (controller, _):
    scene = controller.space.scene
    part, plate = scene.parts[0], scene.plates[0]
    controller.place(part, Pose.from_translation(plate.point - scene.pivot(part)))
    controller.command("confirm")
print(kit1000.__file__)
"""


def check_page(folder: Path, *options: str) -> None:
    """Open the page as `kit1000 edit` does, ask for it, and end it."""
    words = [folder.parent / "env/bin/kit1000", "edit", *options]
    with subprocess.Popen(words, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as page:
        try:
            assert page.stdout is not None
            address = page.stdout.readline().split()[0]
            assert urlopen(address, timeout=30).status == 200
        finally:
            page.terminate()
            try:
                page.communicate(timeout=60)
            except subprocess.TimeoutExpired:
                page.kill()
                raise


def test_the_wheel_holds_neither_baselines_nor_benchmark() -> None:
    """Their names are taken by other published packages; nothing in the library mentions the modules of either."""
    sources = (path.read_text(encoding="utf-8") for path in (ROOT / "kit1000").rglob("*.py"))
    assert not [text for text in sources if "import baselines" in text or "from baselines" in text]
