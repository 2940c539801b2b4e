"""Shapes from folders and from the two files of a kit: slots and goals as they were designed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kit1000.dataset.mesh_files import stl_bytes
from kit1000.dataset.own_scenes import OWN
from kit1000.errors import InputError
from kit1000.export.own_part import KitOptions, make_kit_from_file
from kit1000.known_shapes.known_kits import kits_of_files, kits_of_folder, read_known_kits
from kit1000.pose import Pose
from tests.samples.kits import sample_kit, sample_part
from tests.samples.labelled_scenes import sample_kits, shapes_folder


def write_pair(folder: Path, lift: float = 0.0, aside: float = 0.0) -> tuple[Path, Path]:
    """The files of a kit and its seated part, lifted and moved aside by distances [m]."""
    kit, part = sample_kit("bracket"), sample_part("bracket")
    seated = part.mesh.moved(Pose.from_translation((aside, 0.0, lift)) @ kit.slot.kit_from_part)
    (folder / "plate.stl").write_bytes(stl_bytes(kit.mesh))
    (folder / "seated.stl").write_bytes(stl_bytes(seated))
    return folder / "plate.stl", folder / "seated.stl"


def test_a_folder_gives_its_assembly_with_the_parts_of_its_mounts(tmp_path: Path) -> None:
    source = shapes_folder(tmp_path)
    kits = kits_of_folder(tmp_path)
    assert [part.id for part in kits.parts] == ["bracket", "tee"]
    assert read_known_kits(kits.source).assembly.id == source["assembly"]
    assert np.array_equal(kits.assembly.mesh.vertices, sample_kits().assembly.mesh.vertices)
    with pytest.raises(InputError, match=r"no assembly 'brackett'; did you mean bracket"):
        kits_of_folder(tmp_path, "brackett")
    with pytest.raises(InputError, match=r"no part 'T'.*bracket, tee"):
        kits.part("T")


def test_two_files_give_the_slot_that_was_designed(tmp_path: Path) -> None:
    kits = kits_of_files(*write_pair(tmp_path), clearance=2.5e-3)
    (mount,), slot = kits.assembly.mounts, sample_kit("bracket").slot
    found = mount.kit.slot
    assert found.depth == pytest.approx(slot.depth, abs=1e-6)
    assert len(found.goals) == len(slot.goals)
    seated = found.kit_from_part.apply(kits.parts[0].mesh.vertices)
    designed = slot.kit_from_part.apply(sample_part("bracket").mesh.vertices)
    assert np.allclose(np.sort(seated, axis=0), np.sort(designed, axis=0), atol=2e-6)
    assert kits.assembly.mesh.bounds[0, 2] == pytest.approx(0, abs=1e-7)
    again = read_known_kits(kits.source)
    assert np.array_equal(again.parts[0].mesh.vertices, kits.parts[0].mesh.vertices)


def test_the_clearance_is_read_from_the_report_beside_the_kit(tmp_path: Path) -> None:
    (tmp_path / "mine.stl").write_bytes(stl_bytes(sample_part("foot").mesh))
    make_kit_from_file(tmp_path / "mine.stl", tmp_path / "kit", KitOptions(1.5e-3, preview=False))
    kits = kits_of_files(tmp_path / "kit/kit.stl", tmp_path / "kit/part.stl")
    assert kits.assembly.mounts[0].kit.slot.clearance == pytest.approx(1.5e-3)
    with pytest.raises(InputError, match=r"--assembly any: is for a dataset; .*kit holds one kit"):
        kits_of_folder(tmp_path / "kit", "any")
    assert kits.parts[0].id == "kit"  # its folder: every part.stl has that name


def test_goals_are_told_for_own_scenes_without_truth_alone() -> None:
    """Files of a kit show the part seated; in scenes with ground truth goals are never input of a method."""
    kits = sample_kits()
    own = {OWN: {}}
    told = kits.shapes_for(own)
    for mount, part in zip(kits.assembly.mounts, kits.parts, strict=True):
        goals = told.goals[part.id]
        assert np.allclose(goals.xyz, (mount.assembly_from_kit @ mount.kit.slot.goals).xyz)
        assert told.clearances[part.id] == mount.kit.slot.clearance
    for scored in ({}, own | {"files": {"test/0000.truth.mcap": ""}}):
        assert not kits.shapes_for(scored).goals
        assert not kits.shapes_for(scored).clearances


def test_files_that_do_not_fit_are_refused_in_one_line(tmp_path: Path) -> None:
    plate, seated = write_pair(tmp_path)
    with pytest.raises(InputError, match=r"plate.stl: no report.json .*--clearance-mm"):
        kits_of_files(plate, seated)
    with pytest.raises(InputError, match=r"seated.stl: its lowest point is at .* mm .*expected the part seated"):
        kits_of_files(*write_pair(tmp_path, lift=0.05), clearance=2.5e-3)
    with pytest.raises(InputError, match=r"seated.stl: lies beside the kit"):
        kits_of_files(*write_pair(tmp_path, aside=0.2), clearance=2.5e-3)
    with pytest.raises(InputError, match=r"seated.stl: cuts into the kit by .* mm3"):
        kits_of_files(*write_pair(tmp_path, lift=-1.5e-3), clearance=2.5e-3)
    with pytest.raises(InputError, match=r"none.stl"):
        kits_of_files(tmp_path / "none.stl", seated, clearance=1e-3)
