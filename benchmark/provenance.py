"""The provenance of a score: the commit, and a hash of the source files that scoring imports."""

from __future__ import annotations

import ast
import hashlib
import subprocess
from functools import cache
from pathlib import Path

import kit1000

BENCHMARK = Path(__file__).parent
LIBRARY = Path(kit1000.__file__).parent
ENTRY = "benchmark.score"  # the evaluator is this module and all it imports
PROTOCOLS = "protocols/*.json"
UNKNOWN = "unknown"
DIGITS = 16  # of the hash of the evaluator


@cache
def evaluator(benchmark: Path = BENCHMARK, library: Path = LIBRARY) -> str:
    """A hash of the protocols and of the sources that scoring imports: equal hashes give equal scores.

    Args:
        benchmark: folder of the package `benchmark`.
        library: folder of the package `kit1000`.
    """
    files = {f"benchmark/{path.relative_to(benchmark).as_posix()}": path for path in benchmark.glob(PROTOCOLS)}
    files |= evaluator_modules(benchmark, library)
    digest = hashlib.sha256()
    for name in sorted(files):
        digest.update(name.encode() + b"\0" + hashlib.sha256(files[name].read_bytes()).digest())
    return digest.hexdigest()[:DIGITS]


def evaluator_modules(benchmark: Path = BENCHMARK, library: Path = LIBRARY) -> dict[str, Path]:
    """The modules of `benchmark` and `kit1000` that `benchmark.score` imports, directly or not, and their files.

    Imports inside functions count too; those for type checkers alone do not.
    """
    roots = {"benchmark": benchmark, "kit1000": library}
    found: dict[str, Path] = {}
    waiting = [ENTRY]
    while waiting:
        module = waiting.pop()
        path = None if module in found else _file_of(module, roots)
        if path is not None:
            found[module] = path
            waiting += _imported_names(path.read_bytes())
            waiting += filter(None, [module.rpartition(".")[0]])  # a package runs before its modules
    return found


def _file_of(module: str, roots: dict[str, Path]) -> Path | None:
    """The file of a module; None where it is in neither package, or no module but a name inside one."""
    package, *rest = module.split(".")
    if package not in roots:
        return None
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
        else:  # no expression imports: blocks of statements are enough
            for block in ("body", "orelse", "finalbody", "handlers", "cases"):
                inner = getattr(node, block, [])
                waiting += inner if isinstance(inner, list) else []
    return frozenset(names)


@cache
def commit() -> str:
    """The commit of this checkout, followed by `-dirty` where its code was changed since; `unknown` outside one."""
    head = _git("rev-parse", "--show-prefix", "HEAD")
    if head is None:
        return UNKNOWN
    prefix, _, head = head.partition("\n")
    if prefix:  # a checkout of something else holds this folder
        return UNKNOWN
    library = [LIBRARY.name] if LIBRARY.parent == BENCHMARK.parent else []  # or it is installed elsewhere
    changed = _git("status", "--porcelain", "--", BENCHMARK.name, *library)
    return head.strip() + ("-dirty" if changed else "")


def _git(*words: str) -> str | None:
    """The output of git in this checkout; None where there is no git, or no checkout."""
    try:
        done = subprocess.run(["git", *words], cwd=BENCHMARK.parent, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout
