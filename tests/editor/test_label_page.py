"""The page of labels without a browser: select, drag, carry, fit, confirm."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import viser

from kit1000.camera import look_at
from kit1000.dataset.reader import Dataset
from kit1000.editor.display import body_node
from kit1000.editor.label_page import LabelPage, labelling
from kit1000.editor.pointing import Eye
from kit1000.labelling.label_records import read_record, write_record
from kit1000.pose import Pose
from tests.samples.labelled_scenes import SCENE, own_folder, sample_scene, shapes_folder, true_record

SERVER = viser.ViserServer
EYE = Eye(look_at((0.0, -0.4, 0.6), (0.0, 0.0, 0.0)), float(np.radians(45)), 1.6)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene `mine` with true labels beside the folder of its shapes, to be copied."""
    place = tmp_path_factory.mktemp("labels")
    root, source = own_folder(place / "mine"), shapes_folder(place / "shapes")
    write_record(root, true_record(sample_scene(), source))
    return place


@pytest.fixture
def page(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[LabelPage]:
    titles: list[str] = []

    def server(*args: Any, label: str, **options: Any) -> viser.ViserServer:
        titles.append(label)
        return SERVER(*args, label=label, **options)

    monkeypatch.setattr(viser, "ViserServer", server)
    with labelling(shutil.copytree(folder, tmp_path / "labels") / "mine", None, None) as (opened, address):
        assert address.startswith("http://127.0.0.1:")
        assert titles == ["kit1000 label"]
        yield opened


def body_of(page: LabelPage, name: str) -> int:
    return page.correction.body(name).label


def middle_of(page: LabelPage, name: str) -> np.ndarray:
    return page.correction.world_from_body(name).apply(page.correction.mesh(name).bounds.mean(0))


def test_a_drag_slides_a_body_over_the_table(page: LabelPage) -> None:
    before, middle, wanted = (
        page.correction.world_from_body("tee"),
        middle_of(page, "tee"),
        np.array([0.03, -0.02, 0.0]),
    )
    page.grab(body_of(page, "tee"), EYE, EYE.screen(middle), middle)
    for share in (0.5, 1.0):
        page.drag(EYE.screen(middle + share * wanted))
    page.release()
    after = page.correction.world_from_body("tee")
    assert np.allclose(after.xyz - before.xyz, wanted, atol=1e-9)
    assert np.allclose(after.rotation_matrix(), before.rotation_matrix())
    assert page.selected == "tee"


def test_another_mesh_of_a_body_still_sends_its_events(page: LabelPage, monkeypatch: pytest.MonkeyPatch) -> None:
    listened: list[str] = []
    monkeypatch.setattr(viser.MeshHandle, "on_click", lambda handle, _: listened.append(handle.name))
    label = body_of(page, "tee")
    page.stage.show(body_node(label), page.correction.mesh("tee"), (9, 9, 9), None)
    page.stage.show("/something-else", page.correction.mesh("tee"), (9, 9, 9), None)
    assert listened == [body_node(label)]


def test_a_drag_with_a_key_turns_it_about_the_vertical(page: LabelPage) -> None:
    before, middle = page.correction.world_from_body("tee"), middle_of(page, "tee")
    page.grab(body_of(page, "tee"), EYE, (0.5, 0.5), middle, "cmd/ctrl")
    page.drag((0.75, 0.5))
    page.release()
    after = page.correction.world_from_body("tee")
    assert np.allclose((after @ before.inverse()).rotvec(), (0, 0, np.pi / 2), atol=1e-9)
    assert np.allclose(middle_of(page, "tee"), middle)
    page.command("take-back")
    assert np.allclose(page.correction.world_from_body("tee").matrix(), before.matrix())


def test_the_gizmo_carries_the_selected_body_and_fit_puts_it_back(page: LabelPage) -> None:
    page.select(body_of(page, "bracket"))
    before = page.correction.world_from_body("bracket")
    handle = Pose(before.wxyz, middle_of(page, "bracket") + (3e-3, 2e-3, 1e-3))
    page.carry(handle, done=False)
    assert page.correction.body("bracket").moved is False  # only when it is released
    page.carry(handle, done=True)
    assert page.correction.body("bracket").moved
    page.command("fit")
    off = page.correction.world_from_body("bracket").xyz - before.xyz
    assert np.linalg.norm(off) < 1e-3


def test_confirming_all_writes_the_truth(page: LabelPage) -> None:
    page.stage.entered = "A. Person"
    page.command("confirm-all")
    root = page.correction.scenes.root
    assert read_record(root, SCENE).confirmed
    assert (root / "labels" / f"{SCENE}.png").is_file()
    assert len(list(Dataset(root).split("test", truth=True).scene(SCENE).truth.parts)) == 2
