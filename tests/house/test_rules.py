"""The rules of the house: layers, fences, sizes, names, and that every command shown in a document exists."""

from __future__ import annotations

import ast
import importlib
import re
import shlex
import subprocess
import sys
from functools import cache
from graphlib import TopologicalSorter
from itertools import chain
from pathlib import Path
from typing import Any

import pytest
import tomli

from kit1000.cli.arguments import usage_error
from tests.samples.checkout import ROOT
from tests.samples.sources import PACKAGES, PYTHON_FOLDERS, dotted, imports, modules, python_files, statements, tree

# A module imports from rows above and from further left in its own; inside one entry no circles are the rule.
LAYERS = (
    ("errors", "version", "interrupts", "rng", "numerics", "weights"),
    ("pose", "symmetry", "mesh", "camera", "values", "files", "engines"),
    ("parts", "kits", "voxels"),
    ("queries.motions", "metrics"),
    ("sim",),
    ("queries", "dataset", "predictor", "submission"),
    ("perception", "prediction.catalog", "registration", "prediction"),
    ("pictures", "export", "generation", "capture"),
    ("planner", "labelling", "editor", "study", "testing"),
    ("cli", "", "__main__"),  # "" is the package itself, which hands out names of all the others
    ("benchmark",),
    ("baselines",),
)
ORDER = {name: place for place, name in enumerate(chain(*LAYERS))}

FENCES = {
    "manifold3d": ("kit1000.mesh", "kit1000.parts", "kit1000.kits", "kit1000.metrics", "kit1000.testing"),
    "pybullet": ("kit1000.sim", "kit1000.planner"),
    "coacd": (),  # a bench and its tests alone
    "numba": ("kit1000.numerics",),
    "kit1000.numerics.compiled": (
        "kit1000.numerics",
        "kit1000.voxels",
        "kit1000.sim",
        "kit1000.kits",
        "kit1000.metrics",
        "kit1000.pictures",
        "kit1000.perception",
        "kit1000.registration",
        "baselines.kitnet.views",
        "baselines.snapnet",
        "baselines.training.tasks",
    ),
    "kit1000.generation": (
        "kit1000.generation",
        "kit1000.cli",
        "baselines.training.tasks",
    ),  # and tests, benches and the pictures of the docs
    "open3d": ("baselines.icp",),
    "libusb_package": ("baselines.icp",),
    "jinja2": ("benchmark.pages",),
    "tomllib": ("kit1000.submission.manifest",),
    "tomli": ("kit1000.submission.manifest",),
    "playwright": (),  # the tests alone
    "mcap": ("kit1000.dataset.mcap_io", "kit1000.capture.recordings"),
    "mcap_ros2": ("kit1000.capture.recordings",),
    "foxglove_schemas_protobuf": ("kit1000.dataset.mcap_io",),
    "torch": ("kit1000.dataset.torch", "kit1000.perception", "baselines"),
    "safetensors": ("kit1000.perception.networks", "baselines"),
    "viser": ("kit1000.editor",),
    "ray": ("kit1000.engines",),
    "fsspec": ("kit1000.engines",),
    "upath": ("kit1000.files",),
    "tyro": ("kit1000.cli.help_pages",),
}
NOT_ON_IMPORT = ("numpy", "scipy", "numba", "trimesh", "manifold3d", "pybullet", "open3d", "torch", "viser")

# Where a package on the index and its module differ.
IMPORT_NAMES = {
    "pillow": "PIL",
    "mcap-protobuf-support": "mcap_protobuf",
    "mcap-ros2-support": "mcap_ros2",
    "universal-pathlib": "upath",
}
USED_BY_TRIMESH = {"networkx", "lxml"}  # it reads 3MF with them

NAMED_AFTER_NOTHING = {"utils", "util", "common", "helpers", "helper", "core", "base", "manager", "misc"}
LONGEST_FILE = 400
LONGEST_FUNCTION = 80  # without its docstring

