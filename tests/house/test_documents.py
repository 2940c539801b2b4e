"""Rules of the documents: what they show works, what they name exists, and they are short enough to be read."""

from __future__ import annotations

import importlib
import re
import shlex
from functools import cache
from itertools import chain
from pathlib import Path

import pytest

from benchmark.documents import filled
from benchmark.entries import Entry, read_entries
from benchmark.measurements import read_measurement
from kit1000.cli.command_line import parse
from tests.samples.checkout import ROOT
from tests.samples.sources import DOCUMENTS, PACKAGES, modules

WORDS = 38_000
"""Most words of all documents together, tables included."""
WORDS_OF_A_PAGE = 1500
PAGES = sorted((ROOT / "benchmark/pages/templates").glob("*.html"))
DOTTED = re.compile(rf"(?<![\w/.-])(?:{'|'.join(PACKAGES)})(?:\.[A-Za-z_]\w*)+")
NO_NAMES = re.compile(r"^kit1000\.SceneTruth$|\.(md|html|json|toml|py|yml|mcap)$")  # a message's schema, files
a_document = pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.relative_to(ROOT).as_posix())


def words(path: Path) -> int:
    return len(path.read_text(encoding="utf-8").split())


def test_the_documents_keep_their_budget() -> None:
    assert sum(map(words, DOCUMENTS)) <= WORDS
    described = [path for path in DOCUMENTS if path.parent.name != "results"]
    assert not {path.name: words(path) for path in described if words(path) > WORDS_OF_A_PAGE}


def shown_commands(program: str) -> list[list[str]]:
    """The words of the commands that documents and pages show in code blocks, without the program's own name."""
    shown = []
    for document in [*DOCUMENTS, *PAGES]:
        text = document.read_text("utf-8")
        blocks = re.findall(r"^```(\w*)\n(.*?)^```", text, re.M | re.S)
        blocks += re.findall(r"<pre[^>]*>()<code>([^{}]*?)</code>", text)
        shell = [block for kind, block in blocks if kind in ("", "sh", "bash", "console")]
        lines = chain.from_iterable(block.replace("\\\n", " ").splitlines() for block in shell)
        typed = [shlex.split(line.removeprefix("$ "), comments=True) for line in lines]
        shown += [line[1:] for line in typed if line and Path(line[0]).name == program]
    return shown


@pytest.mark.parametrize("module", PACKAGES)
def test_every_shown_command_is_one(module: str) -> None:
    commands = importlib.import_module("kit1000.cli" if module == "kit1000" else f"{module}.__main__").COMMANDS
    modules_run = [words[1:] for words in shown_commands("python") if words[:1] == ["-m"]]
    shown = [*shown_commands(module), *(words[1:] for words in modules_run if words[0] == module)]
    assert shown, f"the documents show no command of {module}"
    for words in shown:
        parse(module, commands, "", words)  # raises InputError, which names the words


def make_names(pattern: str) -> set[str]:
    return set(re.findall(pattern, (ROOT / "Makefile").read_text(encoding="utf-8"), re.M))


def test_every_shown_make_command_exists_with_its_variables() -> None:
    targets, variables = make_names(r"^([a-z0-9-]+):"), make_names(r"^([A-Z]+) *=")
    shown = shown_commands("make")
    assert shown, "the documents show no make command"
    for typed in shown:
        assert {word for word in typed if "=" not in word} <= targets, typed
        assert {word.partition("=")[0] for word in typed if "=" in word} <= variables, typed


def test_the_makefile_explains_each_target_and_runs_scripts_that_exist() -> None:
    phony = set(next(iter(make_names(r"^\.PHONY: (.*)$"))).split())
    assert phony == make_names(r"^([a-z0-9-]+):.*## ")
    assert not [script for script in make_names(r"\$\(BIN\)/python (\S+\.py)") if not (ROOT / script).is_file()]


def test_shown_python_runs(capsys: pytest.CaptureFixture[str]) -> None:
    shown = [re.findall(r"^```python\n(.*?)^```", path.read_text("utf-8"), re.M | re.S) for path in DOCUMENTS]
    for block in chain.from_iterable(shown):
        exec(block, {})
    assert capsys.readouterr().out


@pytest.mark.parametrize("name", ["README.md", "CONTRIBUTING.md"])
def test_links_of_files_outside_the_site_lead_somewhere(name: str) -> None:
    """`mkdocs build --strict` checks the links of the others."""
    text = (ROOT / name).read_text(encoding="utf-8")
    targets = re.findall(r"\]\(([^)#\s]+)[^)]*\)", text) + re.findall(r'src="([^"]+)"', text)
    local = [target for target in targets if not re.match(r"[a-z]+:", target)]
    assert local
    assert not [target for target in local if not (ROOT / target).exists()]


def resolves(name: str) -> bool:
    """Whether a dotted name is a module of ours, a name in one, or an attribute of a class in one."""
    parts = name.split(".")
    depth = next((depth for depth in range(len(parts), 0, -1) if ".".join(parts[:depth]) in modules()), 0)
    found = importlib.import_module(".".join(parts[:depth])) if depth else None
    for part in parts[depth:]:
        if part in getattr(found, "__annotations__", ()):
            return True
        found = getattr(found, part, None)
    return found is not None


def unresolved(text: str) -> set[str]:
    return {name for name in DOTTED.findall(text) if not NO_NAMES.search(name) and not resolves(name)}


def test_dotted_names_in_the_code_resolve() -> None:
    quoted = {path: re.findall(r"`[^`\n]+`", path.read_text(encoding="utf-8")) for path in modules().values()}
    assert not {path: names for path, found in quoted.items() if (names := unresolved("\n".join(found)))}


@a_document
def test_dotted_names_on_a_page_resolve(path: Path) -> None:
    assert not unresolved(path.read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("name", "known"),
    [
        ("kit1000.kits", True),
        ("kit1000.pose.Pose.inverse", True),
        ("kit1000.values.View.depth", True),
        ("kit1000.pose.Pose.invert", False),
        ("kit1000.poses", False),
    ],
)
def test_a_wrong_dotted_name_is_noticed(name: str, known: bool) -> None:
    assert unresolved(f"See `{name}`.") == (set() if known else {name})


@cache
def submissions() -> tuple[Entry, ...]:
    return read_entries(ROOT / "submissions")


@a_document
def test_tables_of_a_page_are_those_of_the_results(path: Path) -> None:
    assert filled(path, ROOT / "results", submissions()) == path.read_text("utf-8"), "make results"


def test_every_result_names_the_commit_that_measured_it() -> None:
    for path in sorted((ROOT / "results").glob("*.json")):
        assert not read_measurement(path).setting["commit"].startswith("unknown"), path.name
