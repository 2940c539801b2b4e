"""The command: a folder that all commands take, or one line and nothing written."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from kit1000.camera import look_at
from kit1000.capture.importing import import_scenes
from kit1000.capture.options import ImportOptions
from kit1000.cli import main
from kit1000.dataset.mcap_io import ObservationFile
from kit1000.dataset.own_scenes import PLACES, scenes_from_elsewhere, seen_table
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.perception.sensor_facts import SensorFacts, sensor_of
from kit1000.pose import Pose
from kit1000.registration.rank import from_elsewhere
from kit1000.submission import Predictions, check, read_submission, write_submission
from kit1000.values import ASSEMBLY_LABEL, Prediction
from tests.samples.labelled_scenes import CLEARANCE, shapes_folder
from tests.samples.own_images import CAMERA, EYE, exact_depth, millimetres, noisy_depth
from tests.samples.submissions import manifest

DEPTH = millimetres(noisy_depth(exact_depth(), 0.05))
NUMBERS = tuple(str(value) for value in (CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy))


@pytest.fixture
def image(tmp_path: Path) -> Path:
    Image.fromarray(DEPTH).save(tmp_path / "depth.png")
    return tmp_path / "depth.png"


def pose_file(path: Path, pose: Pose = EYE) -> Path:
    path.write_text(json.dumps({"wxyz": pose.wxyz.tolist(), "xyz": pose.xyz.tolist()}), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two images of a camera, imported by the command."""
    place = tmp_path_factory.mktemp("own")
    for seed in range(2):
        Image.fromarray(millimetres(noisy_depth(exact_depth(), 0.05, seed))).save(place / f"{seed}.png")
    words = ["--intrinsics", *NUMBERS, "--masks", "depth", "--clearance-mm", "2.5", "--device", "D435"]
    assert main(["import", str(place / "0.png"), str(place / "1.png"), *words, "--out", str(place / "mine")]) == 0
    return place / "mine"


def test_the_folder_is_a_dataset_without_truth(folder: Path) -> None:
    dataset = Dataset(folder)
    split = dataset.split("test")
    assert split.scene_ids == ["test-s0000", "test-s0001"]
    for scene in split:
        assert scene.sensors == ["d415"]
        assert [query.id for query in scene.queries] == [
            f"{scene.id}-p{part}-{track}" for track in ("snap-d415", "place-d415") for part in range(2)
        ]
        assert (scene.labels == ASSEMBLY_LABEL).any()
    assert dataset.summary["config"]["clearance"] == 2.5e-3
    assert not list(folder.rglob("*.truth.mcap"))


def test_images_from_several_places_are_one_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    eyes = [EYE, look_at((0.35, -0.3, 0.7), (0.0, 0.0, 0.0))]
    sources, poses = [], []
    for number, eye in enumerate(eyes):
        sources.append(str(tmp_path / f"{number}.png"))
        Image.fromarray(millimetres(exact_depth(eye=eye))).save(sources[-1])
        poses.append(str(pose_file(tmp_path / f"{number}.json", eye)))
    words = ["--intrinsics", *NUMBERS, "--masks", "depth", "--out", str(tmp_path / "mine")]
    assert main(["import", *sources, "--one-scene", "--world-from-camera", *poses, *words]) == 0
    assert "2 images of one scene" in capsys.readouterr().out
    dataset = Dataset(tmp_path / "mine")
    assert dataset.summary[PLACES] == [["test-s0000", "test-s0001"]]
    for query in dataset.split("test").queries("place-d415"):
        (other,) = from_elsewhere(dataset, query)
        assert other.scene_id != query.scene_id
        np.testing.assert_allclose(other.pivot, query.pivot, atol=15e-3)
    assert main(["verify", str(tmp_path / "mine")]) == main(["info", str(tmp_path / "mine")]) == 0
    assert "images of one scene: test-s0000, test-s0001" in capsys.readouterr().out
    pose_file(Path(poses[1]), Pose(eyes[1].wxyz, eyes[1].xyz + (0.03, 0.0, 0.0)))  # bodies that lie apart are no scene
    words[-1] = str(tmp_path / "other")
    assert main(["import", *sources, "--one-scene", "--world-from-camera", *poses, *words]) == 2
    assert re.search("lie (29|30|31) mm apart", capsys.readouterr().err)
    assert not (tmp_path / "other").exists()


def test_scenes_are_alone_unless_they_are_said_to_be_one(folder: Path) -> None:
    dataset = Dataset(folder)
    assert PLACES not in dataset.summary
    assert not [other for query in dataset.split("test").queries() for other in from_elsewhere(dataset, query)]


