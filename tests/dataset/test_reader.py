"""The reader: recorded scenes come back, files with truth stay closed unless asked for, and renderings agree."""

from __future__ import annotations

import pickle
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest

from kit1000.camera import Camera, look_at
from kit1000.dataset.json_rows import FORMAT, assembly_row, kit_row, part_row, pose_row
from kit1000.dataset.mcap_io import ObservationWriter, TruthWriter
from kit1000.dataset.mesh_files import glb_bytes
from kit1000.dataset.reader import Dataset, RecordedScene, Split
from kit1000.dataset.scene_data import Observation, SceneTruth
from kit1000.dataset.scene_queries import PartInScene, scene_queries
from kit1000.errors import InputError
from kit1000.files import write_bytes, write_json
from kit1000.kits.assembly import AssemblyPlan, SidePlate, build_assembly
from kit1000.pose import Pose
from kit1000.queries.tracks import ALL_TRACKS, TRACKS
from kit1000.sim.cameras import CAMERA as PRIMARY
from kit1000.sim.cameras import camera_set
from kit1000.sim.layout import TUMBLED, UPRIGHT
from kit1000.sim.sensors import DEPTH_GRID, SENSORS
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, Assembly, View
from tests.samples.kits import QUICK, sample_kit, sample_part
from tests.samples.mini import MINI

CAMERA = Camera(64, 48, 55.0, 55.0, 31.5, 23.5)
SEES = look_at((0.6, -0.1, 0.6), (0, 0, 0))
SHARDS = {
    "test/0000.mcap": ["test-s0007", "test-s0039"],
    "test/0001.mcap": ["test-s0040"],
    "train/0000.mcap": ["train-s0000", "train-s0001"],
    "val/0000.mcap": ["val-s0000"],
}
SHUT = ("plan.json", "parts.json", "kits.json", "assemblies.json", ".truth.mcap", ".glb")
FAMILIES = QUICK[:3]
MODES = (UPRIGHT, TUMBLED, UPRIGHT)


def assembly_of(scene_id: str) -> Assembly:
    """The same kits for every scene, under the id of its assembly."""
    plan = AssemblyPlan(0.1, 0.3, (SidePlate(0, 0.4), SidePlate(1, 0.3)))
    return build_assembly(scene_id.replace("-s", "-"), [sample_kit(family) for family in FAMILIES], plan)


def write_dataset(root: Path) -> Path:
    """A dataset of a few small scenes."""
    assembly = assembly_of("any-s0")
    for name, scene_ids in SHARDS.items():
        shard = root / name.removesuffix(".mcap")
        with (
            ObservationWriter(root / name) as seen,
            TruthWriter(shard.with_suffix(".truth.mcap")) as true,
            ObservationWriter(shard.with_suffix(".three.mcap")) as further,
        ):
            for scene_id in scene_ids:
                observation, truth = scene(scene_id, assembly)
                seen.add(observation)
                true.add(truth)
                further.add(Observation(scene_id, {"three/1/ideal": view(31)}))
    for scene_id in (i for ids in SHARDS.values() for i in ids):
        write_bytes(root / f"assemblies/{scene_id.replace('-s', '-')}.glb", glb_bytes({"any": assembly.mesh}))
    for family in FAMILIES:
        write_bytes(root / f"parts/{family}.glb", glb_bytes({family: sample_part(family).mesh}))
        write_bytes(root / f"kits/{family}.glb", glb_bytes({family: sample_kit(family).mesh}))
    ids = [i.replace("-s", "-") for ids in SHARDS.values() for i in ids]
    write_json(root / "parts.json", {family: part_row(sample_part(family)) for family in FAMILIES})
    write_json(root / "kits.json", {family: kit_row(sample_kit(family)) for family in FAMILIES})
    write_json(root / "assemblies.json", {i: assembly_row(assembly) for i in ids})
    write_json(root / "plan.json", {})
    config = {"curve_scenes": 40}  # up to test-s0039
    write_json(root / "dataset.json", {"format": FORMAT, "dataset_id": "abc123", "config": config, "shards": SHARDS})
    return root


