"""Recordings come back to the bit, in the order and the chunks that readers and viewers need."""

from __future__ import annotations

import io
import json
import struct
import time
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.reader import make_reader
from mcap.records import Chunk, McapRecord
from mcap.stream_reader import breakup_chunk
from mcap_protobuf.decoder import DecoderFactory
from PIL import Image

from kit1000.camera import Camera
from kit1000.dataset.mcap_io import ObservationFile, ObservationWriter, TruthFile, reading, writing
from kit1000.dataset.mcap_io.content_hash import observation_hash, truth_hash
from kit1000.dataset.scene_data import Observation
from kit1000.errors import InputError
from kit1000.pose import Pose
from kit1000.values import View
from tests.samples.recorded import (
    BIG,
    CAMERA,
    POSE,
    extra_views,
    observation,
    preview,
    query,
    same,
    same_pose,
    truth,
    write,
    write_truth,
)


@pytest.fixture
def seen(tmp_path: Path) -> Path:
    return write(tmp_path / "seen.mcap", [observation(k) for k in range(3)])


@pytest.fixture
def large(tmp_path: Path) -> Path:
    return write(tmp_path / "large.mcap", [observation(k, BIG) for k in range(5)])


def read_by_mcap(path: Path, *topics: str) -> list[Any]:
    """Channel, message and value as read by the MCAP library, with checksums."""
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        return [(c, m, v) for _, c, m, v in reader.iter_decoded_messages(topics)]


# What is written is what is read


def test_observations_come_back_to_the_bit(seen: Path) -> None:
    file = ObservationFile(seen)
    assert file.scene_ids == ("test-s0000", "test-s0001", "test-s0002")
    for k in (2, 0, 1):
        assert same(file.observation(f"test-s{k:04d}"), observation(k))


def test_views_of_extra_cameras_come_back_in_order(tmp_path: Path) -> None:
    file = ObservationFile(write(tmp_path / "seen.three.mcap", [extra_views()]))
    assert file.view_keys("test-s0000")[:3] == ("three/0/ideal", "three/0/d415", "three/1/ideal")
    assert same(file.observation("test-s0000"), extra_views())
    assert file.labels("test-s0000") is None


def sorted_json(*rows: Any) -> str:
    return json.dumps(rows, sort_keys=True)


def test_truths_come_back_to_the_bit(tmp_path: Path) -> None:
    write_truth(tmp_path / "t.mcap", [truth(0), replace(truth(1), goals=None, models={})])
    file = TruthFile(tmp_path / "t.mcap")
    for k, wanted in enumerate([truth(0), replace(truth(1), goals=None, models={})]):
        found = file.truth(f"test-s{k:04d}")
        assert sorted_json(found.parts, found.queries) == sorted_json(wanted.parts, wanted.queries)
        assert same_pose(found.world_from_assembly, wanted.world_from_assembly)
        assert found.seg.tobytes() == wanted.seg.tobytes()
        assert found.models == file.models(f"test-s{k:04d}") == wanted.models
        if found.goals is None or wanted.goals is None:
            assert found.goals is wanted.goals
        else:
            assert same_pose(found.goals, wanted.goals)


def test_arrays_are_read_only_and_aligned(seen: Path) -> None:
    scene = ObservationFile(seen).observation("test-s0001")
    for array in (scene.views["ideal"].depth, scene.views["d415"].depth, scene.labels):
        assert array is not None
        assert not array.flags.writeable
        assert array.flags.aligned


# The same scenes give the same bytes


def test_bytes_depend_on_the_scenes_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = write(tmp_path / "a.mcap", [observation(k) for k in range(2)])
    monkeypatch.setattr(time, "time_ns", lambda: 12345)
    monkeypatch.setattr(time, "time", lambda: 12.345)
    scenes = [observation(k) for k in range(2)]
    turned = [replace(scene, views=dict(reversed([*scene.views.items()]))) for scene in scenes]
    assert write(tmp_path / "b.mcap", turned).read_bytes() == first.read_bytes()


def test_the_writer_has_the_hash_of_the_file(tmp_path: Path) -> None:
    with ObservationWriter(tmp_path / "a.mcap") as writer:
        writer.add(observation())
        assert not list(tmp_path.iterdir())
    assert writer.sha256 == sha256((tmp_path / "a.mcap").read_bytes()).hexdigest()


