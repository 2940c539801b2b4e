"""Folders of labelled scenes joined: unique ids, licences and names kept, whole again, and refusals in one line."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark.__main__ import main as benchmark
from kit1000.cli import main
from kit1000.dataset.mcap_io import ObservationFile
from kit1000.dataset.own_scenes import scenes_from_elsewhere, seen_table
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.files import json_bytes, read_json, with_checksum
from kit1000.generation.verify import verify
from kit1000.labelling.joined_folders import join_folders
from kit1000.labelling.label_records import read_record, write_record
from kit1000.labelling.labelled_folder import write_truth
from kit1000.metrics import seatings
from kit1000.perception.sensor_facts import SensorFacts, sensor_of
from kit1000.pose import Pose
from kit1000.submission import write_submission
from kit1000.values import Prediction
from tests.samples.forgotten_truth import write_forgotten
from tests.samples.labelled_scenes import CLEARANCE, SCENE, sample_scene, shapes_folder, true_record
from tests.samples.submissions import manifest

OTHER = "test-s0001"
PEOPLE = ("Ada", "Grace")
LICENCES = ("CC-BY-4.0", "CC0-1.0")


def stated(root: Path, change: Callable[[dict[str, Any]], None]) -> Path:
    """A folder whose dataset.json states something else, with a checksum of that."""
    summary = read_json(root / "dataset.json")
    change(summary)
    (root / "dataset.json").write_bytes(json_bytes(with_checksum(summary)))
    return root


def labelled(folder: Path, source: dict[str, str], place: int, scene_ids: tuple[str, ...] = (SCENE,)) -> Path:
    """A folder of one person's labelled scenes, by a camera of its own."""
    root = write_forgotten(folder, dict.fromkeys(scene_ids, sample_scene().image), CLEARANCE)
    facts = SensorFacts(device=f"camera {place}", noise_px=0.1 + place)

    def own(summary: dict[str, Any]) -> None:
        summary["dataset_id"], summary["licence"] = f"{place:016d}", LICENCES[place]
        summary["sensors"] = {"d415": facts.as_row()}
        summary["own"] = {"sources": [f"{place}-{scene_id}.png" for scene_id in scene_ids]}
        if len(scene_ids) > 1:
            summary["places"] = [list(scene_ids)]
        summary["tables"] = {scene_id: [[0, 0], [1 + place, 0], [0, 1]] for scene_id in scene_ids}

    stated(root, own)
    records = {i: replace(true_record(sample_scene(), source, PEOPLE[place]), scene_id=i) for i in scene_ids}
    write_truth(root, records)
    for scene_id, record in records.items():
        write_record(root, record)
        (root / "labels" / f"{scene_id}.png").write_bytes(scene_id.encode())
    return root


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    return shapes_folder(tmp_path_factory.mktemp("shapes"))


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory, source: dict[str, str]) -> tuple[Path, Path]:
    place = tmp_path_factory.mktemp("contributed")
    return labelled(place / "ada", source, 0, (SCENE, OTHER)), labelled(place / "grace", source, 1)


@pytest.fixture(scope="module")
def real(tmp_path_factory: pytest.TempPathFactory, folders: tuple[Path, Path]) -> Path:
    out = tmp_path_factory.mktemp("joined") / "real"
    assert main(["join", *map(str, folders), "--out", str(out)]) == 0
    return out


def test_scenes_get_ids_of_their_own_and_keep_their_contents(real: Path, folders: tuple[Path, Path]) -> None:
    dataset = Dataset(real)
    scenes = list(dataset.split("test-all", truth=True))
    assert [scene.id for scene in scenes] == ["test-s0000", "test-s0001", "test-s0002"]
    before = Dataset(folders[1]).split("test-all", truth=True).scene(SCENE)
    after = scenes[2]
    assert np.array_equal(after.view("d415").depth, before.view("d415").depth)
    assert np.array_equal(after.labels, before.labels)
    assert [query.id for query in after.queries] == [query.id.replace(SCENE, after.id) for query in before.queries]
    for query, old in zip(after.queries, before.queries, strict=True):
        assert np.allclose(after.truth_of(query.id).goal_drawn.matrix(), before.truth_of(old.id).goal_drawn.matrix())
    truths = list(after.truths.values())
    assert seatings(Pose.stack([truth.goal_drawn for truth in truths]), truths, dataset.geometry).seated.all()


def test_licence_contributor_and_sensor_of_every_scene_are_kept(real: Path) -> None:
    summary = Dataset(real).summary
    joined = summary["own"]["joined"]
    assert [joined[f"test-s000{i}"]["confirmed_by"] for i in range(3)] == [["Ada"], ["Ada"], ["Grace"]]
    assert [joined[f"test-s000{i}"]["licence"] for i in range(3)] == [LICENCES[0], LICENCES[0], LICENCES[1]]
    assert joined["test-s0002"]["scene_id"] == SCENE
    assert summary["own"]["sources"] == [f"0-{SCENE}.png", f"0-{OTHER}.png", f"1-{SCENE}.png"]
    for shard, licence in (("0000", LICENCES[0]), ("0001", LICENCES[1])):
        assert ObservationFile(real / f"test/{shard}.mcap").record["licence"] == licence
        assert licence.encode() in (real / f"test/{shard}.truth.mcap").read_bytes()
    devices = [sensor_of(summary, "d415", f"test-s000{i}") for i in range(3)]
    assert [facts.device for facts in devices if isinstance(facts, SensorFacts)] == ["camera 0", "camera 0", "camera 1"]
    outline = seen_table(summary, "test-s0002")
    assert outline is not None
    assert outline[1, 0] == 2
    assert read_record(real, "test-s0002").bodies[0].confirmed_by == "Grace"
    assert (real / "labels/test-s0001.png").read_bytes() == OTHER.encode()