PYTHON_BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
DOCUMENTS = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")])
PAGES = sorted((ROOT / "benchmark" / "pages" / "templates").glob("*.html"))


def layer(module: str) -> int:
    """The place of a module, lowest first."""
    package, _, inside = module.partition(".")
    name = inside.partition(".")[0] if package == "kit1000" else package
    name = inside if package == "kit1000" and inside in ORDER else name  # a module apart from the rest of its package
    assert name in ORDER, f"{module} stands in no layer: give it a place in LAYERS"
    return ORDER[name]


def inside(module: str, places: tuple[str, ...]) -> bool:
    return any(module == place or module.startswith(place + ".") for place in places)


def ours(module: str) -> bool:
    return inside(module, PACKAGES)


def test_a_module_imports_only_lower_layers() -> None:
    upward = [
        f"{module} imports {target}"
        for module, path in modules().items()
        for target in sorted(filter(ours, imports(path)))
        if layer(target) > layer(module)
    ]
    assert not upward


def test_no_modules_import_each_other_in_a_circle() -> None:
    graph = {
        module: {target for target in imports(path) if target in modules() and target != module}
        for module, path in modules().items()
        if module != "kit1000"  # its imports are for type checkers and happen on demand
    }
    TopologicalSorter(graph).prepare()  # raises CycleError, which names the circle


def test_the_applications_never_import_each_other() -> None:
    for module, path in modules().items():
        others = {"benchmark", "baselines"} - {module.partition(".")[0]}
        assert not [target for target in imports(path) if target.partition(".")[0] in others], module


def test_a_method_never_imports_another_method() -> None:
    """They stand on the perception of the library."""
    methods = ("baselines.icp", "baselines.kitnet", "baselines.snapnet", "baselines.transporter")
    methods += ("baselines.controls", "kit1000.registration")
    crossing = [
        f"{module} imports {target}"
        for module, path in modules().items()
        for own in filter(lambda own: inside(module, (own,)), methods)
        for target in sorted(imports(path))
        if inside(target, tuple(set(methods) - {own}))
    ]
    assert not crossing


def test_metrics_are_pure() -> None:
    """They know values, shapes and motions, and nothing of folders, recordings or simulation."""
    pure = (*LAYERS[0], *LAYERS[1], "kits", "voxels", "metrics")
    outside = [
        f"{module} imports {target}"
        for module, path in modules().items()
        if inside(module, ("kit1000.metrics",))
        for target in sorted(filter(ours, imports(path)))
        if target.split(".")[1] not in pure and target != "kit1000.queries.motions"
    ]
    assert not outside


@pytest.mark.parametrize("package", FENCES)
def test_a_package_stays_inside_its_fence(package: str) -> None:
    outside = [
        module
        for module, path in modules().items()
        if any(inside(target, (package,)) for target in imports(path)) and not inside(module, FENCES[package])
    ]
    assert not outside


def test_importing_the_library_loads_nothing_heavy() -> None:
    ask = f"import kit1000, sys; print(*[name for name in {NOT_ON_IMPORT!r} if name in sys.modules])"
    answer = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, check=True, cwd=ROOT)
    assert answer.stdout.split() == []


@cache
def project() -> dict[str, Any]:
    return tomli.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def import_names(requirements: list[str]) -> set[str]:
    """`["manifold3d>=3.1", "pillow"]` becomes `{"manifold3d", "PIL"}`."""
    names = {re.split(r"[^A-Za-z0-9_-]", line)[0].lower() for line in requirements}
    return {IMPORT_NAMES.get(name, name.replace("-", "_")) for name in names}


