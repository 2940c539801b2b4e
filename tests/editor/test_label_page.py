"""The page of labels without a browser: select, drag, carry, fit, confirm."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import viser

from kit1000.dataset.reader import Dataset
from kit1000.editor.label_page import LabelPage, labelling
from kit1000.labelling.label_records import read_record, write_record
from kit1000.pose import Pose
from tests.samples.labelled_scenes import SCENE, own_folder, sample_scene, shapes_folder, true_record

SERVER = viser.ViserServer


@pytest.fixture
def page(tmp_path: Path) -> Iterator[LabelPage]:
    root, source = own_folder(tmp_path / "mine"), shapes_folder(tmp_path / "shapes")
    write_record(root, true_record(sample_scene(), source))
    with labelling(root, None, None, ()) as (opened, address):
        assert address.startswith("http://127.0.0.1:")
        yield opened


def test_the_page_has_a_title_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    titles: list[str] = []

    def server(*args: Any, label: str, **options: Any) -> viser.ViserServer:
        titles.append(label)
        return SERVER(*args, label=label, **options)

    monkeypatch.setattr(viser, "ViserServer", server)
    root, source = own_folder(tmp_path / "mine"), shapes_folder(tmp_path / "shapes")
    write_record(root, true_record(sample_scene(), source))
    with labelling(root, None, None, ()):
        assert titles == ["kit1000 label"]


def ray_to(point: np.ndarray, eye: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return eye, point - eye


def test_a_drag_slides_a_body_over_the_table(page: LabelPage) -> None:
    before = page.correction.world_from_body("tee")
    eye = np.array([0.0, -0.4, 0.6])
    middle = before.apply(page.correction.mesh("tee").bounds.mean(0))
    wanted = np.array([0.03, -0.02, 0.0])
    page.drag("tee", ray_to(middle, eye), (0.5, 0.5), "start", turns=False)
    page.drag("tee", ray_to(middle + 0.5 * wanted, eye), (0.55, 0.5), "update", turns=False)
    page.drag("tee", ray_to(middle + wanted, eye), (0.6, 0.5), "end", turns=False)
    after = page.correction.world_from_body("tee")
    assert np.allclose(after.xyz - before.xyz, wanted, atol=1e-9)
    assert np.allclose(after.rotation_matrix(), before.rotation_matrix())
    assert page.selected == "tee"


def test_a_drag_with_a_key_turns_it_about_the_vertical(page: LabelPage) -> None:
    before = page.correction.world_from_body("tee")
    middle = before.apply(page.correction.mesh("tee").bounds.mean(0))
    ray = ray_to(middle, np.array([0.0, -0.4, 0.6]))
    page.drag("tee", ray, (0.5, 0.5), "start", turns=True)
    page.drag("tee", ray, (0.75, 0.5), "end", turns=True)
    after = page.correction.world_from_body("tee")
    turn = (after @ before.inverse()).rotvec()
    assert np.allclose(turn, (0, 0, np.pi / 2), atol=1e-9)
    assert np.allclose(after.apply(page.correction.mesh("tee").bounds.mean(0)), middle)
    page.take_back()
    assert np.allclose(page.correction.world_from_body("tee").matrix(), before.matrix())


def test_the_gizmo_carries_the_selected_body_and_fit_puts_it_back(page: LabelPage) -> None:
    page.select("bracket")
    before = page.correction.world_from_body("bracket")
    middle = page.correction.mesh("bracket").bounds.mean(0)
    handle = Pose(before.wxyz, before.apply(middle) + (3e-3, 2e-3, 1e-3))
    page.carry(handle, done=False)
    assert page.correction.body("bracket").moved is False  # only when it is let go
    page.carry(handle, done=True)
    assert page.correction.body("bracket").moved
    page.fit()
    off = page.correction.world_from_body("bracket").xyz - before.xyz
    assert np.linalg.norm(off) < 1e-3


def test_confirming_all_writes_the_truth(page: LabelPage) -> None:
    page.person = "A. Person"
    page.confirm(everything=True)
    root = page.correction.scenes.root
    assert read_record(root, SCENE).confirmed
    assert (root / "labels" / f"{SCENE}.png").is_file()
    assert len(list(Dataset(root).split("test", truth=True).scene(SCENE).truth.parts)) == 2
