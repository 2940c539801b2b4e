"""Would the tests notice a wrong line? Changes sampled places of the scored modules, one at a time: `make mutants`.

A change swaps an operator or a comparison, or alters a number (`changes`). It is made in a copy of the tree, never in
the checkout. A change that no test notices has survived; the exit status is 1 when fewer than LEAST_SHARE die.
"""

from __future__ import annotations

import ast
import os
import random
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import tyro

ROOT = Path(__file__).resolve().parents[2]
MODULES = {
    "kit1000/metrics/*.py": ("tests/metrics",),
    "kit1000/kits/seating.py": ("tests/kits/test_seating.py", "tests/metrics/test_seating.py"),
    "kit1000/submission/*.py": ("tests/submission", "tests/benchmark/test_score.py"),
    "kit1000/queries/*.py": ("tests/queries", "tests/dataset/test_scene_queries.py"),
    "benchmark/intervals.py": ("tests/benchmark/test_intervals.py",),
    "benchmark/summary.py": ("tests/benchmark/test_score.py",),
}
"""Modules that decide a score, as patterns, and the tests that should notice a change of them."""
LEAST_SHARE = 0.8  # a part of all sampled changes alters nothing that can be observed, such as a message
TIMEOUT = 600  # [s] a change that makes the tests run on and on is noticed
COPIED = ("kit1000", "benchmark", "baselines", "bench", "tests", "docs", "pyproject.toml")
NOT_COPIED = shutil.ignore_patterns("*.safetensors", "*.pyc")
NEWER = 1000  # [s] by which a changed file is newer than before, so that no compiled code of it is used
FAILED, PASSED = 1, 0  # exit statuses of pytest
SWAPS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.And: ast.Or, ast.Or: ast.And,
    ast.Lt: ast.GtE, ast.GtE: ast.Lt, ast.Gt: ast.LtE, ast.LtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
}  # fmt: skip


class Mutant(NamedTuple):
    """A change of a module."""

    file: str
    place: int
    """Index among `places` of the module."""
    tests: tuple[str, ...]


@dataclass(frozen=True)
class Options:
    """Sample changes and run the tests of each."""

    words: tyro.conf.Positional[tuple[str, ...]] = ()
    """Only files whose path contains one of these words."""
    count: int = 60
    """Number of changes."""
    seed: int = 0
    """Seed of the sample."""


def places(tree: ast.Module) -> list[ast.expr]:
    """The expressions of a module that can be changed: operators, comparisons and numbers, none in annotations."""
    annotations = [getattr(node, name, None) for node in ast.walk(tree) for name in ("annotation", "returns")]
    types = {id(node) for annotation in annotations if annotation is not None for node in ast.walk(annotation)}
    return [node for node in ast.walk(tree) if isinstance(node, ast.expr) and id(node) not in types and _is_place(node)]


def _is_place(node: ast.expr) -> bool:
    if isinstance(node, ast.BinOp | ast.BoolOp):
        return type(node.op) in SWAPS
    if isinstance(node, ast.Compare):
        return type(node.ops[0]) in SWAPS
    return isinstance(node, ast.Constant) and type(node.value) in (int, float)


def changed(source: str, place: int) -> tuple[str, str]:
    """A module with a swapped operator or comparison, or with a number raised; and the line and change in words."""
    tree = ast.parse(source)
    node: Any = places(tree)[place]
    before = ast.unparse(node)
    kind = type(node)  # not isinstance, by which pyright narrows Any
    if kind is ast.Constant:
        node.value += 1 if isinstance(node.value, int) else node.value / 10 or 1.0
    elif kind is ast.Compare:
        node.ops[0] = SWAPS[type(node.ops[0])]()
    else:
        node.op = SWAPS[type(node.op)]()
    return ast.unparse(tree), f"{node.lineno}: {before} -> {ast.unparse(node)}".replace("\n", " ")


def sampled(options: Options) -> list[Mutant]:
    """The changes that are tried, the same ones for a seed."""
    every = [
        Mutant(path.relative_to(ROOT).as_posix(), place, tests)
        for pattern, tests in MODULES.items()
        for path in sorted(ROOT.glob(pattern))
        if not options.words or any(word in path.as_posix() for word in options.words)
        for place in range(len(places(ast.parse(path.read_text(encoding="utf-8")))))
    ]
    return random.Random(options.seed).sample(every, min(options.count, len(every)))


def copy_tree(target: Path) -> None:
    """Copy what the tests of the mutants need into an empty folder: with compiled functions and the times of files."""
    for name in COPIED:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, target / name, ignore=NOT_COPIED)
        else:
            shutil.copy2(source, target / name)


def pytest_status(tree: Path, tests: list[str], timeout: float | None = None) -> tuple[int, str]:
    """Run tests of a copy up to the first failure: the exit status of pytest and the end of its output."""
    options = ["-x", "-q", "-m", "not slow", "--hypothesis-seed=0", "--no-header"]
    command = [sys.executable, "-B", "-m", "pytest", *options, *tests]
    environment = os.environ | {"PYTHONPATH": str(tree)}
    try:
        run = subprocess.run(command, cwd=tree, env=environment, capture_output=True, text=True, timeout=timeout)
    except subprocess.TimeoutExpired:
        return FAILED, f"no end within {timeout} s"
    shutil.rmtree(tree / ".hypothesis", ignore_errors=True)  # failing examples of one mutant would help to kill others
    return run.returncode, run.stdout[-2000:] + run.stderr[-2000:]


def is_killed(mutant: Mutant, tree: Path) -> tuple[bool, str]:
    """Whether a test of the mutant fails in a copy of the tree, and the change; what is changed is restored."""
    path = tree / mutant.file
    plain, status = path.read_text(encoding="utf-8"), path.stat()
    source, change = changed(plain, mutant.place)
    compiled, kept = path.parent / "__pycache__", tree / "kept"
    compiled.mkdir(exist_ok=True)
    shutil.copytree(compiled, kept)
    path.write_text(source, encoding="utf-8")
    os.utime(path, (status.st_atime, status.st_mtime + NEWER))
    code, _ = pytest_status(tree, list(mutant.tests), TIMEOUT)
    path.write_text(plain, encoding="utf-8")
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))
    shutil.rmtree(compiled)
    kept.rename(compiled)
    return code != PASSED, f"{mutant.file}:{change}"  # a module that cannot be imported is noticed too


def main(options: Options) -> int:
    """Try the sampled changes; returns the exit status."""
    mutants, died = sampled(options), 0
    if not mutants:
        raise SystemExit(f"bench/outside/mutants.py: no file has a name with {' or '.join(options.words)}")
    with TemporaryDirectory() as folder:
        tree = Path(folder)
        copy_tree(tree)
        code, output = pytest_status(tree, sorted({name for mutant in mutants for name in mutant.tests}))
        if code != PASSED:
            raise SystemExit(f"bench/outside/mutants.py: the tests fail without any change\n{output}")
        for mutant in mutants:
            killed, name = is_killed(mutant, tree)
            died += killed
            print("died    " if killed else "SURVIVED", name, flush=True)
    print(f"{died} of {len(mutants)} died, {died / len(mutants):.1%}")
    return int(died / len(mutants) < LEAST_SHARE)


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Options, description=__doc__)))
