"""Recordings made for looking at a scene: their points, times and topics, what they reveal, and errors in colour."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from kit1000.cli import main
from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.errors import InputError
from kit1000.export.recording import error_colours, write_scene_recording
from kit1000.mesh import even_points, mesh_from_solid
from kit1000.pose import Pose
from kit1000.submission import Predictions, write_predictions
from tests.samples.mini import Published
from tests.samples.shapes import box as box_solid

SCENE = "test-s0000"
SEEN = {f"/{sensor}/{what}" for sensor in ("ideal", "d415", "photoneo") for what in ("camera", "colours", "points")}
OBSERVED = SEEN | {"/tf", "/pivots", "/guesses"}
NUMPY_TYPES = {1: "u1", 7: "<f4"}


@pytest.fixture(scope="module")
def scene(data: Dataset) -> RecordedScene:
    return data.recorded_scene(SCENE)


@pytest.fixture(scope="module")
def plain(data: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording without the truth."""
    return write_scene_recording(data, SCENE, tmp_path_factory.mktemp("plain") / "scene.mcap")


def answered(scene: RecordedScene, path: Path, offset: tuple[float, float, float]) -> Path:
    """Predictions of the drawn goals, moved by an offset [m], for the queries of the track snap."""
    queries = [query for query in scene.queries if query.track == "snap"]
    motions = [Pose.from_translation(np.array(offset)) @ scene.truths[query.id].goal_drawn for query in queries]
    n = len(queries)
    write_predictions(path, Predictions(tuple(q.id for q in queries), Pose.stack(motions), np.ones(n), np.ones(n)))
    return path


def messages(path: Path) -> dict[str, Any]:
    """The decoded messages by topic, of which each has one."""
    found: dict[str, Any] = {}
    with open(path, "rb") as file:
        for _, channel, _, value in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
            assert channel.topic not in found
            found[channel.topic] = value
    return found


def rows(cloud: Any) -> np.ndarray:
    """The points of a cloud as a structured array."""
    dtype = np.dtype([(field.name, NUMPY_TYPES[field.type]) for field in cloud.fields])  # packed without gaps
    assert [field.offset for field in cloud.fields] == [dtype.fields[name][1] for name in dtype.names]  # type: ignore[index]
    return np.frombuffer(cloud.data, dtype)


def stacked(cloud: Any, *names: str) -> np.ndarray:
    return np.stack([rows(cloud)[name] for name in names], axis=-1)


@pytest.mark.parametrize("sensor", ["ideal", "d415"])
def test_the_points_of_a_sensor_are_its_unprojected_depth(plain: Path, scene: RecordedScene, sensor: str) -> None:
    recorded, view = messages(plain), scene.view(sensor)
    K = np.reshape(recorded[f"/{sensor}/camera"].K, (3, 3))
    v, u = np.nonzero(view.depth)
    expected = (np.linalg.inv(K) @ np.stack([u, v, np.ones(len(u))]) * view.depth[v, u]).T
    cloud = recorded[f"/{sensor}/points"]
    assert np.allclose(stacked(cloud, "x", "y", "z"), expected, rtol=0, atol=1e-6)
    image = recorded[f"/{sensor}/colours"]
    colours = np.frombuffer(image.data, np.uint8).reshape(image.height, image.width, 3)
    assert np.array_equal(stacked(cloud, "red", "green", "blue"), colours[v, u])
    assert (rows(cloud)["alpha"] == 255).all()
    frames = {item.child_frame_id: item for item in recorded["/tf"].transforms}
    translation = frames[cloud.frame_id].translation
    assert [translation.x, translation.y, translation.z] == view.world_from_camera.xyz.tolist()
    assert cloud.frame_id == image.frame_id == recorded[f"/{sensor}/camera"].frame_id


