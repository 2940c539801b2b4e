"""Truth written from confirmed labels: read, scored and asked like a generated split."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.files import read_json, write_json
from kit1000.generation.verify import verify
from kit1000.labelling.label_records import write_record
from kit1000.labelling.labelled_folder import write_truth
from kit1000.labelling.scene_truth import true_camera
from kit1000.metrics import seatings
from kit1000.pose import Pose
from kit1000.queries.motions import goal_motion
from kit1000.sim.layout import UPRIGHT
from kit1000.values import LabelledDepth
from tests.samples.forgotten_truth import write_forgotten
from tests.samples.labelled_scenes import CLEARANCE, SCENE, own_folder, sample_scene, shapes_folder, true_record

PERSON = "A. Person"
OTHER = "test-s0001"


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    return shapes_folder(tmp_path_factory.mktemp("shapes"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, source: dict[str, str]) -> Path:
    """A folder of one labelled scene."""
    root = own_folder(tmp_path_factory.mktemp("mine"))
    assert write_truth(root, {SCENE: true_record(sample_scene(), source, PERSON)}) == []
    return root


def test_the_truth_is_that_of_the_labels(folder: Path) -> None:
    scene, recorded = sample_scene(), next(iter(Dataset(folder).split("test-all", truth=True)))
    assembly, *parts = recorded.scene.bodies
    assert np.allclose(assembly.world_from_body.matrix(), scene.world_from_assembly.matrix(), atol=1e-9)
    for body, true in zip(parts, scene.world_from_parts, strict=True):
        assert np.allclose(body.world_from_body.matrix(), true.matrix(), atol=1e-9)
    assert {row["rest_mode"] for row in recorded.truth.parts} == {UPRIGHT}
    assert [row["mount"] for row in recorded.truth.parts] == [0, 1]


def test_every_seen_part_is_asked_about_in_both_tracks(folder: Path) -> None:
    split = Dataset(folder).split("test-all", truth=True)
    queries = list(split.queries())
    assert sorted(query.id for query in queries) == [
        f"{SCENE}-p{i}-{track}" for i in range(2) for track in ("place-d415", "snap-d415")
    ]
    assert {query.track: query.guess is None for query in queries} == {"snap-d415": False, "place-d415": True}
    drawn = [query.track for query in Dataset(folder).split("test").queries()]
    assert sorted(drawn) == ["place-d415", "snap-d415"]  # one a track
    image = sample_scene().image
    for query in queries:
        assert np.array_equal(query.image.view.depth, image.view.depth)
        assert np.array_equal(query.image.labels, image.labels)


def test_the_true_motion_seats_every_part(folder: Path) -> None:
    dataset = Dataset(folder)
    truths = [t for recorded in dataset.split("test-all", truth=True) for t in recorded.truths.values()]
    motions = [goal_motion(t.world_from_part, t.world_from_kit, t.slot.kit_from_part) for t in truths]
    result = seatings(Pose.stack(motions), truths, dataset.geometry)
    assert result.seated.all()
    assert result.strict.all()
    beside = [Pose.from_translation((0.01, 0.0, 0.0)) @ motion for motion in motions]
    assert not seatings(Pose.stack(beside), truths, dataset.geometry).seated.any()


def test_writing_twice_gives_the_same_bytes(folder: Path, source: dict[str, str], tmp_path: Path) -> None:
    twice = own_folder(tmp_path)
    for _ in range(2):
        write_truth(twice, {SCENE: true_record(sample_scene(), source, PERSON)})
    for name in ("test/0000.mcap", "test/0000.truth.mcap", "dataset.json", "kits.json", "parts/tee.glb"):
        assert (twice / name).read_bytes() == (folder / name).read_bytes(), name


def test_labels_are_files_of_a_labelled_folder(source: dict[str, str], tmp_path: Path) -> None:
    root = own_folder(tmp_path)
    write_truth(root, {SCENE: true_record(sample_scene(), source, PERSON)})
    write_record(root, true_record(sample_scene(), source, PERSON))
    (root / "labels" / f"{SCENE}.png").write_bytes(b"a picture")
    report = verify(root, 1)
    assert report.faults == ()
    assert report.files == 10  # two recordings, three tables, five meshes
    (root / "parts" / "spare.glb").write_bytes(b"")
    (root / "parts" / "tee.glb").write_bytes(b"")
    faults = verify(root).faults
    assert [fault.partition(":")[0] for fault in faults] == ["parts/tee.glb", "parts/spare.glb"]


def test_bodies_without_a_shape_become_background(source: dict[str, str], tmp_path: Path) -> None:
    """The first part is no part of the kits: the second one is p0 then."""
    scene = sample_scene()
    root, record = own_folder(tmp_path), true_record(scene, source, PERSON)
    kept = replace(record, bodies=tuple(body for body in record.bodies if body.name != "bracket"))
    write_truth(root, {SCENE: kept})
    recorded = next(iter(Dataset(root).split("test-all", truth=True)))
    assert [row["part_id"] for row in recorded.truth.parts] == ["tee"]
    assert np.array_equal(recorded.labels == 2, scene.image.labels == 3)
    assert {query.part for query in recorded.queries} == {0}


def test_the_licence_of_the_images_stays(source: dict[str, str], tmp_path: Path) -> None:
    root = own_folder(tmp_path)
    summary = read_json(root / "dataset.json")
    del summary["config"]["clearance"]
    write_json(root / "dataset.json", summary | {"licence": "the user's own"})
    write_truth(root, {SCENE: true_record(sample_scene(), source, PERSON)})
    for name in ("test/0000.mcap", "test/0000.truth.mcap"):
        data = (root / name).read_bytes()
        assert b"the user's own" in data
        assert b"CC-BY" not in data
    assert Dataset(root).summary["config"]["clearance"] == CLEARANCE


def test_scenes_without_confirmed_labels_are_named(source: dict[str, str], tmp_path: Path) -> None:
    image = sample_scene().image
    root = write_forgotten(tmp_path, {SCENE: image, OTHER: image}, CLEARANCE)
    record = true_record(sample_scene(), source, PERSON)
    assert write_truth(root, {SCENE: record}) == [OTHER]
    with pytest.raises(InputError, match=OTHER):
        _ = Dataset(root).split("test", truth=True).scene(OTHER).truth
    assert write_truth(root, {OTHER: replace(record, scene_id=OTHER)}) == []
    assert len(list(Dataset(root).split("test", truth=True))) == 2


def test_several_scenes_of_the_same_shapes_are_confirmed_at_once(source: dict[str, str], tmp_path: Path) -> None:
    root = write_forgotten(tmp_path, dict.fromkeys((SCENE, OTHER), sample_scene().image), CLEARANCE)
    record = true_record(sample_scene(), source, PERSON)
    assert write_truth(root, {SCENE: record, OTHER: replace(record, scene_id=OTHER)}) == []
    assert len(list(Dataset(root).split("test", truth=True))) == 2
    assert verify(root).faults == ()


def test_nothing_is_written_of_labels_that_nobody_confirmed(source: dict[str, str], tmp_path: Path) -> None:
    root, record = own_folder(tmp_path), true_record(sample_scene(), source)
    before = {path: path.read_bytes() for path in root.rglob("*") if path.is_file()}
    with pytest.raises(InputError, match=rf"{SCENE}: kits, bracket, tee not confirmed"):
        write_truth(root, {SCENE: record})
    with pytest.raises(InputError, match="test-s0007"):
        write_truth(root, {"test-s0007": replace(record, scene_id="test-s0007")})
    assert before == {path: path.read_bytes() for path in root.rglob("*") if path.is_file() and path.name != ".lock"}


def test_two_shapes_of_one_name_are_refused(source: dict[str, str], tmp_path: Path) -> None:
    root, record = own_folder(tmp_path / "mine"), true_record(sample_scene(), source, PERSON)
    write_truth(root, {SCENE: record})
    other = shapes_folder(tmp_path / "other")
    glb = tmp_path / "other/parts/bracket.glb"
    glb.write_bytes((tmp_path / "other/parts/tee.glb").read_bytes())
    with pytest.raises(InputError, match="another shape is named 'bracket'"):
        write_truth(root, {SCENE: true_record(sample_scene(), other, PERSON)})


def test_the_table_stays_at_zero_whatever_the_depth_scale(source: dict[str, str], tmp_path: Path) -> None:
    """A camera that reads 0.3 % too far is put 0.3 % nearer; bodies are true to size where they stand."""
    scene = sample_scene(noise=0.0, scale=1.003)
    root = write_forgotten(tmp_path, {SCENE: scene.image}, CLEARANCE)
    camera = true_camera(scene.image.view, 1.003)
    assert np.allclose(camera.xyz * 1.003, scene.image.view.world_from_camera.xyz)
    record = true_record(scene, source, PERSON)
    measured = replace(  # the image's own pose is that of the table as measured, 0.3 % farther
        scene.image.view, world_from_camera=Pose(camera.wxyz, scene.image.view.world_from_camera.xyz * 1.003)
    )
    root = write_forgotten(tmp_path / "far", {SCENE: LabelledDepth(measured, scene.image.labels)}, CLEARANCE)
    write_truth(root, {SCENE: replace(record, scale=1.003)})
    assembly = next(iter(Dataset(root).split("test", truth=True))).scene.bodies[0]
    assert assembly.world_from_body.xyz[2] == pytest.approx(0, abs=1e-6)