@pytest.mark.parametrize("groups", [{"a": 1}, ["test-s0000"], 3])
def test_groups_of_another_kind_are_refused(groups: object) -> None:
    with pytest.raises(InputError, match="import again"):
        scenes_from_elsewhere({PLACES: groups}, "test-s0000")


def test_the_recording_is_stamped_as_the_user_s_own(folder: Path) -> None:
    record = ObservationFile(folder / "test/0000.mcap").record
    assert "CC-BY" not in record["licence"]
    assert ObservationFile(folder / "test/0000.mcap").recomputed_hash("test-s0000")


def test_facts_and_the_seen_table_are_stored(folder: Path) -> None:
    summary = Dataset(folder).summary
    facts = sensor_of(summary, "d415")
    assert isinstance(facts, SensorFacts)
    assert (facts.device, facts.baseline, facts.stream) == ("D435", 0.05, "aligned")
    outline = seen_table(summary, "test-s0001")
    assert outline is not None
    assert 0.05 < np.ptp(outline[:, 0]) < 1.0
    assert seen_table({}, "test-s0001") is None


def test_an_image_of_a_scanner_is_read_as_those_of_the_simulated_one(tmp_path: Path) -> None:
    np.save(tmp_path / "scan.npy", noisy_depth(exact_depth(), 0.05))
    words = ["--intrinsics", *NUMBERS, "--device", "PhoXi", "--masks", "depth", "--out", str(tmp_path / "mine")]
    assert main(["import", str(tmp_path / "scan.npy"), *words]) == 0
    dataset = Dataset(tmp_path / "mine")
    (scene,) = dataset.split("test")
    assert scene.sensors == ["photoneo"]
    assert {query.track for query in scene.queries} == {"snap-photoneo", "place-photoneo"}
    assert {query.sensor for query in scene.queries} == {"photoneo"}
    assert set(dataset.summary["config"]["tracks"]) == {"snap-photoneo", "place-photoneo"}
    facts = sensor_of(dataset.summary, "photoneo")
    assert isinstance(facts, SensorFacts)
    assert facts.scanner
    assert main(["info", str(tmp_path / "mine")]) == main(["verify", str(tmp_path / "mine")]) == 0


@pytest.mark.parametrize("words", [["info"], ["verify"], ["show", "--scene", "test-s0000", "--out", "{tmp}/a.png"]])
def test_commands_take_the_folder(folder: Path, tmp_path: Path, words: list[str]) -> None:
    options = [word.replace("{tmp}", str(tmp_path)) for word in words[1:]]
    assert main([words[0], str(folder), *options]) == 0


NEED_TRUTH = [
    ["run", "--predictions", "x"],
    ["study"],
    ["export", "--out", "x"],
    ["show"],
    ["export", "--format", "mcap", "--ids", "test-s0000", "--truth", "--out", "x"],
]


