"""Words of a command line as the fields of a command."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import pytest

from kit1000.cli.arguments import asks_for_help, made_command, usage_error
from kit1000.cli.options import Argument, OptionalInt


@dataclass(frozen=True)
class Bake:
    """Bake bread."""

    loaves: Annotated[tuple[Path, ...], Argument("LOAF", positional=True)]
    out: Path
    minutes: float = 40.0
    workers: OptionalInt = None
    flour: Literal["rye", "wheat"] = "rye"
    sides_mm: tuple[float, ...] = ()
    crisp: bool = False


@dataclass(frozen=True)
class Eat:
    """Eat one."""

    loaf: Annotated[str, Argument("LOAF", positional=True)]


COMMANDS = {"bake": Bake, "eat": Eat}
MADE = {
    "bake a b --out x": Bake((Path("a"), Path("b")), Path("x")),
    "bake --out x a": Bake((Path("a"),), Path("x")),
    "bake a --out=x --minutes 1e1 --minutes 7": Bake((Path("a"),), Path("x"), 7.0),
    "bake a --crisp b --out x --workers 2": Bake((Path("a"), Path("b")), Path("x"), workers=2, crisp=True),
    "bake a --sides_mm -1 2.5 --out x --flour wheat": Bake((Path("a"),), Path("x"), flour="wheat", sides_mm=(-1, 2.5)),
    "bake a --sides-mm --out - --minutes=-3": Bake((Path("a"),), Path("-"), -3.0),
    "eat rye": Eat("rye"),
}
WRONG = {
    "bake a --out x -v": "bake: no option -v",
    "bake a --out -v": "bake: --out needs a value",
    "bake a --out x --crisp=yes": "bake: --crisp: takes no value, got 'yes'",
    "bake a --out x --no-crisp": "bake: no option --no-crisp",
    "bake a --out x --sides-mm 1 two": "bake: --sides-mm: expected a number, got 'two'",
    "bake --out x": "bake: LOAVES missing",
    "eat a b": "eat: unexpected argument 'b'",
}


@pytest.mark.parametrize("line", MADE)
def test_words_make_the_command(line: str) -> None:
    assert usage_error(line.split(), COMMANDS) is None
    assert made_command(line.split(), COMMANDS) == MADE[line]


@pytest.mark.parametrize("line", WRONG)
def test_the_first_error_is_told(line: str) -> None:
    assert (usage_error(line.split(), COMMANDS) or "").startswith(WRONG[line])


@pytest.mark.parametrize("line", ["-h", "--help", "bake --help", "bake a -h"])
def test_help_may_stand_anywhere_in_a_command(line: str) -> None:
    assert asks_for_help(line.split(), COMMANDS)
    assert usage_error(line.split(), COMMANDS) is None
    assert not asks_for_help(["eat", "help"], COMMANDS)
