"""The surface that the page shows of what an image hides of the kits: where the plate is, and nowhere else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree

from kit1000.dataset.reader import Dataset
from kit1000.mesh import Mesh, surface_points
from kit1000.perception.completion.kits import hidden_surface, hidden_surfaces
from kit1000.perception.image_kinds import IDEAL
from kit1000.perception.observed.kits import CELL, DEEPEST, CompletedHeights, ObservedKits, SeenHeights, seen_heights
from kit1000.perception.observed.plates import Plane
from kit1000.pose import Pose
from kit1000.registration.predictor import Registration
from kit1000.rng import stream
from kit1000.values import Query
from kit1000.weights import WEIGHTS
from tests.samples.completers import DEEP, WIDE, KnownPlate, plate_image

MOVED = Pose.from_rotvec((0.0, 0.0, 2.0), (0.3, -0.2, 0.1))


def completed(moved: Pose = MOVED) -> CompletedHeights:
    plate = Plane(moved.rotate((0.0, 0.0, 1.0)), moved.xyz, 0.0)
    return KnownPlate(moved)(seen_heights(plate_image(moved), plate, moved.apply((0.004, -0.003, 0.01)), IDEAL.noise))


def test_the_hidden_floor_and_walls_of_a_cavity_are_shown_where_they_are() -> None:
    surface = hidden_surface(completed())
    here = MOVED.inverse().apply(surface.vertices)
    assert np.abs(here[:, :2]).max() < WIDE / 2 + 2 * CELL  # the cavity with the cells that its rim crosses
    assert -DEEP - 1e-5 < here[:, 2].min() < -DEEP + 1e-5
    assert here[:, 2].max() < 1e-5
    hidden = DEEP * np.hypot(0.4, 0.1) / 0.45 * WIDE  # [m^2] of the floor, behind the near rim
    level = MOVED.inverse().rotate(surface.normals)[:, 2] > 0.99
    corners = surface.triangles[level]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    assert area == pytest.approx(hidden, rel=0.25)
    assert (MOVED.inverse().rotate(surface.normals)[:, 2] > 0).all()  # it faces up


def test_what_is_seen_and_what_has_no_surface_is_not_shown() -> None:
    relief = completed()
    shown = relief.shown
    seen = SeenHeights(shown.world_from_plate, shown.least, np.ones_like(shown.seen), shown.camera)
    assert len(hidden_surface(CompletedHeights(seen, relief.depths)).faces) == 0
    deep = np.where(shown.seen, relief.depths, np.float32(DEEPEST))
    assert len(hidden_surface(CompletedHeights(shown, deep)).faces) == 0
    nowhere = SeenHeights(shown.world_from_plate, shown.least, np.zeros_like(shown.seen), shown.camera)
    assert len(hidden_surface(CompletedHeights(nowhere, relief.depths)).faces) == 0  # no face, so no plate


def test_without_network_or_plates_the_surface_is_empty() -> None:
    kits = ObservedKits(plate_image(MOVED), IDEAL.noise, "tray")
    assert len(hidden_surfaces(kits).faces) == 0
    image = kits.image
    bare = ObservedKits(
        type(image)(image.view, np.zeros_like(image.labels)), IDEAL.noise, "bare", completer=KnownPlate(MOVED)
    )
    assert len(hidden_surfaces(bare).faces) == 0


@pytest.fixture(scope="module")
def queries(mini: Path) -> dict[str, Query]:
    split = Dataset(mini).split("test")
    scene = split.scene(split.scene_ids[0])
    return {query.sensor: query for query in scene.queries}


@pytest.mark.parametrize(("sensor", "near"), [("ideal", 1e-3), ("d415", 4e-3)])
def test_the_kits_of_a_scene_are_completed_near_their_true_surface(
    mini: Path, queries: dict[str, Query], sensor: str, near: float
) -> None:
    data, query = Dataset(mini), queries[sensor]
    assert Registration(data).completed_kits(query) is None
    surface = Registration(data, kit_completion=WEIGHTS / "kit-completion").completed_kits(query)
    assert surface is not None
    assert len(surface.faces) > 50
    mesh, pose = data.split("test", truth=True).scene(query.scene_id).bodies()[1]
    true = surface_points(Mesh(pose.apply(mesh.vertices), mesh.faces), 300_000, stream(0))
    distances, _ = KDTree(true).query(surface.vertices)
    assert np.median(distances) < near