def test_all_messages_have_the_time_of_the_scene(mini: Path, tmp_path: Path) -> None:
    with open(mini / "train/0000.mcap", "rb") as file:
        starts = [message.log_time for _, channel, message in make_reader(file).iter_messages(["/tf"])]
    path = write_scene_recording(Dataset(mini), "train-s0001", tmp_path / "scene.mcap", truth=True)
    with open(path, "rb") as file:
        times = {time for _, _, m in make_reader(file).iter_messages() for time in (m.log_time, m.publish_time)}
    (time,) = times
    assert time == starts[1] // 10**9 * 10**9
    for value in messages(path).values():
        stamps = [getattr(item, "timestamp", None) for item in (value, *getattr(value, "transforms", ()))]
        assert {stamp.seconds for stamp in stamps if stamp is not None} <= {time // 10**9}


def test_without_truth_only_observations_are_read(public: Path, plain: Path, tmp_path: Path) -> None:
    """The bytes are those from a folder with nothing but the observations and the summary of the public part."""
    bare = tmp_path / "bare"
    (bare / "test").mkdir(parents=True)
    shutil.copy(public / "dataset.json", bare)
    shutil.copy(public / "test/0000.mcap", bare / "test")
    path = write_scene_recording(Dataset(bare), SCENE, tmp_path / "scene.mcap")
    assert path.read_bytes() == plain.read_bytes()
    assert set(messages(path)) == OBSERVED


def test_no_topic_without_truth_names_a_part_or_gives_a_pose_of_one(plain: Path, scene: RecordedScene) -> None:
    with open(plain, "rb") as file:
        data = b"".join(message.data for _, _, message in make_reader(file).iter_messages())
    for body in scene.scene.bodies:
        assert body.id.encode() not in data
        for number in (*body.world_from_body.xyz, *body.world_from_body.wxyz):
            assert abs(number) in (0, 1) or np.float64(number).tobytes() not in data
    assert {item.child_frame_id for item in messages(plain)["/tf"].transforms} == {"camera", "d415", "photoneo"}


def test_guesses_take_the_visible_points_of_the_parts(plain: Path, scene: RecordedScene) -> None:
    cloud = stacked(messages(plain)["/guesses"], "x", "y", "z")
    query = next(query for query in scene.queries if query.track == "snap")
    assert query.guess is not None
    view = query.view
    points = view.world_from_camera.apply(view.camera.unproject(view.depth)[query.part_mask & (view.depth > 0)])
    assert np.allclose(cloud[: len(points)], query.guess.apply(points), rtol=0, atol=1e-6)
    cross = stacked(messages(plain)["/pivots"], "x", "y", "z")
    first = cross[: len(cross) // len([query for query in scene.queries if query.track == "snap"])]
    assert np.allclose((first.min(0) + first.max(0)) / 2, query.pivot, rtol=0, atol=1e-6)


def test_with_truth_there_are_models_goals_and_seated_parts(
    data: Dataset, scene: RecordedScene, tmp_path: Path
) -> None:
    recorded = messages(write_scene_recording(data, SCENE, tmp_path / "scene.mcap", truth=True))
    assert set(recorded) == OBSERVED | {"/models", "/goals", "/seated"}
    bodies = scene.scene.bodies
    assert [entity.id.partition("/")[2] for entity in recorded["/models"].entities] == [body.id for body in bodies]
    for entity, body in zip(recorded["/models"].entities, bodies, strict=True):
        position = entity.models[0].pose.position
        assert [position.x, position.y, position.z] == body.world_from_body.xyz.tolist()
    queries = [query for query in scene.queries if query.track == "snap"]
    truths = [scene.truths[query.id] for query in queries]
    goals = recorded["/goals"].poses
    assert len(goals) == sum(len(truth.slot.goals) for truth in truths)
    seated = stacked(recorded["/seated"], "x", "y", "z").reshape(len(truths), -1, 3)
    for truth, points in zip(truths, seated, strict=True):
        mesh = data.geometry.part(truth.part_id).mesh
        box = (truth.goal_drawn @ truth.world_from_part).apply(mesh.vertices)
        assert (points >= box.min(0) - 1e-6).all()
        assert (points <= box.max(0) + 1e-6).all()


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (1e-3, 0.0, 4e-3)])
def test_answers_are_coloured_by_their_error(
    data: Dataset, scene: RecordedScene, tmp_path: Path, offset: tuple[float, float, float]
) -> None:
    predictions = answered(scene, tmp_path / "predictions.csv", offset)
    recorded = messages(write_scene_recording(data, SCENE, tmp_path / "scene.mcap", True, predictions))
    cloud, length = recorded["/answers"], float(np.linalg.norm(offset))
    assert np.allclose(rows(cloud)["error_mm"], 1e3 * length, rtol=0, atol=1e-3)
    nearest = error_colours(np.array([length]))[0].astype(int)
    assert np.abs(stacked(cloud, "red", "green", "blue") - nearest).max() <= 1
    moved = stacked(cloud, "x", "y", "z") - stacked(recorded["/seated"], "x", "y", "z")
    assert np.allclose(moved, offset, rtol=0, atol=1e-5)
    texts = [entity.texts[0].text for entity in recorded["/errors"].entities]
    assert texts == [f"{1e3 * length:.1f} mm, 0.0°"] * len(texts)


