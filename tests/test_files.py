"""Tests of files: atomic writes, errors of one line, one writer for each folder."""

from __future__ import annotations

import errno
import hashlib
import json
import os
from multiprocessing import get_context
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kit1000 import files
from kit1000.errors import InputError
from kit1000.files import (
    PARTIAL,
    check_output,
    check_writable,
    clear_partial,
    json_bytes,
    locked,
    new_folder,
    read_json,
    sha256,
    user_cache,
    write_bytes,
    write_json,
    write_own,
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

    monkeypatch.setattr("fcntl.flock", flock)
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


@pytest.mark.parametrize(
    ("present", "marks", "allowed"),
    [
        ((), ("plan.json",), True),
        ((".lock",), ("plan.json",), True),
        (("plan.json", "thesis.tex"), ("plan.json",), True),
        (("thesis.tex",), ("plan.json",), False),
        (("thesis.tex",), (), False),
    ],
)
def test_a_command_writes_to_a_new_an_empty_or_its_own_folder(
    present: tuple[str, ...], marks: tuple[str, ...], allowed: bool, tmp_path: Path
) -> None:
    check_output(tmp_path / "new", *marks)
    for name in present:
        (tmp_path / name).touch()
    if allowed:
        check_output(tmp_path, *marks)
    else:
        with pytest.raises(InputError, match=str(tmp_path)):
            check_output(tmp_path, *marks)
    assert sorted(os.listdir(tmp_path)) == sorted(present)


@pytest.mark.parametrize(
    ("old", "new", "replaced"),
    [
        (json_bytes({"a": 1, "b": 2}), json_bytes({"a": 3, "b": 4}), True),
        (json_bytes({"a": 1}), json_bytes({"a": 3, "b": 4}), False),
        (b'{"t": 1}\n{"t": 2}\n', b'{"t": 5}\n{"u": 2}\n', True),
        (b"method,mm\na,1\n", b"method,mm\nb,2\n", True),
        (b"mine", b"method,mm\nb,2\n", False),
        (b"", b"method,mm\n", False),
        (b"same", b"same", True),
        (b"\x89PNG mine", b"\x89PNG Kit1000", False),
        (b"\x89PNG kit1000 old", b"\x89PNG Kit1000 new", True),
        (b"\x89PNG kit1000", b"\x89MCAP kit1000", False),
    ],
)
def test_a_file_of_the_same_kind_alone_is_replaced(old: bytes, new: bytes, replaced: bool, tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_bytes(old)
    if replaced:
        write_own(path, new)
    else:
        with pytest.raises(InputError, match=str(path)):
            write_own(path, new)
    assert path.read_bytes() == (new if replaced else old)


def test_a_new_folder_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with pytest.raises(ZeroDivisionError), new_folder(out, "things") as partial:
        (partial / "a").write_text(str(1 / 0))
    assert os.listdir(tmp_path) == []
    out.mkdir()
    with new_folder(out, "things") as partial:
        (partial / "a").touch()
    assert os.listdir(tmp_path) == ["out"]
    with pytest.raises(InputError, match="things"), new_folder(out, "things"):
        pass
    assert os.listdir(out) == ["a"]


def test_the_cache_is_the_users(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert user_cache("scores") == tmp_path / "kit1000/scores"
    monkeypatch.setenv("XDG_CACHE_HOME", "")  # as good as none, by the XDG specification
    monkeypatch.setenv("HOME", str(tmp_path))
    assert user_cache("scores") == tmp_path / ".cache/kit1000/scores"
