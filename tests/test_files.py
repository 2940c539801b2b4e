"""Tests of files: atomic writes, errors of one line, one writer for each folder."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import sys
from collections.abc import Iterator
from multiprocessing import get_context
from pathlib import Path
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kit1000 import files
from kit1000.errors import InputError
from kit1000.files import (
    PARTIAL,
    check_writable,
    clear_partial,
    is_url,
    json_bytes,
    locked,
    parse_folder,
    read_json,
    remove_folder,
    sha256,
    user_cache,
    write_bytes,
    write_json,
)

VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=20,
)


@given(VALUES)
def test_json_round_trips_every_value_to_the_bit(value: object) -> None:
    again = json.loads(json_bytes(value))
    assert again == value
    assert json_bytes(again) == json_bytes(value)


def test_json_bytes_do_not_depend_on_the_order_of_keys() -> None:
    assert json_bytes({"b": 1, "a": {"d": 2, "c": 3}}) == json_bytes({"a": {"c": 3, "d": 2}, "b": 1})


def test_a_written_file_is_there_with_its_hash_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "deep/er/a.bin"
    digest = write_bytes(path, b"data")
    assert digest == sha256(path) == hashlib.sha256(b"data").hexdigest()
    assert os.listdir(path.parent) == ["a.bin"]
    write_bytes(path, b"new")
    assert path.read_bytes() == b"new"


def test_no_file_has_no_hash(tmp_path: Path) -> None:
    assert sha256(tmp_path / "none") is None
    assert sha256(tmp_path) is None


@pytest.mark.parametrize("where", ["fsync", "replace"])
@pytest.mark.parametrize("stop", [OSError(errno.ENOSPC, "No space left on device"), KeyboardInterrupt()])
def test_a_write_that_is_stopped_leaves_the_old_file_and_no_other(
    where: str, stop: BaseException, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.bin"
    write_bytes(path, b"old")

    def fail(*_: object) -> None:
        raise stop

    monkeypatch.setattr(files.os, where, fail)
    with pytest.raises((InputError, KeyboardInterrupt)) as caught:
        write_bytes(path, b"new")
    if isinstance(stop, OSError):
        assert str(caught.value).startswith(f"cannot write {path}: No space left on device")
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["a.bin"]


def test_an_obstacle_to_writing_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"cannot write .*a.bin: .*a file exists"):
        write_bytes(tmp_path / "file/a.bin", b"")
    with pytest.raises(InputError, match="a folder exists where a file is needed"):
        write_bytes(tmp_path, b"")
    assert sorted(os.listdir(tmp_path)) == ["file"]


def test_reading_what_is_no_json_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no file"):
        read_json(tmp_path / "a.json")
    for data in (b"", b'{"a": ', b"\xff\xfe\x00"):
        (tmp_path / "a.json").write_bytes(data)
        with pytest.raises(InputError, match="damaged or no JSON") as caught:
            read_json(tmp_path / "a.json")
        assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match="Is a directory"):
        read_json(tmp_path)


def test_only_partial_files_are_deleted(tmp_path: Path) -> None:
    keep = [tmp_path / name for name in ("a.glb", f"b{PARTIAL}", ".hidden", "in/c.glb")]
    left = [tmp_path / name for name in (f".a.glb.1{PARTIAL}", f"in/.c.glb.22{PARTIAL}")]
    for path in keep + left:
        path.parent.mkdir(exist_ok=True)
        path.touch()
    clear_partial(tmp_path, "c.glb")
    assert left[0].exists()
    clear_partial(tmp_path, "a.glb")
    assert not left[0].exists()
    assert left[1].exists()
    clear_partial(tmp_path)
    assert not left[1].exists()
    assert all(path.exists() for path in keep)


def hold(folder: Path, ready, release) -> None:
    """Another process that locks a folder."""
    with locked(folder):
        ready.set()
        release.wait(30)


def test_a_folder_has_one_writer_and_a_killed_one_frees_it(tmp_path: Path) -> None:
    context = get_context("spawn")
    ready, release = context.Event(), context.Event()
    other = context.Process(target=hold, args=(tmp_path, ready, release))
    other.start()
    assert ready.wait(30)
    with pytest.raises(InputError, match="is being written by another process"), locked(tmp_path):
        pass
    other.kill()
    other.join()
    with locked(tmp_path):
        pass


def test_a_disk_without_locks_has_an_error_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def flock(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(files.fcntl, "flock", flock)
    with pytest.raises(InputError, match=r"cannot lock .*: No locks available"), locked(tmp_path):
        pass


def test_a_folder_is_checked_before_it_is_created(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    check_writable(tmp_path / "new/er")
    assert not os.listdir(tmp_path)
    (tmp_path / "file").touch()
    for place in (tmp_path / "file", tmp_path / "file/below"):
        with pytest.raises(InputError, match="a file exists where a folder is needed"):
            check_writable(place)
    monkeypatch.setattr(files.os, "access", lambda *_: False)
    with pytest.raises(InputError, match=r"Permission denied.*--out"):
        check_writable(tmp_path / "new")


def test_values_that_json_lacks_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="JSON"):
        write_json(tmp_path / "a.json", {"a": float("nan")})
    assert not os.listdir(tmp_path)


def test_a_folder_of_this_machine_is_a_plain_path(tmp_path: Path) -> None:
    assert parse_folder("data/a b") == Path("data/a b")
    assert parse_folder(f"file://{tmp_path}/a%20b") == tmp_path / "a b"
    assert not is_url(parse_folder(f"file://{tmp_path}"))


@pytest.mark.parametrize(("url", "said"), [("nowhere://a/b", "nowhere"), ("oci://bucket/data", "Install|install")])
def test_a_url_that_cannot_be_reached_is_one_line(url: str, said: str) -> None:
    with pytest.raises(InputError, match=rf"^{url}: .*({said}).*$"):
        parse_folder(url)


def test_without_the_packages_for_urls_the_error_says_how_to_install_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "upath", None)
    with pytest.raises(InputError, match=r"^memory://a: .*pip install 'kit1000\[ray\]'"):
        parse_folder("memory://a")


@pytest.fixture(params=["memory", "local"])
def remote(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Path]:
    """A folder behind a URL: without folders, as in object stores, and with folders that must be created."""
    place = parse_folder(f"{request.param}://{tmp_path}/root")
    assert is_url(place)
    yield place
    remove_folder(place)


def test_files_behind_a_url_are_written_read_and_removed(remote: Path) -> None:
    check_writable(remote)
    assert not remote.is_dir() or not list(remote.iterdir())
    assert sha256(remote / "deep/a.json") is None
    with locked(remote):
        digest = write_json(remote / "deep/a.json", {"a": [1, 2]})
        clear_partial(remote)
    assert read_json(remote / "deep/a.json") == {"a": [1, 2]}
    assert sha256(remote / "deep/a.json") == digest == hashlib.sha256((remote / "deep/a.json").read_bytes()).hexdigest()
    assert [path.name for path in (remote / "deep").glob("*.json")] == ["a.json"]
    with pytest.raises(InputError, match=r"^no file .*b\.json$"):
        read_json(remote / "b.json")
    (remote / "deep/a.json").write_bytes(b"{")
    with pytest.raises(InputError, match=r"^cannot read .*://.*a\.json: damaged or no JSON"):
        read_json(remote / "deep/a.json")
    remove_folder(remote / "deep")
    remove_folder(remote / "deep")
    assert not (remote / "deep").exists()


class Refused(Exception):
    """An exception of an object store."""


def test_a_store_that_refuses_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    place = parse_folder("memory://bucket/data")

    def refuse(*_: object, **__: object) -> None:
        raise Refused("no\ncredentials")

    monkeypatch.setattr(cast(Any, place).fs, "open", refuse)
    with pytest.raises(InputError, match=r"^cannot write to memory://bucket/data: Refused: no credentials$"):
        check_writable(place)
    with pytest.raises(InputError, match=r"^cannot write memory://bucket/data/a: Refused: no credentials$"):
        write_bytes(place / "a", b"")


def test_the_cache_is_the_users(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert user_cache("scores") == tmp_path / "kit1000/scores"
    monkeypatch.setenv("XDG_CACHE_HOME", "")  # as good as none, by the XDG specification
    monkeypatch.setenv("HOME", str(tmp_path))
    assert user_cache("scores") == tmp_path / ".cache/kit1000/scores"