def test_a_file_is_written_completely_or_not_at_all(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="twice"):
        write(tmp_path / "a.mcap", [observation(), observation()])
    with ObservationWriter(tmp_path / "b.mcap") as writer:
        pass
    assert writer.sha256 is None
    assert not list(tmp_path.iterdir())


# What it looks like to others


def test_small_messages_are_one_chunk_of_a_scene_and_each_image_is_another(large: Path) -> None:
    with open(large, "rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary, header = reader.get_summary(), reader.get_header()
    assert summary is not None
    assert (header.profile, header.library) == ("", "kit1000")
    topics = {number: channel.topic for number, channel in summary.channels.items()}
    small = {"/ideal/camera", "/d415/camera", "/preview/camera", "/tf", "/query"}
    images = [{topic} for topic in ("/preview", "/points", "/ideal/labels", "/ideal/depth", "/d415/depth")]
    for number, chunk in enumerate(summary.chunk_indexes):
        assert {topics[channel] for channel in chunk.message_index_offsets} == [small, *images][number % 6]
        assert chunk.message_start_time == (1_767_225_600 + number // 6) * 10**9
        assert chunk.message_end_time == chunk.message_start_time
        assert chunk.compression == "zstd"
    assert len(summary.chunk_indexes) == 5 * 6


def test_viewers_find_a_calibration_and_a_frame_for_every_depth_image(tmp_path: Path, seen: Path) -> None:
    for path in (seen, write(tmp_path / "three.mcap", [extra_views()])):
        with open(path, "rb") as file:
            channels = {c.topic: s for s, c, _ in make_reader(file).iter_messages() if s is not None}
        depths = [topic for topic in channels if topic.endswith("/depth")]
        calibrations = [topic for topic, schema in channels.items() if schema.name == "foxglove.CameraCalibration"]
        assert depths
        assert len(calibrations) == len({read_by_mcap(path, topic)[0][2].frame_id for topic in calibrations})
        for topic in depths:
            beside = topic.removesuffix("depth") + "camera"  # where viewers look for it
            assert channels[topic].name == "foxglove.RawImage"
            assert channels[beside].name == "foxglove.CameraCalibration"
            prefix = topic.removesuffix("depth")
            assert [name for name in calibrations if name.startswith(prefix)] == [beside]
            (_, _, image), (_, _, camera), (_, _, frames) = (read_by_mcap(path, t)[0] for t in (topic, beside, "/tf"))
            assert image.frame_id == camera.frame_id
            (transform,) = [t for t in frames.transforms if t.child_frame_id == image.frame_id]
            assert transform.parent_frame_id == "world"
            assert len({str(item.timestamp) for item in (image, camera, transform)}) == 1
            assert (image.encoding, image.step, image.width) == ("32FC1", 4 * CAMERA.width, camera.width)
            assert len(image.data) == image.step * image.height
            assert np.reshape(camera.K, (3, 3)).tolist() == CAMERA.K.tolist()
            assert np.reshape(camera.P, (3, 4))[:, :3].tolist() == CAMERA.K.tolist()
            assert (list(camera.R), list(camera.D)) == (np.eye(3).ravel().tolist(), [])


def test_previews_are_pictures_in_a_frame_of_their_own(tmp_path: Path, seen: Path) -> None:
    write_truth(tmp_path / "t.mcap", [truth()])
    for path, topic in ((seen, "/preview"), (tmp_path / "t.mcap", "/preview/goals")):
        (_, _, value), *_ = read_by_mcap(path, topic)
        assert (value.format, value.frame_id) == ("png", "preview")
        assert np.array_equal(np.asarray(Image.open(io.BytesIO(value.data))), preview(0, CAMERA))
        assert value.timestamp.seconds == 1_767_225_600
    (_, _, camera), *_ = read_by_mcap(seen, "/preview/camera")
    assert (camera.frame_id, camera.width, camera.height) == ("preview", CAMERA.width // 2, CAMERA.height // 2)
    (_, _, frames), *_ = read_by_mcap(seen, "/tf")
    poses = {item.child_frame_id: str(item.translation) + str(item.rotation) for item in frames.transforms}
    assert poses["preview"] == poses["camera"]
    found = TruthFile(tmp_path / "t.mcap").truth("test-s0000").preview
    assert found is not None
    assert np.array_equal(found, preview(0, CAMERA))


def test_points_of_a_preview_are_some_of_its_pixels_at_their_depth(seen: Path) -> None:
    (_, _, cloud), *_ = read_by_mcap(seen, "/points")
    rows = np.frombuffer(cloud.data, [("xyz", "<f4", 3), ("rgba", "u1", 4)])
    assert (cloud.frame_id, [field.name for field in cloud.fields]) == (
        "preview",
        [*"xyz", "red", "green", "blue", "alpha"],
    )
    scene = observation()
    depth, half = scene.views["ideal"].depth[::2, ::2], CAMERA.scaled(0.5)
    assert scene.labels is not None
    u, v = rows["rgba"][:, 0].astype(int), rows["rgba"][:, 1].astype(int)  # the colours tell the pixel
    assert np.array_equal(rows["xyz"][:, 2], np.rint(depth[v, u] * 1024) / 1024)
    found = half.project(rows["xyz"][rows["xyz"][:, 2] > 0.1].astype(float))
    assert np.abs(found - np.stack([u, v], axis=-1)[rows["xyz"][:, 2] > 0.1]).max() < 0.5
    expected = np.zeros(depth.shape, bool)
    expected[::2, ::2] = scene.labels[::4, ::4] > 0
    expected[::4, ::4] = True
    assert set(zip(v.tolist(), u.tolist(), strict=True)) == {
        tuple(at) for at in np.argwhere(expected & (depth > 0)).tolist()
    }


def test_a_scene_replaces_the_models_of_the_one_before(tmp_path: Path) -> None:
    write_truth(tmp_path / "t.mcap", [truth()])
    ((_, _, update),) = read_by_mcap(tmp_path / "t.mcap", "/scene")
    assert [deletion.type for deletion in update.deletions] == [1]  # all
    assert [entity.id for entity in update.entities] == list(truth().models)
    ((_, _, frames),) = read_by_mcap(tmp_path / "t.mcap", "/tf")
    assert [item.child_frame_id for item in frames.transforms] == list(truth().models)


def test_schemas_are_complete_and_rows_fit_them(tmp_path: Path, seen: Path) -> None:
    write_truth(tmp_path / "t.mcap", [truth()])
    for path in (seen, tmp_path / "t.mcap"):
        with open(path, "rb") as file:
            messages = list(make_reader(file).iter_messages())
        for schema, channel, message in messages:
            assert schema is not None
            if schema.encoding == "jsonschema":
                assert channel.message_encoding == "json"
                jsonschema.validate(json.loads(message.data), json.loads(schema.data))
            else:
                files = FileDescriptorSet.FromString(schema.data).file
                held = {item.name for item in files}
                assert {needed for item in files for needed in item.dependency} <= held


def test_an_observation_file_contains_no_part_id_and_no_seed(seen: Path) -> None:
    with open(seen, "rb") as file:
        reader = make_reader(file)
        (record,) = reader.iter_metadata()
        rows = [json.loads(message.data) for _, _, message in reader.iter_messages("/query")]
    keys = {"format", "holds", "generator", "licence", "length_unit", "depth_unit", "scenes", "content"}
    assert record.name == "kit1000"
    assert set(record.metadata) == keys | {"checksum"}
    for row in rows:
        assert set(row) == {"id", "track", "sensor", "part", "drawn", "pivot", "guess"}


# The content hash


def test_the_content_hash_is_stored_and_can_be_computed_again(tmp_path: Path, seen: Path) -> None:
    file = ObservationFile(seen)
    for k, scene_id in enumerate(file.scene_ids):
        assert file.content_hash(scene_id) == file.recomputed_hash(scene_id) == observation_hash(observation(k))
    write_truth(tmp_path / "t.mcap", [truth()])
    assert TruthFile(tmp_path / "t.mcap").recomputed_hash("test-s0000") == truth_hash(truth())


def test_any_change_of_content_changes_the_hash() -> None:
    scene, so = observation(), truth()
    assert scene.labels is not None
    ideal, rows = scene.views["ideal"], scene.queries
    nudged = ideal.depth.copy()
    nudged[3, 4] += 2**-13
    scenes = [
        scene,
        replace(scene, scene_id="test-s0009"),
        replace(scene, labels=None),
        replace(scene, labels=scene.labels.T),
        replace(scene, queries=rows[::-1]),
        replace(scene, queries=(rows[0] | {"pivot": [0.1, 0.2, 0.3]}, *rows[1:])),
        replace(scene, views={"ideal": ideal}),
        replace(scene, views={**scene.views, "ideal": replace(ideal, depth=nudged)}),
        replace(scene, views={**scene.views, "ideal": replace(ideal, camera=replace(CAMERA, cx=15.0))}),
        replace(scene, views={**scene.views, "ideal": replace(ideal, world_from_camera=POSE.inverse())}),
        replace(scene, views={"ideal": scene.views["d415"], "d415": ideal}),
    ]
    truths = [so, replace(so, goals=None), replace(so, seg=so.seg + 1), replace(so, parts=()), replace(so, queries={})]
    assert len({observation_hash(item) for item in scenes}) == len(scenes)
    assert len({truth_hash(item) for item in truths}) == len(truths)
    assert truth_hash(replace(so, models={}, preview=None)) == truth_hash(so)  # copies for viewers
    assert observation_hash(replace(scene, preview=preview(3, CAMERA))) == observation_hash(scene)


def test_the_content_hash_has_not_changed() -> None:
    turned = Pose(np.array([0.5, 0.5, -0.5, 0.5]), np.array([0.25, -0.0, 1.5]))
    view = View(Camera(3, 2, 4.0, 5.0, 1.0, 0.5), turned, np.arange(6, dtype=np.float32).reshape(2, 3) / 8)
    scene = Observation("test-s0000", {"ideal": view}, np.eye(2, 3, dtype=np.uint8), (query("s", 1, turned),))
    told = (
        b'{"queries":[{"drawn":false,"guess":{"wxyz":[0.5,0.5,-0.5,0.5],"xyz":[0.25,-0.0,1.5]},"id":"s-p1-snap",'
        b'"part":1,"pivot":[0.1,0.3333333333333333,-0.0],"sensor":"ideal","track":"snap"}],"scene_id":"test-s0000",'
        b'"views":{"ideal":{"camera":[3,2,4.0,5.0,1.0,0.5],"world_from_camera":'
        b'{"wxyz":[0.5,0.5,-0.5,0.5],"xyz":[0.25,-0.0,1.5]}}}}'
    )
    depth = b'["ideal","<f4",[2,3]]' + struct.pack("<6f", 0, 0.125, 0.25, 0.375, 0.5, 0.625)
    masks = b'["labels","|u1",[2,3]]' + bytes([1, 0, 0, 0, 1, 0])
    assert observation_hash(scene) == sha256(told + depth + masks).hexdigest()


@pytest.fixture
def bytes_read(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The compressed sizes of all chunks that are read later."""
    sizes: list[int] = []

    def breakup(chunk: Chunk, validate_crc: bool) -> list[McapRecord]:
        sizes.append(len(chunk.data))
        return breakup_chunk(chunk, validate_crc)

    monkeypatch.setattr(reading, "breakup_chunk", breakup)
    return sizes


def test_only_the_requested_messages_are_read(large: Path, bytes_read: list[int]) -> None:
    file, scene = ObservationFile(large), large.stat().st_size / 5
    assert len(file.scene_ids) == 5
    assert not bytes_read
    assert [row["part"] for row in file.queries("test-s0003")] == [0, 1, 2]
    assert sum(bytes_read) < scene / 100
    file.view("test-s0003", "ideal")
    assert sum(bytes_read) < 0.6 * scene
    file.view("test-s0003", "ideal")
    file.queries("test-s0003")
    assert len(bytes_read) == 2
    file.observation("test-s0003")
    assert sum(bytes_read) <= scene


def test_a_file_of_data_2_0_0_with_a_chunk_for_each_scene_is_read_alike(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenes = [observation(k) for k in range(3)]
    monkeypatch.setattr(writing, "LARGE", ())
    file = ObservationFile(write(tmp_path / "older.mcap", scenes))
    assert file.view_keys("test-s0001") == ("ideal", "d415")
    assert all(same(file.observation(scene.scene_id), scene) for scene in scenes)