def foreign(folder: str) -> set[str]:
    """Top-level names of the packages that a folder imports and that are neither ours nor Python's."""
    files = (ROOT / folder).rglob("*.py")
    names = {target.partition(".")[0] for path in files for target in imports(path)}
    return names - sys.stdlib_module_names - {*PYTHON_FOLDERS}


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_imports_only_what_is_declared(package: str) -> None:
    extras = [lines for extra, lines in project()["optional-dependencies"].items() if extra != "dev"]
    assert foreign(package) <= import_names([*project()["dependencies"], *chain.from_iterable(extras)])


def test_the_environment_of_tests_has_all_extras_but_torch() -> None:
    """And `step`, whose reader has no build for every machine."""
    extras = project()["optional-dependencies"]
    inside = re.findall(r"kit1000\[([^]]*)\]", " ".join(extras["dev"]))
    assert set(",".join(inside).split(",")) == set(extras) - {"dev", "learn", "step"}
    assert import_names(extras["learn"]) - import_names(extras["dev"]) == {"torch"}


def test_every_declared_package_is_used() -> None:
    assert import_names(project()["dependencies"]) - USED_BY_TRIMESH <= foreign("kit1000")


def test_files_are_short() -> None:
    sources = [path for path in python_files() if not path.is_relative_to(ROOT / "tests")]
    lengths = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in sources}
    assert not {dotted(path): n for path, n in lengths.items() if n > LONGEST_FILE}


