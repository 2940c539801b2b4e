"""The page that --help prints."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from typing import Annotated

import pytest

from kit1000.cli.arguments import made_command
from kit1000.cli.help_pages import print_help
from kit1000.cli.options import Argument


@dataclass(frozen=True)
class Oven:
    """An oven."""

    hot: bool = False
    """Whether it is hot."""


@dataclass(frozen=True)
class Bake(Oven):
    """Bake bread."""

    loaf: Annotated[str, Argument("LOAF", positional=True)] = "rye"
    """What to bake."""


COMMANDS = {"bake": Bake, "heat": Oven}


def test_a_page_shows_own_and_inherited_fields(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        print_help("baker", COMMANDS, "A baker.", ["bake", "--help"])
    assert caught.value.code == 0
    page = capsys.readouterr().out
    assert all(word in page for word in ("LOAF", "--hot", "Whether it is hot."))
    assert "--no-hot" not in page


def test_a_page_changes_no_command(capsys: pytest.CaptureFixture[str]) -> None:
    before = Bake.__annotations__
    with pytest.raises(SystemExit):
        print_help("baker", COMMANDS, "A baker.", ["--help"])
    assert "A baker." in capsys.readouterr().out
    assert Bake.__annotations__ == before
    assert made_command(["bake", "oat", "--hot"], COMMANDS) == Bake(hot=True, loaf="oat")


def test_other_words_need_no_page() -> None:
    code = "import sys; from kit1000.cli import main; main(['info', 'nowhere']); print('tyro' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
