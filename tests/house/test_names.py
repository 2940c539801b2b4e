"""The rules of names: a file name means one thing in the whole tree, and a dotted name in a text exists."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from itertools import chain
from pathlib import Path

import pytest

from tests.samples.checkout import ROOT
from tests.samples.sources import PACKAGES, dotted, modules, statements, tree

PATTERNS = {"method", "network", "task", "config", "views", "__init__", "__main__"}  # may recur, one a folder
SHARED = {  # by name: the files, and why they may have the same
    "catalog": ("kit1000/prediction", "baselines"),  # methods of the library; all of them, with those of the paper
    "completed": ("kit1000/perception/completion/parts", "kit1000/perception/completion/kits"),  # folders of one plan
    "examples": ("baselines/snapnet", "baselines/transporter", "baselines/kitnet"),  # one a method, like `task`
    "frame": ("kit1000/perception/completion/parts", "kit1000/parts/families"),  # a family is named after its part
    "reading": ("kit1000/submission", "kit1000/dataset/mcap_io"),  # their paths are hashed with every score
    "scenes": ("kit1000/generation", "kit1000/cli"),  # commands stand by what they are about
    "search": ("baselines/snapnet", "baselines/transporter"),  # one a method, like `task`
    "seating": ("kit1000/kits", "kit1000/metrics"),  # their paths are hashed with every score
    "sensors": ("kit1000/sim", "kit1000/testing"),  # a conformance check is named after what it checks
    "sources": ("kit1000/parts/files", "kit1000/testing"),  # a conformance check is named after what it checks
}
NAME = re.compile(rf"(?<![\w/.-])(?:{'|'.join(PACKAGES)})(?:\.[A-Za-z_]\w*)+")
SCHEMAS = {"kit1000.SceneTruth"}  # of messages in recordings
SUFFIXES = {"md", "html", "json", "toml", "py", "yml", "mcap"}  # a file of that name, no attribute
PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")])


def test_a_file_name_means_one_thing() -> None:
    places: dict[str, set[str]] = {}
    for path in modules().values():
        places.setdefault(path.stem, set()).add(path.parent.relative_to(ROOT).as_posix())
    recurring = {name: found for name, found in places.items() if len(found) > 1 and name not in PATTERNS}
    assert recurring == {name: set(allowed) for name, allowed in SHARED.items()}


@cache
def members(path: Path) -> dict[str, ast.ClassDef | None]:
    """The names that a module defines or imports, each with its class, if it is one."""
    found: dict[str, ast.ClassDef | None] = {}
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            found.setdefault(node.name, node if isinstance(node, ast.ClassDef) else None)
        elif isinstance(node, ast.Import | ast.ImportFrom):
            found |= {alias.asname or alias.name: None for alias in node.names}
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = chain.from_iterable(map(ast.walk, targets))
            found |= {name.id: None for name in names if isinstance(name, ast.Name)}
    return found


def resolves(name: str) -> bool:
    """Whether a dotted name is a module, or stands in one: as a name, or as an attribute of a class of ours."""
    words = name.split(".")
    for count in range(len(words), 0, -1):
        path = modules().get(".".join(words[:count]))
        if path is None:
            continue
        inside = words[count:]
        if not inside:
            return True
        if inside[0] not in members(path):
            return inside == ["__all__"]
        owner = members(path)[inside[0]]
        return len(inside) == 1 or (owner is not None and inside[1] in attributes(owner))
    return False


def attributes(owner: ast.ClassDef) -> set[str]:
    """Methods and fields of a class, also those set on self."""
    nodes = list(ast.walk(owner))
    found = {node.name for node in nodes if isinstance(node, ast.FunctionDef)}
    found |= {node.attr for node in nodes if isinstance(node, ast.Attribute)}
    return found | {node.id for node in nodes if isinstance(node, ast.Name)}


def unresolved(text: str) -> set[str]:
    """The dotted names of ours in a text that stand for nothing."""
    names = {name for name in NAME.findall(text) if name.rpartition(".")[2] not in SUFFIXES}
    return {name for name in names - SCHEMAS if not resolves(name)}


def docstrings(path: Path) -> Iterator[tuple[int, str]]:
    """Line and text of each docstring of a file, those below fields included."""
    for statement in statements(path):
        value = getattr(statement, "value", None)
        if isinstance(statement, ast.Expr) and isinstance(value, ast.Constant) and isinstance(value.value, str):
            yield statement.lineno, value.value


def test_dotted_names_in_docstrings_resolve() -> None:
    found = {
        f"{dotted(path)}:{line}": names
        for path in modules().values()
        for line, text in docstrings(path)
        if (names := unresolved(text))
    }
    assert not found


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_dotted_names_on_a_page_resolve(path: Path) -> None:
    assert not unresolved(path.read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("name", "known"),
    [
        ("kit1000.kits", True),
        ("kit1000.pose.Pose", True),
        ("kit1000.pose.Pose.inverse", True),
        ("kit1000.values.View.depth", True),
        ("kit1000.Dataset", True),
        ("kit1000.pose.Pose.invert", False),
        ("kit1000.poses", False),
        ("kit1000.pose.Position", False),
    ],
)
def test_a_wrong_dotted_name_would_be_noticed(name: str, known: bool) -> None:
    assert unresolved(f"See `{name}`.") == (set() if known else {name})


def test_no_docstring_begins_before_its_subject() -> None:
    found = [
        f"{dotted(path)}:{line}: {text[:40]}"
        for path in modules().values()
        for line, text in docstrings(path)
        if text.split()[:1] and text.split()[0] in {"Of", "By", "At", "Those"}
    ]
    assert not found
