"""The source files that a module imports, directly or not, and their hash: equal files give equal results."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path


def imported_modules(entries: Iterable[str], roots: Mapping[str, Path]) -> dict[str, Path]:
    """The modules that some modules import, directly or not, themselves included, and their files.

    Imports inside functions count too; those for type checkers alone do not.

    Args:
        entries: dotted names of the modules to begin with.
        roots: folders of the packages to follow, by name; for a single module its file.
    """
    found: dict[str, Path] = {}
    waiting = list(entries)
    while waiting:
        module = waiting.pop()
        path = None if module in found else _file_of(module, roots)
        if path is not None:
            found[module] = path
            waiting += _imported_names(path.read_bytes())
            waiting += filter(None, [module.rpartition(".")[0]])  # a package runs before its modules
    return found


def hash_of(files: Mapping[str, Path]) -> str:
    """SHA-256 in hex of files and their names."""
    digest = hashlib.sha256()
    for name in sorted(files):
        digest.update(name.encode() + b"\0" + hashlib.sha256(files[name].read_bytes()).digest())
    return digest.hexdigest()


def _file_of(module: str, roots: Mapping[str, Path]) -> Path | None:
    """The file of a module; None if it is in none of the packages, or if it is a name inside a module."""
    package, *rest = module.split(".")
    if package not in roots:
        return None
    if roots[package].is_file():
        return None if rest else roots[package]
    place = roots[package].joinpath(*rest)
    return next((path for path in (place / "__init__.py", place.with_suffix(".py")) if path.is_file()), None)


@cache
def _imported_names(source: bytes) -> frozenset[str]:
    """The names that a source imports: modules, and `module.name` for each name from one."""
    names: set[str] = set()
    waiting: list[ast.AST] = [ast.parse(source)]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            waiting += node.orelse
        else:  # expressions import nothing
            for block in ("body", "orelse", "finalbody", "handlers", "cases"):
                inner = getattr(node, block, [])
                waiting += inner if isinstance(inner, list) else []
    return frozenset(names)
