"""The scripts that make the environment: the interpreter they take, and what they say where one must compile."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest
import tomli

from tests.samples.checkout import ROOT

TOOLS = ("sh", "rm", "mkdir", "date", "sleep", "dirname", "kill")
PYTHON = """#!/bin/sh
case "$2" in
    *print*) echo {version};;
    *"< (3, 10)"*) exit {old};;
    *"(3, 10), (3, 11)"*) exit {compiled};;
    *ensurepip*) exit {bare};;
    *Python.h*) exit {headless};;
    *pybullet*) exit 1;;
    venv) mkdir -p "$3" && echo "$0" >"$3/made-by";;
    pip) sleep {seconds}; echo "$@" >>"$LOG";;
esac
"""


def test_the_oldest_versions_are_those_that_the_project_allows() -> None:
    project = tomli.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    lines = [*project["dependencies"], *project["optional-dependencies"]["sim"]]
    bounds = {name: low for line in lines for name, low in re.findall(r"^([\w-]+)>=([\d.]+)", line) if ";" not in line}
    pinned = dict(re.findall(r"^([\w-]+)==([\d.]+)$", (ROOT / "requirements/oldest.txt").read_text(), re.MULTILINE))
    assert pinned.keys() == bounds.keys()
    assert {name: low for name, low in bounds.items() if f"{pinned[name]}.".startswith(f"{low}.")} == bounds


@pytest.fixture
def bin_folder(tmp_path: Path) -> Path:
    """A folder of the few programs that the scripts use, as on x86-64 Linux, without any Python."""
    folder = tmp_path / "bin"
    folder.mkdir()
    for tool in TOOLS:
        if (found := shutil.which(tool)) is not None:
            (folder / tool).symlink_to(found)
    program(folder / "uname", "#!/bin/sh\necho Linux x86_64\n")
    return folder


def program(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    path.chmod(0o755)
    return path


def interpreter(path: Path, version: str, bare: int = 0, headless: int = 1, seconds: float = 0) -> Path:
    """A stand-in for a Python of a version; bare: without venv; headless: without the headers for compilers."""
    minor = int(version.partition(".")[2])
    facts = {"version": version, "old": int(minor < 10), "compiled": int(minor not in (10, 11))}
    return program(path, PYTHON.format(**facts, bare=bare, headless=headless, seconds=seconds))


def run(script: str, bin_folder: Path, *words: object, **more: str) -> tuple[int, str]:
    """Exit status and standard error of a script."""
    home = bin_folder.parent / "home"
    variables = {"PATH": str(bin_folder), "HOME": str(home), "LOG": str(bin_folder.parent / "log"), **more}
    command = [str(bin_folder / "sh"), str(ROOT / "requirements" / script), *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, env=variables, cwd=ROOT, timeout=60)
    assert done.stdout == ""
    return done.returncode, done.stderr


def taken(bin_folder: Path, named: str = "") -> str:
    """The interpreter that makes the environment, without the folder of the test."""
    place = bin_folder.parent / "env"
    status, text = run("environment.sh", bin_folder, place, named)
    assert (status, text) == (0, "")
    return os.path.relpath((place / "made-by").read_text().strip(), bin_folder.parent)


def test_versions_with_wheels_come_before_newer_ones(bin_folder: Path) -> None:
    for name, version in (("python3", "3.13"), ("python3.13", "3.13"), ("python3.10", "3.10")):
        interpreter(bin_folder / name, version, headless=0)
    program(bin_folder / "g++", "#!/bin/sh\n")
    assert taken(bin_folder) == "bin/python3.10"
    interpreter(bin_folder / "python3.11", "3.11")
    assert taken(bin_folder) == "bin/python3.11"
    assert taken(bin_folder, str(bin_folder / "python3")) == "bin/python3"  # the named one is taken


@pytest.mark.parametrize(
    "kept",
    [".local/share/uv/python/cpython-3.11.9-linux-x86_64-gnu/bin/python3.11", ".pyenv/versions/3.10.13/bin/python3.10"],
)
def test_an_interpreter_that_only_uv_or_pyenv_keeps_is_found(kept: str, bin_folder: Path) -> None:
    interpreter(bin_folder / "python3", "3.12", headless=0)
    interpreter(bin_folder.parent / "home" / kept, kept.rpartition("python")[2])
    assert taken(bin_folder) == f"home/{kept}"


def test_python3_may_be_the_version_with_wheels(bin_folder: Path) -> None:
    interpreter(bin_folder / "python3", "3.11")
    assert taken(bin_folder) == "bin/python3"


@pytest.mark.parametrize("compiler", [None, "g++"])
def test_without_wheel_and_compiler_one_line_says_how_to_get_them(compiler: str | None, bin_folder: Path) -> None:
    interpreter(bin_folder / "python3", "3.13")  # no headers
    if compiler:
        program(bin_folder / compiler, "#!/bin/sh\n")
    status, text = run("environment.sh", bin_folder, bin_folder.parent / "env")
    assert (status, text.count("\n")) == (1, 1)
    for fact in ("Python 3.13", "uv python install 3.11", "apt install g++ python3.13-dev"):
        assert fact in text
    assert not (bin_folder.parent / "env").exists()


def test_a_newer_version_is_taken_where_it_can_compile(bin_folder: Path) -> None:
    interpreter(bin_folder / "python3.12", "3.12", headless=0)
    program(bin_folder / "c++", "#!/bin/sh\n")
    assert taken(bin_folder) == "bin/python3.12"


def test_old_bare_and_missing_interpreters_are_named(bin_folder: Path) -> None:
    place = bin_folder.parent / "env"
    assert "Python 3.10 or newer" in run("environment.sh", bin_folder, place)[1]
    assert "PYTHON=python9 cannot be run" in run("environment.sh", bin_folder, place, "python9")[1]
    interpreter(bin_folder / "python3", "3.9")
    assert "python3 is 3.9." in run("environment.sh", bin_folder, place)[1]
    interpreter(bin_folder / "python3.11", "3.11", bare=1)
    assert "apt install python3.11-venv" in run("environment.sh", bin_folder, place)[1]


def test_compiling_is_announced_and_told_again_every_minute(bin_folder: Path) -> None:
    python = interpreter(bin_folder / "python3.13", "3.13", seconds=0.3)
    status, text = run("install.sh", bin_folder, python, MINUTE="0.05")
    assert status == 0
    assert "compiling pybullet" in text.splitlines()[0]
    assert "Python 3.11" in text.splitlines()[0]
    assert "still compiling pybullet: 0 min" in text
    assert "--require-hashes -r requirements/run.txt" in (bin_folder.parent / "log").read_text()


def test_with_a_wheel_nothing_is_announced(bin_folder: Path) -> None:
    python = interpreter(bin_folder / "python3.11", "3.11", seconds=0.1)
    assert run("install.sh", bin_folder, python, MINUTE="0.05") == (0, "")