def test_images_of_one_scene_stay_together(real: Path, folders: tuple[Path, Path]) -> None:
    assert Dataset(folders[0]).summary["places"] == [[SCENE, OTHER]]
    assert Dataset(real).summary["places"] == [["test-s0000", "test-s0001"]]
    assert scenes_from_elsewhere(Dataset(real).summary, "test-s0001") == ("test-s0000",)
    assert scenes_from_elsewhere(Dataset(real).summary, "test-s0002") == ()


def test_every_file_is_hashed(real: Path, tmp_path: Path) -> None:
    report = verify(real)
    assert report.faults == ()
    names = {path.relative_to(real).as_posix() for path in real.rglob("*") if path.is_file()}
    assert report.files == len(names - {"dataset.json", ".lock"})
    copy = shutil.copytree(real, tmp_path / "copy")
    (copy / "labels/test-s0001.png").write_bytes(b"")
    assert [fault.partition(":")[0] for fault in verify(copy).faults] == ["labels/test-s0001.png"]


def test_the_same_folders_give_the_same_bytes(real: Path, folders: tuple[Path, Path], tmp_path: Path) -> None:
    join_folders(folders, tmp_path / "again")
    assert (tmp_path / "again/dataset.json").read_bytes() == (real / "dataset.json").read_bytes()


def test_a_joined_folder_grows(real: Path, folders: tuple[Path, Path], tmp_path: Path) -> None:
    join_folders(folders[:1], tmp_path / "one")
    join_folders([tmp_path / "one", folders[1]], tmp_path / "both")
    one, both = (read_json(path / "dataset.json") for path in (real, tmp_path / "both"))
    assert one["own"] == both["own"]
    assert one["files"] == both["files"]
    assert one["places"] == both["places"]


def test_the_benchmark_scores_it(real: Path, tmp_path: Path) -> None:
    dataset = Dataset(real)
    queries = list(dataset.split("test", truth=True).queries("place-d415"))
    rows = [Prediction(query.id, dataset.truth_of(query).goal_drawn, 0.5, 1.0) for query in queries]
    checksum = dataset.summary["checksum"]
    described = manifest(dataset.id, dataset_checksum=checksum, tracks=("place-d415",), uses_true_geometry=False)
    write_submission(tmp_path / "true", described, rows)
    assert main(["check", str(tmp_path / "true"), "--data", str(real)]) == 0
    assert benchmark(["score", str(tmp_path / "true"), "--data", str(real)]) == 0
    scores = read_json(tmp_path / "true/scores.json")
    assert scores["tracks"]["place-d415"]["n"] == len(queries) == 3


def test_info_says_what_came_from_whom(real: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(real)]) == 0
    told = capsys.readouterr().out
    assert "3 scenes, labels" in told
    assert "camera 0: " in told
    assert "camera 1: " in told
    assert "test-s0002  CC0-1.0, confirmed by Grace" in told


def unlabelled(root: Path) -> None:
    (root / "test/0000.truth.mcap").unlink()


def waiting(root: Path) -> None:
    record = read_record(root, SCENE)
    write_record(root, replace(record, bodies=tuple(replace(body, confirmed_by=None) for body in record.bodies)))


def without_labels(root: Path) -> None:
    shutil.rmtree(root / "labels")


def damaged(root: Path) -> None:
    (root / "kits.json").write_text("{}")


def edited(root: Path) -> None:
    path = root / "dataset.json"
    path.write_bytes(path.read_bytes().replace(b"camera 1", b"camera 7"))


def other_version(root: Path) -> None:
    stated(root, lambda summary: summary.update(data_version="0.9.0"))


def other_tracks(root: Path) -> None:
    stated(root, lambda summary: summary["config"].update(tracks=["snap-d415"]))


def generated(root: Path) -> None:
    (root / "plan.json").write_text("{}")


def twice(root: Path) -> None:
    stated(root, lambda summary: summary.update(dataset_id=f"{0:016d}"))


def other_shape(root: Path) -> None:
    rows = read_json(root / "kits.json")
    rows["tee"]["clearance"] = 1e-3
    (root / "kits.json").write_bytes(json_bytes(rows))
    digest = sha256(json_bytes(rows)).hexdigest()
    stated(root, lambda summary: summary["files"].update({"kits.json": digest}))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (unlabelled, f"no ground truth of {SCENE}"),
        (waiting, f"{SCENE} was labelled again and is not confirmed"),
        (without_labels, f"no labels/{SCENE}.json"),
        (damaged, "kits.json: missing or changed"),
        (edited, "dataset.json: changed"),
        (other_version, "data_version 0.9.0, .* has 1.0.0"),
        (other_tracks, "tracks"),
        (generated, "a generated dataset"),
        (twice, f"its scene {SCENE} is already in"),
        (other_shape, r"its kits/tee\.glb differs"),
    ],
)
def test_a_folder_that_does_not_belong_is_refused_in_one_line(
    folders: tuple[Path, Path], tmp_path: Path, spoil: Callable[[Path], None], message: str
) -> None:
    other = shutil.copytree(folders[1], tmp_path / "other")
    spoil(other)
    with pytest.raises(InputError, match=message) as refusal:
        join_folders([folders[0], other], tmp_path / "real")
    assert "\n" not in str(refusal.value)
    assert str(other) in str(refusal.value)
    assert not (tmp_path / "real").exists()


def test_wrong_usage_is_one_line(
    folders: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for words in (["join", str(tmp_path / "none")], ["join", str(folders[0]), "--out", str(folders[1])]):
        assert main(words) == 2
        assert capsys.readouterr().err.count("\n") == 1
