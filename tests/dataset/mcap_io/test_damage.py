"""Tests of invalid values and of damaged or other files: an error of one line, never other numbers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer

from kit1000.dataset.mcap_io import ObservationFile, TruthFile, writing
from kit1000.dataset.mcap_io.content_hash import observation_hash, truth_hash
from kit1000.dataset.scene_data import Observation
from kit1000.errors import InputError
from tests.samples.recorded import observation, query, truth, write, write_truth


@pytest.fixture
def seen(tmp_path: Path) -> Path:
    return write(tmp_path / "seen.mcap", [observation(k) for k in range(3)])


# What does not fit is refused


REFUSED = {
    "a field more": (replace(observation(), queries=(query("s", 0) | {"part_id": "x"},)), "query s-p0-snap: fields"),
    "a bad view": (Observation("s", {"../x": observation().views["ideal"]}), r"view '\.\./x': expected a name"),
    "masks of floats": (replace(observation(), labels=np.full((24, 32), 0.5)), "labels: expected uint8"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_an_observation_that_does_not_fit_is_refused(tmp_path: Path, case: str) -> None:
    scene, message = REFUSED[case]
    with pytest.raises(InputError, match=message):
        write(tmp_path / "a.mcap", [scene])


def test_models_of_unknown_bodies_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"models parts/x, expected"):
        write_truth(tmp_path / "t.mcap", [replace(truth(), models={"parts/x": b""})])


def test_unknown_scenes_and_views_are_answered_with_the_known_ones(seen: Path) -> None:
    file = ObservationFile(seen)
    with pytest.raises(InputError, match=r"no scene 'test-s0010' among 3.*did you mean test-s000\d\?"):
        file.queries("test-s0010")
    with pytest.raises(InputError, match=r"test-s0001 has no view 'd435'; it has ideal, d415"):
        file.view("test-s0001", "d435")


def test_other_mcap_files_are_refused(tmp_path: Path, seen: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def error_of(name: str, data: bytes, kind: type[ObservationFile] | type[TruthFile] = ObservationFile) -> str:
        path = tmp_path / name
        path.write_bytes(data)
        with pytest.raises(InputError) as caught:
            kind(path).scene_ids
        return str(caught.value)

    assert "empty file" in error_of("empty.mcap", b"")
    assert "no MCAP file" in error_of("text.mcap", b"a recording, I swear\n" * 9)
    assert "run git lfs pull" in error_of("pointer.mcap", b"version https://git-lfs.github.com/spec/v1\nsize 684\n")
    assert "truncated" in error_of("short.mcap", seen.read_bytes()[:-100])
    assert "truncated" in error_of("magic.mcap", seen.read_bytes()[:8])
    assert "expected a file of 'truth'" in error_of("swapped.mcap", seen.read_bytes(), TruthFile)
    with monkeypatch.context() as patch:
        patch.setattr(writing, "FORMAT", "kit1000/1")
        older = write(tmp_path / "older.mcap", [observation()])
    assert "older.mcap has format 'kit1000/1'" in error_of(older.name, older.read_bytes())
    with open(tmp_path / "foreign.mcap", "wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_message(writer.register_channel("/a", "json", 0), 1, b"{}", 1)
        writer.finish()
    assert "no recording of kit1000" in error_of("foreign.mcap", (tmp_path / "foreign.mcap").read_bytes())
    for path, message in ((tmp_path / "none.mcap", "no file"), (tmp_path, "Is a directory")):
        with pytest.raises(InputError, match=message):
            ObservationFile(path).scene_ids


def test_a_file_rewritten_by_another_tool_is_refused(tmp_path: Path, seen: Path) -> None:
    with open(seen, "rb") as file, open(tmp_path / "anew.mcap", "wb") as out:
        reader, writer, ids = make_reader(file), Writer(out), {}
        writer.start()
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            if channel.id not in ids:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                ids[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, number)
            writer.add_message(ids[channel.id], message.log_time, message.data, message.publish_time)
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        writer.finish()
    with pytest.raises(InputError, match="rewritten by another tool"):
        ObservationFile(tmp_path / "anew.mcap").scene_ids


# Damage


@pytest.fixture(scope="module")
def intact(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The bytes of a file of observations and of one of truths."""
    folder = tmp_path_factory.mktemp("sound")
    write(folder / "seen", [observation(k) for k in range(2)])
    write_truth(folder / "truth", [truth()])
    return {name: (folder / name).read_bytes() for name in ("seen", "truth")}


def hashes(path: Path, name: str) -> list[str]:
    """The content hash of the first scene, computed from all messages."""
    file = ObservationFile(path) if name == "seen" else TruthFile(path)
    return [file.recomputed_hash(scene_id) for scene_id in file.scene_ids]


def assert_same_or_refused(path: Path, data: bytes, name: str) -> None:
    """Assert that a file of these bytes has the same content as the intact one, or is refused in one line."""
    path.write_bytes(data)
    wanted = {"seen": [observation_hash(observation(k)) for k in range(2)], "truth": [truth_hash(truth())]}[name]
    said = None
    try:
        assert hashes(path, name) == wanted
    except InputError as error:
        said = str(error)
    assert said is None or (str(path) in said and "\n" not in said)


DAMAGE = settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])


@DAMAGE
@given(st.data(), st.sampled_from(["seen", "truth"]))
def test_a_truncated_file_is_refused(tmp_path: Path, intact: dict[str, bytes], data: st.DataObject, name: str) -> None:
    cut = data.draw(st.integers(0, len(intact[name]) - 1))
    (tmp_path / "cut").write_bytes(intact[name][:cut])
    with pytest.raises(InputError, match=r"empty file|no MCAP file|truncated"):
        hashes(tmp_path / "cut", name)


@DAMAGE
@given(st.data(), st.sampled_from(["seen", "truth"]))
def test_flipped_bytes_change_nothing_or_are_detected(
    tmp_path: Path, intact: dict[str, bytes], data: st.DataObject, name: str
) -> None:
    damaged = bytearray(intact[name])
    flips = st.tuples(st.integers(0, len(damaged) - 1), st.integers(1, 255))
    for place, change in data.draw(st.lists(flips, min_size=1, max_size=3)):
        damaged[place] ^= change
    assert_same_or_refused(tmp_path / "flipped", bytes(damaged), name)