def view(seed: int) -> View:
    """A depth image whose values are multiples of GRID."""
    steps = np.random.default_rng(seed).integers(5000, 8000, (CAMERA.height, CAMERA.width))
    return View(CAMERA, SEES, steps / 2**13)


def views_of(scene_id: str) -> dict[str, View]:
    return {"ideal": view(len(scene_id) + int(scene_id[-4:])), "d415": view(1000 + int(scene_id[-4:]))}


def labels_of() -> np.ndarray:
    labels = np.zeros((CAMERA.height, CAMERA.width), np.uint8)
    labels[:10] = ASSEMBLY_LABEL
    for i in range(len(FAMILIES)):
        labels[20 + 3 * i : 32, 20 * i : 20 * i + 12] = FIRST_PART_LABEL + i
    return labels


def parts_in_scene(assembly: Assembly) -> list[PartInScene]:
    """Parts in a row, in the order of the mounts."""
    lying = [
        Pose(sample_kit(f).slot.kit_from_part.wxyz, np.array([0.1 * i, -0.17, 0.02])) for i, f in enumerate(FAMILIES)
    ]
    return [
        PartInScene(i, MODES[i], lying[i], STANDS @ mount.assembly_from_kit, mount.kit.slot, None)
        for i, mount in enumerate(assembly.mounts)
    ]


STANDS = Pose.from_rotvec((0, 0, 0.2), (0, 0.2, 0))


def scene(scene_id: str, assembly: Assembly) -> tuple[Observation, SceneTruth]:
    """The observation and the truth of a scene."""
    views, labels, parts = views_of(scene_id), labels_of(), parts_in_scene(assembly)
    tracks = ALL_TRACKS if scene_id in CURVED else tuple(TRACKS)
    rows, truths = scene_queries(scene_id, 1, tracks, views, labels, parts, 1)
    told = tuple(
        {
            "part_id": FAMILIES[part.index],
            "family": FAMILIES[part.index],
            "mount": part.index,
            "rest_mode": part.rest_mode,
            "world_from_part": pose_row(part.world_from_part),
            "world_from_kit": pose_row(part.world_from_kit),
            "pixels": 1000,
            "visible": 0.9 - 0.1 * part.index,
            "slot_angle": 0.2,
            "slot_visible": 0.5,
            "unseen": None,
        }
        for part in parts
    )
    seg = np.zeros(labels.shape, np.uint16)
    return Observation(scene_id, views, labels, tuple(rows)), SceneTruth(
        scene_id, scene_id.replace("-s", "-"), STANDS, told, truths, seg
    )


CURVED = ("test-s0007", "test-s0039")


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("dataset"))


_opened: list[str] = []
_listening = False


def _listen(event: str, arguments: tuple) -> None:
    if _listening and event in ("open", "os.open"):
        _opened.append(str(arguments[0]))


sys.addaudithook(_listen)  # it stays for good, so it is told when to listen


@contextmanager
def files_opened() -> Iterator[list[str]]:
    """The names of all files that Python opens in the block."""
    global _listening
    _opened.clear()
    _listening = True
    try:
        yield _opened
    finally:
        _listening = False


def read_all(dataset: Dataset, name: str, truth: bool = False) -> int:
    """Read everything that needs no truth; returns the number of queries."""
    count = 0
    for recorded in dataset.split(name, truth=truth):
        assert recorded.view("d415").depth.shape == recorded.view("three/1/ideal").depth.shape == recorded.labels.shape
        for query in recorded.queries:
            count += bool(query.part_mask.any() and query.kit_region.any() and query.view.depth.any())
    return count


@pytest.mark.parametrize("name", ["train", "val", "test", "test-all", "curves"])
@pytest.mark.parametrize("truth", [False, True])
def test_reading_observations_opens_no_truth(root: Path, name: str, truth: bool) -> None:
    with files_opened() as opened:
        assert read_all(Dataset(root), name, truth) > 0
    assert any(path.endswith(".mcap") for path in opened)
    assert not [path for path in opened if path.endswith(SHUT)]