@pytest.mark.parametrize("words", NEED_TRUTH, ids=" ".join)
def test_commands_that_need_truth_say_so_in_one_line(
    folder: Path, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([words[0], str(folder), *words[1:]]) == 2
    message = capsys.readouterr().err
    assert "without ground truth" in message
    assert message.count("\n") == 1


def test_predictions_are_checked_against_the_folder(folder: Path, tmp_path: Path) -> None:
    dataset = Dataset(folder)
    rows = [Prediction(query.id, Pose.identity(), 0.5, 1.0) for query in dataset.split("test").queries("place-d415")]
    described = manifest(dataset.id, tracks=("place-d415",), uses_true_geometry=False)
    write_submission(tmp_path / "out", described, Predictions.of(rows))
    assert check(tmp_path / "out", folder).good
    assert len(read_submission(tmp_path / "out").predictions) == 4


def test_one_image_of_frames_is_one_scene(tmp_path: Path) -> None:
    frames = [millimetres(noisy_depth(exact_depth(), 0.2, seed)) for seed in range(4)]
    for seed, frame in enumerate(frames):
        np.save(tmp_path / f"{seed}.npy", frame)
    sources = ["--frames", "4", "--intrinsics", *NUMBERS, "--masks", "depth", "--out", str(tmp_path / "mine")]
    assert main(["import", *(str(tmp_path / f"{seed}.npy") for seed in range(4)), *sources]) == 0
    assert len(Dataset(tmp_path / "mine").split("test")) == 1
    assert main(["import", str(tmp_path / "0.npy"), *sources[:-1], str(tmp_path / "other")]) == 2


WRONG = {  # by what is typed: facts of the answer
    "{image}": "no intrinsics|--intrinsics",
    "{image} --intrinsics 1 2 3": "--intrinsics|four numbers",
    "{image} --intrinsics none.json": "none.json|no such file",
    "{image} --intrinsics {camera}": "camera.json|1280 x 720|640 x 480",
    "{tmp}/depht.png --intrinsics 1 2 3 4": "no such file|did you mean depth.png",
    "{tmp}/a.jpg --intrinsics 1 2 3 4": ".jpg is not read",
    "{tmp}/a.mcap.zstd": ".zstd is not read|zstd -d",
    "{tmp}/pointers/0.png --intrinsics 1 2 3 4": "0.png|run git lfs pull",
    "{tmp}/pointers/0.mcap": "0.mcap|run git lfs pull",
    "{tmp} --intrinsics 1 2 3 4": "a folder without an MCAP file",
    "{image} --out {tmp}": "is not empty",
    "{image} {good} --frames 2": "--frames 2|groups of 2",
    "{image} {good} --topic /depth": "--topic|an image|recordings",
    "{image} {good} --first 3": "--first|an image|recordings",
    "{image} {good} --depth-scale 0.01": "median depth|--depth-scale 0.001",
    "{image} {good} --kit 7": "--kit 7|3 bodies",
    "{image} {good} --stream colour": "--stream|raw|aligned",
    "{image} {good} --world-from-camera {pose} {pose}": "--world-from-camera|each of 1 images, got 2",
    "{image} {good} --one-scene": "--one-scene|got 1 and 0",
    "{image} {good} --one-scene --world-from-camera {pose}": "--one-scene|got 1 and 1",
    "{image} {image} {good} --one-scene --world-from-camera {pose}": "--one-scene|got 2 and 1",
    "{image} {good} --kit 0": "--kit 0|from 1 to",
    "{image} {good} --frames 0": "--frames",
    "{image} {good} --check 10 20": "--check|three sides",
    "{image} {good} --check 210 -158 60": "--check|1 to 2000",
    "{image} {good} --check 400 300 200": "--check 400 x 300 x 200|no body",
    "{image} {good} --clearance-mm nan": "--clearance-mm|0.05 to 100|nan",
    "{image} {good} --baseline-mm inf": "--baseline-mm|inf",
    "{image} {good} --depth-scale nan": "--depth-scale|nan",
    "{image} {good} --world-from-camera none.json": "none.json",
    "{image} {good} --out {image}/mine": "cannot write|depth.png",
}


@pytest.mark.parametrize("typed", WRONG)
def test_wrong_input_is_one_line_and_nothing_is_written(
    image: Path, typed: str, capsys: pytest.CaptureFixture[str]
) -> None:
    place = image.parent
    (place / "a.jpg").touch()
    (place / "a.mcap.zstd").touch()
    (place / "pointers").mkdir()
    for name in ("0.png", "0.mcap"):
        (place / "pointers" / name).write_bytes(b"version https://git-lfs.github.com/spec/v1\nsize 684\n")
    row = {"fx": 900, "fy": 900, "cx": 640, "cy": 360, "width": 1280, "height": 720}
    (place / "camera.json").write_text(json.dumps(row), encoding="utf-8")
    good = f"--intrinsics {' '.join(NUMBERS)} --masks depth"
    named = {"camera": place / "camera.json", "pose": pose_file(place / "pose.json")}
    before = sorted(place.rglob("*"))
    words = typed.format(image=image, tmp=place, good=good, **named).split()
    assert main(["import", *words]) == 2
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 1
    for fact in WRONG[typed].split("|"):
        assert fact in printed.err
    assert not printed.out
    assert sorted(place.rglob("*")) == before


HOSTILE = {
    "zeros": np.zeros((480, 640), np.uint16),
    "noise": np.random.default_rng(0).integers(400, 1500, (480, 640)).astype(np.uint16),
    "another size": np.full((720, 1280), 800, np.uint16),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_images_are_one_line_and_nothing_is_written(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    np.save(tmp_path / "depth.npy", HOSTILE[name])
    row = {"fx": 900, "fy": 905, "cx": 322.3, "cy": 238.1, "width": 640, "height": 480}
    (tmp_path / "camera.json").write_text(json.dumps(row), encoding="utf-8")
    before = sorted(tmp_path.rglob("*"))
    words = ["--intrinsics", str(tmp_path / "camera.json"), "--masks", "depth", "--out", str(tmp_path / "out")]
    assert main(["import", str(tmp_path / "depth.npy"), *words]) == 2
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 1
    assert "report this bug" not in printed.err
    assert sorted(tmp_path.rglob("*")) == before


def test_one_body_is_no_scene(tmp_path: Path) -> None:
    np.save(tmp_path / "depth.npy", exact_depth((((0.1, 0.1, 0.05), (0.0, 0.0)),)))
    with_kit = ImportOptions(sources=(tmp_path / "depth.npy",), out=tmp_path / "out", intrinsics=NUMBERS)
    with pytest.raises(InputError, match="one body"):
        import_scenes(with_kit)
    assert not (tmp_path / "out").exists()


def test_the_page_shows_the_table_that_was_seen(folder: Path, tmp_path: Path) -> None:
    viser = pytest.importorskip("viser")
    from kit1000.editor.serve import Options, editing

    added: dict[str, np.ndarray] = {}
    mesh = viser.SceneApi.add_mesh_simple

    def noted(scene: object, name: str, vertices: np.ndarray, *rest: object, **options: object) -> object:
        added[name] = vertices
        return mesh(scene, name, vertices, *rest, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(viser.SceneApi, "add_mesh_simple", noted)
        with editing(Options(folder, "test-s0001", tmp_path / "edits", "d415")) as (editor, address):
            assert editor.space.bodies == (0, 1)
            assert address.startswith("http://127.0.0.1:")
    outline = seen_table(Dataset(folder).summary, "test-s0001")
    assert outline is not None
    np.testing.assert_allclose(added["/table"][:, :2], outline, atol=1e-6)
    assert (added["/table"][:, 2] <= 0).all()


def test_an_image_is_imported_before_it_is_edited(
    image: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("viser")
    from kit1000.editor import serve

    asked: list[serve.Options] = []
    monkeypatch.setattr(serve, "run", asked.append)
    words = ["edit", str(image), "--intrinsics", *NUMBERS, "--masks", "depth"]
    assert main(words) == 0
    assert "body 1:" in capsys.readouterr().out
    options = asked.pop()
    assert (options.scene, options.sensor, options.shapes) == ("test-s0000", "d415", None)
    assert options.data == image.with_name("depth-scene")
    assert Dataset(options.data).split("test").scene_ids == ["test-s0000"]
    assert options.out.parent == image.parent  # not in the folder of the scene, whose files are listed
    frames = image.with_name("frames.npy")
    np.save(frames, np.stack([np.asarray(Image.open(image))] * 3))
    for source in (frames, frames, image):
        assert main(["edit", str(source), *words[2:]]) == 0  # goes on
    assert capsys.readouterr().out.count("imported before") == 2
    assert asked.pop() == options
    os.utime(image, (later := options.data.stat().st_mtime + 60, later))
    assert main(words) == 2  # another image: the folder is never written over
    assert "of an earlier" in capsys.readouterr().err


def test_known_shapes_and_a_scanner_may_be_stated(
    image: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("viser")
    from kit1000.editor import serve

    asked: list[serve.Options] = []
    monkeypatch.setattr(serve, "run", asked.append)
    shapes_folder(tmp_path / "shapes")
    words = ["edit", str(image), "--intrinsics", *NUMBERS, "--masks", "depth", "--shapes", str(tmp_path / "shapes")]
    assert main([*words, "--sensor", "ideal"]) == 2
    assert "--sensor ideal" in capsys.readouterr().err
    assert main([*words, "--sensor", "photoneo"]) == 0
    (options,) = asked
    assert (options.snap, options.sensor) == ("registration-known", "photoneo")
    assert options.shapes is not None
    assert set(options.shapes.goals) == set(options.shapes.parts) == {"bracket", "tee"}
    assert Dataset(options.data).summary["config"]["clearance"] == CLEARANCE


@pytest.mark.parametrize(("scale", "fact"), [(1e3, "in mm"), (1.0, "inverse")])
def test_the_page_compares_the_pose_in_a_base_with_the_table(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], scale: float, fact: str
) -> None:
    pytest.importorskip("viser")
    eye = next(iter(Dataset(folder).split("test"))).view("d415").world_from_camera
    wrong = Pose(eye.wxyz, scale * eye.xyz) if scale > 1 else eye.inverse()
    words = ["edit", str(folder), "--scene", "test-s0000", "--snap", "none", "--out", str(tmp_path / "out")]
    assert main([*words, "--base-from-camera", str(pose_file(tmp_path / "base.json", wrong))]) == 2
    assert fact in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_scene_is_named_where_there_are_several(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("viser")
    assert main(["edit", str(folder)]) == 2
    assert "2 scenes; choose one with --scene, such as test-s0000" in capsys.readouterr().err
    assert main(["edit", str(folder), "--scene", "test-s0000", "--kit", "2"]) == 2
    assert "--kit" in capsys.readouterr().err
