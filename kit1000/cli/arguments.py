"""The words of a command line: its first error in one line with the closest valid word, and the command they make.

A command is a dataclass whose fields are words, numbers, paths, switches, choices, or tuples of words.
"""

from __future__ import annotations

import types
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, fields
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

from kit1000.cli.options import Argument
from kit1000.errors import did_you_mean

HELP_WORDS = ("-h", "--help")
NUMBERS = {int: "a whole number", float: "a number"}


def asks_for_help(arguments: Sequence[str], commands: Mapping[str, type]) -> bool:
    """Whether words ask for the page of a program or of one of its commands."""
    name = arguments[0] if arguments else ""
    return name in HELP_WORDS or (name in commands and not set(HELP_WORDS).isdisjoint(arguments))


def usage_error(arguments: Sequence[str], commands: Mapping[str, type], program: str = "kit1000") -> str | None:
    """The first error of a command line as text, or None.

    Args:
        arguments: the words after the program.
        commands: dataclasses by name.
        program: what users type before the command.
    """
    if not arguments:
        return f"no command; there are {', '.join(commands)} (see {program} --help)"
    if asks_for_help(arguments, commands):
        return None
    name, rest = arguments[0], list(arguments[1:])
    if name not in commands:
        return f"no command {name!r}; {did_you_mean(name, commands)}there are {', '.join(commands)}"
    error = _argument_error(rest, commands[name])
    return error and f"{name}: {error} (see {program} {name} --help)"


def made_command(arguments: Sequence[str], commands: Mapping[str, type]) -> Any:
    """The command that words without an error make."""
    command = commands[arguments[0]]
    options, positional = _hints(command)
    given: dict[str, list[str]] = {}
    by_place: list[str] = []
    for group in _groups(list(arguments[1:])):
        own = _own_count(group, options)
        by_place += group.values[own:]
        if group.option is not None:
            given[group.option] = group.values[:own]
    for option, hint in positional.items():
        taken = len(by_place) if _value_count(hint) is None else min(1, len(by_place))
        if taken:
            given[option], by_place = by_place[:taken], by_place[taken:]
    hints = options | positional
    return command(**{option[2:].replace("-", "_"): _value(words, hints[option]) for option, words in given.items()})


def is_positional(hint: Any) -> bool:
    """Whether a field with a type hint is given by its place."""
    return any(isinstance(mark, Argument) and mark.positional for mark in getattr(hint, "__metadata__", ()))


class _Group(NamedTuple):
    """An option with the words after it; None with the words before any option."""

    option: str | None
    values: list[str]
    joined: bool
    """Whether the first value follows an equals sign."""


def _hints(command: type) -> tuple[dict[str, Any], dict[str, Any]]:
    """The type hints of a command's options, and of its positional arguments."""
    hints = {_option(name): hint for name, hint in get_type_hints(command, include_extras=True).items()}
    options = {option: hint for option, hint in hints.items() if not is_positional(hint)}
    return options, {option: hint for option, hint in hints.items() if option not in options}


def _argument_error(rest: list[str], command: type) -> str | None:
    """The first error in the arguments of a command."""
    options, positional = _hints(command)
    given: set[str] = set()
    by_place: list[str] = []
    for group in _groups(rest):
        if group.option is not None:
            if group.option not in options:
                return f"no option {group.option}; {did_you_mean(group.option, options)}there are {', '.join(options)}"
            error = _value_error(group, options[group.option])
            if error:
                return error
            given.add(group.option)
        by_place += group.values[_own_count(group, options) :]
    many = any(_value_count(hint) is None for hint in positional.values())
    if len(by_place) > len(positional) and not many:
        return f"unexpected argument {by_place[len(positional)]!r}"
    given |= set(list(positional)[: len(by_place)])
    required = [_option(field.name) for field in fields(command) if field.default is MISSING]
    missing = [option if option in options else option[2:].upper() for option in required if option not in given]
    return f"{' and '.join(missing)} missing" if missing else None


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _value_count(hint: Any) -> int | None:
    """Number of the words after an option that are its values; None for all of them."""
    if bool in _types(hint):
        return 0
    return None if any(get_origin(type_) is tuple for type_ in _types(hint)) else 1


def _own_count(group: _Group, options: Mapping[str, Any]) -> int:
    """Number of the words of a group that are values of its option; the others are positional."""
    if group.option is None:
        return 0
    count = _value_count(options[group.option])
    return len(group.values) if count is None else count


def _groups(rest: list[str]) -> Iterator[_Group]:
    """Each option with the words after it; first those before any option."""
    group = _Group(None, [], False)
    for word in rest:
        if word.startswith("--"):
            yield group
            head, equals, value = word.partition("=")
            group = _Group(_option(head[2:]), [value] if equals else [], bool(equals))
        elif word.startswith("-") and len(word) > 1 and not _is_number(word, float):
            yield group
            group = _Group(word, [], False)
        else:
            group.values.append(word)
    yield group


def _value_error(group: _Group, hint: Any) -> str | None:
    """The first error in the values of an option."""
    option, values = group.option, group.values
    count = _value_count(hint)
    if not values:
        return f"{option} needs a value" if count == 1 else None
    if count == 0:
        return f"{option}: takes no value, got {values[0]!r}" if group.joined else None
    for type_ in _types(hint):
        choices = get_args(type_) if get_origin(type_) is Literal else ()
        if choices and values[0] not in choices:
            return f"{option} {values[0]}: {did_you_mean(values[0], choices)}expected one of {', '.join(choices)}"
        number = get_args(type_)[0] if get_origin(type_) is tuple else type_
        wrong = [word for word in values[:count] if not _is_number(word, number)] if number in NUMBERS else []
        if wrong:
            return f"{option}: expected {NUMBERS[number]}, got {wrong[0]!r}"
    return None


def _value(words: list[str], hint: Any) -> Any:
    """The value of a field that words are given for."""
    (type_,) = (type_ for type_ in _types(hint) if type_ is not type(None))
    if type_ is bool:
        return True
    if get_origin(type_) is tuple:
        return tuple(get_args(type_)[0](word) for word in words)
    return words[-1] if get_origin(type_) is Literal else type_(words[-1])


def _types(hint: Any) -> tuple[Any, ...]:
    """The types of a type hint: the members of a union, or the type itself."""
    if get_origin(hint) is Annotated:
        return _types(get_args(hint)[0])
    return get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,)


def _is_number(word: str, type_: type) -> bool:
    try:
        type_(word)
    except ValueError:
        return False
    return True