def test_the_truth_must_be_requested(root: Path) -> None:
    recorded = Dataset(root).split("train").scene("train-s0000")
    with files_opened() as opened:
        for read in (
            lambda: recorded.truth,
            lambda: recorded.scene,
            lambda: recorded.truths,
            lambda: recorded.truth_of("train-s0000-p0-snap"),
            lambda: recorded.bodies(),
            lambda: recorded.render("top"),
        ):
            with pytest.raises(InputError, match=r"truth was not opened; use dataset.split\('train', truth=True\)"):
                read()
    assert not opened


def test_a_relative_path_stays_that_of_the_folder_where_it_was_opened(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(root.parent)
    dataset = Dataset(root.name)
    monkeypatch.chdir(tmp_path)
    assert dataset.geometry.parts
    assert list(pickle.loads(pickle.dumps(dataset)).split("test").queries())


def test_splits_have_their_scenes_in_order(root: Path) -> None:
    dataset = Dataset(root)
    assert dataset.split("train").scene_ids == ["train-s0000", "train-s0001"]
    assert dataset.split("test").scene_ids == dataset.split("test-all").scene_ids
    assert dataset.split("test").scene_ids == ["test-s0007", "test-s0039", "test-s0040"]
    assert dataset.split("curves").scene_ids == list(CURVED)
    assert [recorded.id for recorded in dataset.split("test")] == dataset.split("test").scene_ids
    assert len(dataset.split("val")) == 1
    assert dataset.id == "abc123"


def test_splits_have_their_queries(root: Path) -> None:
    dataset = Dataset(root)
    asked = {name: list(dataset.split(name).queries()) for name in ("train", "test", "test-all", "curves")}
    assert len(asked["curves"]) == 48 * len(CURVED)
    assert {query.track for query in asked["curves"]} == {"curves"}
    for name in ("train", "test-all"):
        assert {query.track for query in asked[name]} == {
            n for n, track in TRACKS.items() if track.sensor != "photoneo"
        }
        assert {query.part for query in asked[name]} == {0, 1, 2}
    drawn = [query.id for query in asked["test-all"] if query.drawn]
    assert [query.id for query in asked["test"]] == drawn
    for track in ("snap", "snap-tilt", "place", "snap-d415", "place-d415"):
        assert len([query for query in asked["test"] if query.track == track]) == 3  # one a scene


def test_queries_equal_those_written(root: Path) -> None:
    for scene_id in ("test-s0007", "val-s0000"):
        observation, _ = scene(scene_id, assembly_of(scene_id))
        recorded = Dataset(root).split("test-all" if "test" in scene_id else "val").scene(scene_id)
        rows = [row for row in observation.queries if row["track"] != "curves"]
        for row, query in zip(rows, recorded.queries, strict=True):
            told = (query.id, query.track, query.sensor, query.part, query.drawn, query.pivot.tolist())
            assert told == tuple(row[key] for key in ("id", "track", "sensor", "part", "drawn", "pivot"))
            assert (None if query.guess is None else pose_row(query.guess)) == row["guess"]
            assert query.scene_id == scene_id


def test_images_come_back_to_the_bit(root: Path) -> None:
    recorded = Dataset(root).split("test").scene("test-s0039")
    for sensor, wanted in views_of("test-s0039").items():
        found = recorded.view(sensor)
        assert np.array_equal(found.depth, wanted.depth)
        assert found.camera == CAMERA
        assert np.array_equal(found.world_from_camera.wxyz, SEES.wxyz)
    assert np.array_equal(recorded.labels, labels_of())
    assert np.array_equal(recorded.view("three/1/ideal").depth, view(31).depth)


def test_the_queries_of_a_scene_share_their_images(root: Path) -> None:
    first, second = list(Dataset(root).split("test-all").scene("test-s0007").queries)[:2]
    assert first.view is second.view


def test_truths_equal_those_written(root: Path) -> None:
    dataset = Dataset(root)
    recorded = dataset.split("curves", truth=True).scene("test-s0007")
    _, truth = scene("test-s0007", assembly_of("test-s0007"))
    assert recorded.truths.keys() == {query.id for query in recorded.queries}
    assert recorded.truth.queries == truth.queries
    for query_id, found in dataset.split("test-all", truth=True).scene("test-s0007").truths.items():
        part = truth.parts[truth.queries[query_id]["part"]]
        kit = sample_kit(part["part_id"])
        assert (found.query_id, found.assembly_id, found.kits) == (query_id, "test-0007", 3)
        told = (found.part_id, found.family, found.rest_mode, found.visible)
        assert told == tuple(part[key] for key in ("part_id", "family", "rest_mode", "visible"))
        assert np.array_equal(found.anchor, found.world_from_part.xyz)
        assert pose_row(found.world_from_part) == part["world_from_part"]
        assert pose_row(found.world_from_kit) == part["world_from_kit"]
        assert pose_row(found.goal_drawn) == truth.queries[query_id]["goal_drawn"]
        assert kit_row(kit)["goals"] == [pose_row(goal) for goal in found.slot.goals]
        assert found.slot.part_id == part["part_id"]


def test_missing_scenes_splits_and_tracks_are_named(root: Path) -> None:
    dataset = Dataset(root)
    with pytest.raises(InputError, match=r"no split 'tets'.*did you mean test\?.*train, val, test, test-all, curves"):
        dataset.split("tets")
    with pytest.raises(InputError, match=r"no scene 'test-s0009' among.* 3 .*split test.*did you mean test-s00"):
        dataset.split("test").scene("test-s0009")
    with pytest.raises(InputError, match="no track 'snapp' in split test; there are snap, snap-tilt"):
        dataset.split("test").queries("snapp")
    with pytest.raises(InputError, match="no track 'snap' in split curves; there are curves"):
        dataset.split("curves").queries("snap")
    with pytest.raises(InputError, match=r"no file test/0000.top.mcap"):
        dataset.split("test").scene("test-s0007").view("top/ideal")
    with pytest.raises(InputError, match="no view 'photoneo'; it has ideal, d415"):
        dataset.split("test").scene("test-s0007").view("photoneo")
    with pytest.raises(InputError, match="no dataset"):
        Dataset(root / "test")


def test_a_dataset_without_scenes_is_refused(tmp_path: Path) -> None:
    write_json(tmp_path / "dataset.json", {"format": FORMAT})
    with pytest.raises(InputError, match="split train has no scenes"):
        len(Dataset(tmp_path).split("train"))


def test_datasets_splits_scenes_and_queries_can_be_pickled(root: Path) -> None:
    split = Dataset(root).split("test", truth=True)
    recorded = split.scene("test-s0007")
    query = recorded.queries[0]
    pixels, assembly_id = query.part_mask.sum(), recorded.truth.assembly_id  # files are open now
    assert pickle.loads(pickle.dumps(query)).part_mask.sum() == pixels
    assert pickle.loads(pickle.dumps(recorded)).truth.assembly_id == assembly_id
    assert pickle.loads(pickle.dumps(split)).scene_ids == split.scene_ids
    unread = split.scene("test-s0007").queries[0]
    assert len(pickle.dumps(unread)) < 4000  # neither images nor files
    assert np.array_equal(pickle.loads(pickle.dumps(unread)).view.depth, query.view.depth)


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")  # that it is unwise; loaders of others do it
def test_forks_and_threads_read_the_same_from_files_opened_before(root: Path) -> None:
    _shared.append(Dataset(root).split("test-all"))
    ids = _shared[-1].scene_ids * 4
    expected = [_sum(scene_id) for scene_id in ids]
    with get_context("fork").Pool(2) as pool:
        assert pool.map(_sum, ids) == expected
    with ThreadPoolExecutor(4) as threads:
        assert list(threads.map(_sum, ids)) == expected


_shared: list[Split] = []


def _sum(scene_id: str) -> int:
    recorded = _shared[-1].scene(scene_id)
    return sum(int((query.view.depth * query.part_mask).sum() * 2**13) for query in recorded.queries)


@pytest.fixture(scope="module")
def recorded(mini: Path) -> RecordedScene:
    return Dataset(mini).recorded_scene("test-s0000")


def assert_same(found: View, wanted: View) -> None:
    """Whether two views are equal to the bit, poses included."""
    assert found.camera == wanted.camera
    assert np.array_equal(found.depth, wanted.depth)
    assert np.array_equal(found.world_from_camera.wxyz, wanted.world_from_camera.wxyz)
    assert np.array_equal(found.world_from_camera.xyz, wanted.world_from_camera.xyz)


def test_a_scene_of_any_split_is_found_by_its_id(mini: Path) -> None:
    dataset = Dataset(mini)
    for scene_id in ("train-s0000", "train-s0001", "val-s0000", "test-s0000"):
        found = dataset.recorded_scene(scene_id)
        split = dataset.split("test-all" if scene_id.startswith("test") else scene_id.partition("-")[0])
        assert [query.id for query in found.queries] == [query.id for query in split.scene(scene_id).queries]
        assert found.truths.keys() == {query.id for query in found.queries}


def test_an_unknown_scene_is_answered_with_the_closest_one(mini: Path) -> None:
    with pytest.raises(InputError, match=r"no scene 'tets-s0000' among 4; did you mean test-s0000\?$"):
        Dataset(mini).recorded_scene("tets-s0000")
    with pytest.raises(InputError, match=r"no scene 'nothing' among 4$"):
        Dataset(mini).recorded_scene("nothing")


@pytest.mark.parametrize("scene_id", ["train-s0001", "val-s0000", "test-s0000"])
def test_rendering_the_primary_camera_gives_the_recorded_image(mini: Path, scene_id: str) -> None:
    again = Dataset(mini).recorded_scene(scene_id)
    views = again.render("primary")
    assert list(views) == ["primary"]
    assert_same(views["primary"], again.view("ideal"))


def test_rendering_the_three_cameras_gives_the_recorded_images(recorded: RecordedScene) -> None:
    views = recorded.render("three")
    assert list(views) == ["three/0", "three/1", "three/2"]
    for key, view in views.items():
        assert_same(view, recorded.view(f"{key}/ideal"))


def test_the_seed_of_the_dataset_gives_the_recorded_noise(recorded: RecordedScene) -> None:
    assert_same(recorded.render("three", "d415", MINI.seed)["three/2"], recorded.view("three/2/d415"))


def test_the_top_camera_sees_both_halves_of_the_table(recorded: RecordedScene) -> None:
    (key, view), *others = recorded.render("top").items()
    assert (key, others) == ("top", [])
    assert_same(view, View(PRIMARY, camera_set("top")["top"][1], view.depth))
    points = view.world_from_camera.apply(PRIMARY.unproject(view.depth))
    raised = points[(points[..., 2] > 0.008) & (view.depth > 0)]
    for row, body in zip(recorded.truth.parts, recorded.scene.bodies[1:], strict=True):
        assert body.id == row["part_id"]
        near = np.linalg.norm(raised[:, :2] - body.world_from_body.xyz[:2], axis=1) < 0.02
        assert near.sum() > 100
        assert body.world_from_body.xyz[1] < 0
    standing = raised[raised[:, 1] > 0]
    assert len(standing) > 10_000
    assert standing[:, 1].min() > 0.02
    grid = view.depth.astype(np.float64) / DEPTH_GRID
    assert np.array_equal(grid, np.rint(grid))


def test_invalid_camera_sets_and_sensors_are_refused(recorded: RecordedScene) -> None:
    with pytest.raises(InputError, match="camera set 'tpo': expected one of primary, three, top"):
        recorded.render("tpo")
    with pytest.raises(InputError, match=f"no 'd435', expected one of {', '.join(SENSORS)}"):
        recorded.render("top", "d435")


def test_the_truth_of_one_query_is_that_of_all_and_reads_no_mesh(
    recorded: RecordedScene, mini: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr("kit1000.dataset.geometry.read_glb")
    again = Dataset(mini).recorded_scene("test-s0000")
    assert list(again.truths) == [query.id for query in recorded.queries]
    for query_id, truth in again.truths.items():
        one = Dataset(mini).recorded_scene("test-s0000").truth_of(query_id)
        assert (one.query_id, one.part_id, one.visible) == (truth.query_id, truth.part_id, truth.visible)
        assert pose_row(one.goal_drawn) == pose_row(truth.goal_drawn)
        assert np.array_equal(one.anchor, truth.anchor)


def test_the_truth_of_other_queries_is_refused(recorded: RecordedScene) -> None:
    with pytest.raises(InputError, match=r"'test-s0000-p9-snap' in test-s0000 of .*did you mean test-s0000"):
        recorded.truth_of("test-s0000-p9-snap")