def body_length(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    lines = (function.end_lineno or function.lineno) - function.lineno + 1
    if ast.get_docstring(function) is not None:
        lines -= (function.body[0].end_lineno or 0) - function.body[0].lineno + 1
    return lines


def test_functions_are_short() -> None:
    long = [
        f"{dotted(path)}.{node.name}: {body_length(node)} lines"
        for path in python_files()
        for node in statements(path)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and body_length(node) > LONGEST_FUNCTION
    ]
    assert not long


def test_every_module_says_what_it_holds() -> None:
    assert not [dotted(path) for path in python_files() if not ast.get_docstring(tree(path))]


def test_modules_are_named_after_a_thing() -> None:
    named = [path.relative_to(ROOT) for path in python_files()]
    assert not [path for path in named if NAMED_AFTER_NOTHING & {*path.with_suffix("").parts}]


def test_public_names_resolve() -> None:
    assigned = re.compile(r"^__all__\b", re.MULTILINE)
    for name, path in modules().items():
        if assigned.search(path.read_text(encoding="utf-8")):
            module = importlib.import_module(name)
            for public in module.__all__:
                assert getattr(module, public) is not None, f"{name}.{public}"


def test_type_checkers_see_the_same_public_names_as_users() -> None:
    import kit1000

    block = next(node for node in tree(ROOT / "kit1000/__init__.py").body if isinstance(node, ast.If))
    lines = [node for node in block.body if isinstance(node, ast.ImportFrom)]
    seen = [(alias.name, node.module) for node in lines for alias in node.names]
    assert sorted(name for name, _ in seen) == sorted(kit1000.__all__)
    for name, module in seen:
        assert getattr(kit1000, name) is getattr(importlib.import_module(str(module)), name)


def test_an_unknown_public_name_is_answered_with_the_known_ones() -> None:
    import kit1000

    with pytest.raises(AttributeError, match=r"has no attribute 'Kitt'; it has .*Kit"):
        kit1000.Kitt  # pyright: ignore[reportAttributeAccessIssue]


def written_files() -> list[Path]:
    return [*python_files(), *DOCUMENTS, ROOT / "Makefile", ROOT / "pyproject.toml", ROOT / ".ci/run"]


def test_nothing_is_left_open() -> None:
    left_open = re.compile("|".join(["TO" + "DO", "FIX" + "ME", "XX" + "X"]))
    assert not [path for path in written_files() if left_open.search(path.read_text(encoding="utf-8"))]


def test_no_file_names_a_place_on_someones_machine() -> None:
    place = re.compile(r"(?<![\w.~$}*/])/(work|root|home|tmp|Users)/")
    assert not [path for path in written_files() if place.search(path.read_text(encoding="utf-8"))]


def test_the_version_stands_everywhere_the_same() -> None:
    import kit1000

    assert project()["dynamic"] == ["version"]  # read from kit1000/__init__.py
    assert f"\nversion: {kit1000.__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\n## {kit1000.__version__} (" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def shown_commands(program: str) -> list[list[str]]:
    """Words of the commands that documents and pages show in code blocks, without the program's own name."""
    shown = []
    for document in [*DOCUMENTS, *PAGES]:
        blocks = re.findall(r"^```(\w*)\n(.*?)^```", document.read_text("utf-8"), re.M | re.S)
        blocks += re.findall(r"<pre[^>]*>()<code>([^{}]*?)</code>", document.read_text("utf-8"))
        typed = [block for kind, block in blocks if kind in ("", "sh", "bash", "console")]
        lines = chain.from_iterable(block.replace("\\\n", " ").splitlines() for block in typed)
        words = [shlex.split(line.removeprefix("$ "), comments=True) for line in lines]
        shown += [line[1:] for line in words if line and Path(line[0]).name == program]
    return shown


@pytest.mark.parametrize("module", PACKAGES)
def test_every_shown_command_is_one(module: str) -> None:
    commands = importlib.import_module("kit1000.cli" if module == "kit1000" else f"{module}.__main__").COMMANDS
    modules_run = [words[1:] for words in shown_commands("python") if words[:1] == ["-m"]]
    shown = [*shown_commands(module), *(words[1:] for words in modules_run if words[0] == module)]
    assert shown, f"the documents show no command of {module}"
    assert not list(filter(None, (usage_error(words, commands, module) for words in shown)))


def make_names(pattern: str) -> set[str]:
    return set(re.findall(pattern, (ROOT / "Makefile").read_text(encoding="utf-8"), re.M))


def test_every_shown_make_command_exists_with_its_variables() -> None:
    targets, variables = make_names(r"^([a-z0-9-]+):"), make_names(r"^([A-Z]+) *=")
    shown = shown_commands("make")
    assert shown, "the documents show no make command"
    for words in shown:
        assert {word for word in words if "=" not in word} <= targets, words
        assert {word.partition("=")[0] for word in words if "=" in word} <= variables, words


def test_every_script_that_the_makefile_runs_is_there() -> None:
    scripts = make_names(r"\$\(BIN\)/python (\S+\.py)")
    assert scripts
    assert not [script for script in scripts if not (ROOT / script).is_file()]


def test_every_make_target_is_explained() -> None:
    phony = set(next(iter(make_names(r"^\.PHONY: (.*)$"))).split())
    assert phony == make_names(r"^([a-z0-9-]+):.*## ")


def test_shown_python_runs(capsys: pytest.CaptureFixture[str]) -> None:
    shown = [block for document in DOCUMENTS for block in PYTHON_BLOCK.findall(document.read_text("utf-8"))]
    assert shown, "the documents show no Python"
    for block in shown:
        exec(block, {})
    assert capsys.readouterr().out


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_inside_the_repository_lead_somewhere(document: Path) -> None:
    text = document.read_text(encoding="utf-8")
    targets = re.findall(r"\]\(([^)#\s]+)[^)]*\)", text) + re.findall(r'src="([^"]+)"', text)
    local = [target for target in targets if not re.match(r"[a-z]+:", target)]
    assert not [target for target in local if not (document.parent / target).exists()]


def test_the_hosted_workflow_runs_the_same_command_on_the_oldest_and_newest_python() -> None:
    assert (ROOT / ".ci/run").stat().st_mode & 0o111
    workflow = (ROOT / ".github/workflows/ci.yml").read_text(encoding="utf-8")
    assert "      - run: .ci/run\n" in workflow
    promised = [line.rpartition(" ")[2] for line in project()["classifiers"] if re.search(r"3\.\d+$", line)]
    assert f'python: ["{promised[0]}", "{promised[-1]}"]' in workflow
