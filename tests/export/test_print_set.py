"""Print sets: parts in pairs on brackets, read back from their 3MF and as the shapes of a scene."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kit1000.dataset.geometry import Geometry
from kit1000.errors import InputError
from kit1000.export.print_set import BED, PRINTS, write_print_set
from kit1000.files import read_json, sha256
from kit1000.labelling.known_kits import kits_of_folder
from kit1000.mesh import solid_from_mesh
from kit1000.parts.files.read import read_mesh
from tests.samples.labelled_scenes import shapes_folder


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of two parts."""
    folder = tmp_path_factory.mktemp("data")
    shapes_folder(folder, ("channel", "elbow"))  # neither seats in the slot of the other
    return folder


@pytest.fixture(scope="module")
def prints(data: Path) -> Path:
    out = data / "prints"
    ((made, parts),) = write_print_set(data, out, brackets_deg=(25.0,)).items()
    assert {made, *parts} == set(Geometry(data).parts)
    return out


def test_the_second_plate_has_the_angle_of_its_bracket(prints: Path) -> None:
    (assembly_id,) = Geometry(prints).assemblies
    first, second = Geometry(prints).assembly(assembly_id).mounts
    assert np.allclose(first.assembly_from_kit.rotate((0.0, 0.0, 1.0)), (0, 0, 1))
    axis = second.assembly_from_kit.rotate((0.0, 0.0, 1.0))
    assert np.degrees(np.arccos(axis[2])) == pytest.approx(25, abs=1e-6)


def printed_volumes(folder: Path) -> dict[str, tuple[float, float]]:
    """[m^3] volume of each assembly and part of a print set, and of its 3MF as read back."""
    geometry, found = Geometry(folder), {}
    for kind, names in (("kits", geometry.assemblies), ("part", geometry.parts)):
        for name in names:
            mesh = geometry.assembly(name).mesh if kind == "kits" else geometry.part(name).mesh
            again = read_mesh(folder / PRINTS / f"{kind}-{name}.3mf").mesh
            found[f"{kind}-{name}"] = (solid_from_mesh(mesh).volume(), solid_from_mesh(again).volume())
    return found


def test_what_is_printed_is_what_is_known(prints: Path) -> None:
    volumes = printed_volumes(prints)
    assert len(volumes) == 3
    for name, (known, printed) in volumes.items():
        assert printed == pytest.approx(known, rel=1e-4), name
    assert Geometry(prints).assembly(next(iter(Geometry(prints).assemblies))).mesh.extents[:2].max() <= BED


def test_the_set_is_read_as_the_shapes_of_a_scene(prints: Path, data: Path) -> None:
    kits = kits_of_folder(prints)
    assert [part.id for part in kits.parts] == [mount.kit.id for mount in kits.assembly.mounts]
    geometry = Geometry(data)
    for part, mount in zip(kits.parts, kits.assembly.mounts, strict=True):
        assert np.array_equal(part.mesh.vertices, geometry.part(part.id).mesh.vertices)
        assert len(mount.kit.slot.goals) == len(geometry.kit(part.id).slot.goals)


def test_every_file_is_listed_with_its_hash(prints: Path) -> None:
    files = read_json(prints / "dataset.json")["files"]
    found = {path.relative_to(prints).as_posix() for path in prints.rglob("*") if path.is_file()}
    assert found - set(files) == {"dataset.json"}
    assert all(sha256(prints / name) == digest for name, digest in files.items())


def test_wrong_wishes_are_refused_and_leave_nothing(prints: Path, data: Path, tmp_path: Path) -> None:
    out, full = tmp_path / "out", data
    one = next(iter(Geometry(full).parts))
    for options, message in (
        ({"ids": [one]}, "expected 2 different parts"),
        ({"ids": [one, one]}, "expected 2 different parts"),
        ({"ids": [one, "none-0001"]}, "--ids none-0001: no such part"),
    ):
        with pytest.raises(InputError, match=message):
            write_print_set(full, out, brackets_deg=(20.0,), **options)
    with pytest.raises(InputError, match=r"--brackets: expected angles of 10 to 45 degrees, got 60"):
        write_print_set(full, out, brackets_deg=(60.0,))
    with pytest.raises(InputError, match="exists already"):
        write_print_set(full, prints, brackets_deg=(20.0,))
    assert not out.exists()