def test_errors_go_from_green_over_yellow_to_red() -> None:
    green, yellow, red, worse = error_colours(np.array([0, 3e-3, 10e-3, 1.0])).astype(int)
    assert green[1] > green[0]
    assert yellow[2] < yellow[:2].min()
    assert red[0] > 2 * red[1]
    assert np.array_equal(red, worse)


def test_points_are_on_the_surface_and_evenly_spread() -> None:
    mesh = mesh_from_solid(box_solid(10, 20, 40)).scaled(1e-3)
    points = even_points(mesh.triangles, 9000)[0]
    sides = np.abs(np.abs(points - mesh.bounds.mean(0)) - mesh.extents / 2) < 1e-12
    assert sides.any(axis=1).all()
    areas = np.array([0.02 * 0.04, 0.01 * 0.04, 0.01 * 0.02])
    shares = sides.sum(axis=0) / len(points)
    assert np.allclose(shares, areas / areas.sum(), atol=0.01)
    top = points[sides[:, 2]]
    counts, *_ = np.histogram2d(top[:, 0], top[:, 1], bins=(4, 8))
    assert counts.std() / counts.mean() < 0.2


WRONG = {
    "": "--ids",
    "--ids tets-s0000": "no scene 'tets-s0000' among 4; did you mean test-s0000?",
    f"--ids {SCENE} --track snip": "no track 'snip'; did you mean snap?",
    f"--ids {SCENE} --predictions {{answers}}": "its errors are measured against the truth; add --truth",
    "--ids train-s0000 --truth --predictions {answers}": "no prediction for scene train-s0000 on track snap;",
    f"--ids {SCENE} --truth --track place --predictions {{answers}}": "track place; it has some on snap: add --track",
    f"--ids {SCENE} --truth --predictions {{answers}}.gone": "does not exist",
}


@pytest.mark.parametrize("options", WRONG)
def test_a_wrong_wish_gets_one_line(
    options: str, mini: Path, scene: RecordedScene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = options.format(answers=answered(scene, tmp_path / "answers.csv", (0.0, 0.0, 0.0))).split()
    assert main(["export", str(mini), "--format", "mcap", "--out", str(tmp_path / "out"), *words]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert WRONG[options] in line
    assert not (tmp_path / "out").exists()


def test_a_withheld_truth_is_said_to_be_withheld(public: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="withheld from this folder"):
        write_scene_recording(Dataset(public), SCENE, tmp_path / "scene.mcap", truth=True)
    assert not (tmp_path / "scene.mcap").exists()


def test_the_command_prints_the_file_that_it_wrote(
    mini: Path, plain: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", str(mini), "--format", "mcap", "--ids", SCENE, "--out", str(tmp_path)]) == 0
    assert capsys.readouterr().out == f"{tmp_path}\n"
    assert (tmp_path / f"{SCENE}.mcap").read_bytes() == plain.read_bytes()


def test_the_track_is_by_default_the_first_that_asks_in_the_scene(withheld: Published, tmp_path: Path) -> None:
    dataset = Dataset(withheld.public)
    for scene_id in dataset.split("test").scene_ids[:2]:
        (track,) = {query.track for query in dataset.recorded_scene(scene_id, truth=False).queries}
        path = write_scene_recording(dataset, scene_id, tmp_path / f"{scene_id}.mcap")
        named = write_scene_recording(dataset, scene_id, tmp_path / "named.mcap", track=track)
        assert path.read_bytes() == named.read_bytes()
        assert messages(path)["/pivots"]
