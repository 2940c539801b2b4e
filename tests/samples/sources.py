"""The source files of the checkout: their modules, their syntax, and what they import."""

from __future__ import annotations

import ast
import os
import re
from collections.abc import Iterator
from functools import cache
from itertools import accumulate, chain
from pathlib import Path

from tests.samples.checkout import ROOT

PACKAGES = ("kit1000", "benchmark", "baselines")  # the library and the two applications
PYTHON_FOLDERS = (*PACKAGES, "bench", "examples", "tests", "docs")
IMPORT = re.compile(r"^(?:import|from) +([\w.]+)(?: +import +(?:\(([^)]*)\)|(.*)))?", re.MULTILINE)


@cache
def modules() -> dict[str, Path]:
    """Every module of the library and the applications, by its dotted name."""
    files = chain.from_iterable((ROOT / package).rglob("*.py") for package in PACKAGES)
    return {dotted(path): path for path in sorted(files)}


def dotted(path: Path) -> str:
    """The dotted name of a file as a module."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def python_files() -> tuple[Path, ...]:
    """All Python of the checkout."""
    return tuple(chain.from_iterable(sorted((ROOT / folder).rglob("*.py")) for folder in PYTHON_FOLDERS))


@cache
def tree(path: Path) -> ast.Module:
    """The syntax of a file."""
    return ast.parse(path.read_text(encoding="utf-8"), str(path))


def statements(path: Path) -> Iterator[ast.AST]:
    """All statements of a file, also those inside others, and the handlers and cases around some; no expressions."""
    waiting: list[ast.AST] = [tree(path)]
    while waiting:
        node = waiting.pop()
        for block in ("body", "orelse", "finalbody", "handlers", "cases"):
            inner = getattr(node, block, ())
            if isinstance(inner, list):
                waiting += inner
                yield from inner


@cache
def imports(path: Path) -> frozenset[str]:
    """Dotted names that a file imports anywhere, each as `module` or, where that is one, `package.module`."""
    found = set()
    for node in statements(path):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name}:{node.lineno}: imports are absolute"
            found |= {_target(str(node.module), alias.name) for alias in node.names}
    return frozenset(found - {"kit1000.__version__"})


def _target(module: str, name: str) -> str:
    whole = f"{module}.{name}"
    return whole if whole in modules() or whole == "kit1000.__version__" else module


def loaded(path: Path) -> set[str]:
    """Dotted names of all modules that are loaded with a file, ours and others; not those imported in functions."""
    found: set[str] = set()
    left = [str(path)]
    while left:
        for name in _imported_on_loading(left.pop()) - found:
            found.add(name)
            left += filter(None, [_file_of(name)])
    return found


@cache
def _imported_on_loading(path: str) -> frozenset[str]:
    """By text, which is ten times faster than by syntax: imports begin a line."""
    with open(path, encoding="utf-8") as file:
        return frozenset(_names(file.read()))


def _names(text: str) -> Iterator[str]:
    for module, inside, after in IMPORT.findall(text):
        yield from accumulate(module.split("."), "{}.{}".format)  # a module is loaded after the packages around it
        for name in re.findall(r"\w+", inside or after):
            yield f"{module}.{name}"  # a module, or a name that has no file


@cache
def _file_of(name: str) -> str | None:
    if name.partition(".")[0] not in PYTHON_FOLDERS:
        return None
    place = os.path.join(ROOT, *name.split("."))
    return next(filter(os.path.isfile, (f"{place}.py", os.path.join(place, "__init__.py"))), None)
