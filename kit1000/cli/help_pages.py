"""The page that --help prints, by tyro: it reads the docstrings of a command and of its fields."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from inspect import get_annotations
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import tyro

from kit1000.cli.options import Argument


def print_help(program: str, commands: Mapping[str, type], about: str, words: Sequence[str]) -> None:
    """Print the page that words with -h or --help ask for; raises SystemExit(0), as tyro does."""
    owners = {owner for command in commands.values() for owner in command.__mro__[:-1]}
    before = {owner: get_annotations(owner) for owner in owners}
    hints = {owner: get_type_hints(owner, include_extras=True) for owner in owners}
    try:
        for owner in owners:  # what a class inherits is annotated in the class that has it
            owner.__annotations__ = {name: _annotated(hints[owner][name]) for name in before[owner]}
        tyro.extras.subcommand_cli_from_dict(dict(commands), prog=program, description=about, args=words)
    finally:
        for owner in owners:
            owner.__annotations__ = before[owner]


def _annotated(hint: Any) -> Any:
    if hint is bool:
        return Annotated[bool, tyro.conf.FlagCreatePairsOff]  # a switch has no opposite
    if get_origin(hint) is not Annotated:
        return hint
    plain, *extras = get_args(hint)
    for extra in extras:
        for mark in _marks(extra) if isinstance(extra, Argument) else [extra]:
            plain = Annotated[plain, mark]
    return plain


def _marks(argument: Argument) -> Iterator[Any]:
    yield tyro.conf.arg(metavar=argument.metavar)
    if argument.positional:
        yield get_args(tyro.conf.Positional[str])[1]
