"""Files with volumes of slicers: PrusaSlicer itself finds the same bodies of the same volume, where it is installed."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from kit1000.parts.files.read import read_mesh
from tests.samples.foreign_files import PART, archive, helper, mesh_xml, model_xml, object_xml, slic3r_config

SLICER = shutil.which("prusa-slicer")
TWO = object_xml(1, mesh_xml(PART, helper()))
APART = object_xml(1, mesh_xml(PART)) + object_xml(2, mesh_xml(helper(60)))
FILAMENT = np.pi / 4 * 1.75**2  # [mm2]
EXACT = {"perimeters": "0", "fill-density": "100%", "fill-pattern": "rectilinear", "skirts": "0", "infill-overlap": "0"}
EXACT |= {"infill-anchor": "0", "top-solid-layers": "0", "bottom-solid-layers": "0", "start-gcode": ""}
EXACT |= dict.fromkeys(("layer-height", "first-layer-height"), "0.2")
EXACT |= {f"{name}extrusion-width": "0.45" for name in ("", "first-layer-", "infill-", "solid-infill-")}

pytestmark = pytest.mark.skipif(SLICER is None, reason="prusa-slicer is not installed (Debian: apt-get install)")


def of_volumes(kind: str, first: str = "ModelPart") -> tuple[str, dict[str, str]]:
    """A model of one object with two volumes, and the configuration that gives their types."""
    return model_xml(TWO, 'objectid="1"'), slic3r_config((0, 11, first), (12, 23, kind))


PLAIN = model_xml(object_xml(1, mesh_xml(PART)), 'objectid="1"')
NESTED = object_xml(1, mesh_xml(PART)) + object_xml(
    2, '<components><component objectid="1" transform="0 1 0 -1 0 0 0 0 1 5 6 0"/></components>'
)
FILES: dict[str, tuple[str, dict[str, str]]] = {
    "one part": (PLAIN, {}),
    "modifier": of_volumes("ParameterModifier"),
    "support enforcer": of_volumes("SupportEnforcer"),
    "support blocker": of_volumes("SupportBlocker"),
    "inches": (PLAIN.replace("millimeter", "inch"), {}),
    "turned component": (model_xml(NESTED, 'objectid="2"'), {}),
    "mirrored item": (PLAIN.replace("<item ", '<item transform="-1 0 0 0 1 0 0 0 1 0 0 0" '), {}),
    "scaled item": (PLAIN.replace("<item ", '<item transform="2 0 0 0 2 0 0 0 2 0 0 0" '), {}),
}


def stated(path: Path) -> tuple[list[float], int]:
    """The volumes [mm3] of the objects that the slicer finds, and the number of their bodies."""
    text = subprocess.run([str(SLICER), "--info", path], capture_output=True, text=True, check=True).stdout
    volumes = [float(value) for value in re.findall(r"^volume = +(\S+)", text, re.MULTILINE)]
    return volumes, sum(map(int, re.findall(r"^number_of_parts = +(\d+)", text, re.MULTILINE)))


def printed_volume(path: Path) -> float:
    """[mm3] the material in a print that is filled throughout, without walls."""
    out = path.with_suffix(".gcode")
    options = [word for name, value in EXACT.items() for word in (f"--{name}", value)]
    subprocess.run([str(SLICER), "--export-gcode", path, "--output", out, *options], capture_output=True, check=True)
    (length,) = re.findall(r"filament used \[mm\] = (\S+)", out.read_text(encoding="utf-8"))
    return float(length) * FILAMENT


@pytest.mark.parametrize("name", FILES)
def test_the_slicer_states_the_volume_that_is_read(name: str, tmp_path: Path) -> None:
    path = archive(tmp_path / "part.3mf", *FILES[name])
    (volume,), bodies = stated(path)
    assert bodies == 1
    assert read_mesh(path).mesh.volume * 1e9 == pytest.approx(volume, rel=1e-5)


def test_the_slicer_prints_as_much_of_a_part_with_a_negative_volume(tmp_path: Path) -> None:
    plain, cut = archive(tmp_path / "a.3mf", PLAIN), archive(tmp_path / "b.3mf", *of_volumes("NegativeVolume"))
    left = read_mesh(cut).mesh.volume / read_mesh(plain).mesh.volume
    assert left == pytest.approx(5744 / 6000, rel=1e-5)
    assert printed_volume(cut) / printed_volume(plain) == pytest.approx(left, abs=0.01)


def test_the_slicer_does_not_print_an_item_that_is_not_printable(tmp_path: Path) -> None:
    model = model_xml(APART, 'objectid="1" printable="1"', 'objectid="2" printable="0"')
    path, plain = archive(tmp_path / "a.3mf", model), archive(tmp_path / "b.3mf", PLAIN)
    assert read_mesh(path).mesh.volume == pytest.approx(read_mesh(plain).mesh.volume)
    assert printed_volume(path) == pytest.approx(printed_volume(plain), rel=0.01)
