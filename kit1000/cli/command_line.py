"""Runs a command line of subcommands, and reports wrong usage in one line with the closest valid word.

Results go to stdout, progress and error messages to stderr. Exit status: 0 success, 1 a check found faults, 2 wrong
usage or invalid input, 3 a bug of the package, 130 interrupted.
"""

from __future__ import annotations

import os
import sys
import types
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, fields
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import tyro

from kit1000.cli.output import checked_output, system_fault
from kit1000.errors import InternalError, Kit1000Error, did_you_mean, internal_error, shown
from kit1000.interrupts import terminated_as_interrupted

USAGE_ERROR, INTERNAL_ERROR = 2, 3  # exit status: wrong usage or invalid input, bug of the package
INTERRUPTED = 130  # exit status of a command stopped by Ctrl-C, as in shells
VERSION_WORDS = (["--version"], ["-V"])
NUMBERS = {int: "a whole number", float: "a number"}
POSITIONAL = get_args(tyro.conf.Positional[str])[1]  # marks a field that is a positional argument


def run(
    program: str,
    commands: Mapping[str, type],
    about: str,
    arguments: Sequence[str] | None = None,
    version: str | None = None,
) -> int:
    """Run a command line; returns the exit status.

    Args:
        program: what users type before the command, such as kit1000.
        commands: dataclasses by name, whose fields are options and whose method `run` returns the exit status.
        about: the first lines of --help.
        arguments: the words after the program; those of this process when None.
        version: what --version prints after the program; no such option when None.
    """
    words = [_without_tilde(word) for word in (sys.argv[1:] if arguments is None else arguments)]
    fault = system_fault()
    if fault:
        return _print_error(program, fault, USAGE_ERROR)
    error = None if version and words in VERSION_WORDS else usage_error(words, commands, program)
    if error:
        return _print_error(program, error, USAGE_ERROR)
    try:
        with checked_output(), terminated_as_interrupted():  # SIGTERM ends workers and releases locks as Ctrl-C does
            if version and words in VERSION_WORDS:
                print(f"{program} {version}")
                return 0
            command = tyro.extras.subcommand_cli_from_dict(dict(commands), prog=program, description=about, args=words)
            return _status(command, words[0])
    except Kit1000Error as error:
        return _print_error(program, str(error), INTERNAL_ERROR if isinstance(error, InternalError) else USAGE_ERROR)
    except KeyboardInterrupt:
        return _print_error(program, "interrupted; run the same command again to continue", INTERRUPTED)
    except BrokenPipeError:  # the reader of the results has closed its end
        return 0
    except Exception as error:
        return _print_error(program, str(internal_error(words[0], error)), INTERNAL_ERROR)


def _status(command: Any, name: str) -> int:
    """Run a command; returns its exit status. No code that it calls ends the process instead."""
    try:
        return command.run()
    except SystemExit as error:
        raise internal_error(name, error) from error


def _without_tilde(word: str) -> str:
    """A word with the home folder in place of ~ where the shell left it, as in --out=~/x."""
    option, equals, value = word.partition("=") if word.startswith("--") else ("", "", word)
    if not value.startswith("~") or os.path.lexists(value):
        return word
    return option + equals + os.path.expanduser(value)


def _print_error(program: str, line: str, status: int) -> int:
    print(f"{program}: {shown(line)}", file=sys.stderr)
    return status


def usage_error(arguments: Sequence[str], commands: Mapping[str, type], program: str = "kit1000") -> str | None:
    """The first error of a command line as text, or None; the arguments as in `run`."""
    if not arguments:
        return f"no command; there are {', '.join(commands)} (see {program} --help)"
    name, rest = arguments[0], list(arguments[1:])
    if name in ("-h", "--help") or (name in commands and not {"-h", "--help"}.isdisjoint(rest)):
        return None
    if name not in commands:
        return f"no command {name!r}; {did_you_mean(name, commands)}there are {', '.join(commands)}"
    error = _argument_error(rest, commands[name])
    return error and f"{name}: {error} (see {program} {name} --help)"


def _argument_error(rest: list[str], command: type) -> str | None:
    """The first error in the arguments of a command."""
    hints = {_option(name): hint for name, hint in get_type_hints(command, include_extras=True).items()}
    options = {option: hint for option, hint in hints.items() if POSITIONAL not in getattr(hint, "__metadata__", ())}
    options |= {f"--no-{option[2:]}": hint for option, hint in options.items() if hint is bool}
    positional = [option for option in hints if option not in options]
    given: set[str | None] = set()
    positional_words: list[str] = []
    for option, values in _grouped(rest):
        if option is not None and option not in options:
            return f"no option {option}; {did_you_mean(option, options)}there are {', '.join(options)}"
        error = option and _value_error(option, values, options[option])
        if error:
            return error
        given.add(option)
        own = _value_count(options[option]) if option else 0
        positional_words += [] if own is None else values[own:]
    many = bool(positional) and _value_count(hints[positional[-1]]) is None
    if len(positional_words) > len(positional) and not many:
        return f"unexpected argument {positional_words[len(positional)]!r}"
    given |= set(positional[: len(positional_words)])
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


def _grouped(rest: list[str]) -> Iterator[tuple[str | None, list[str]]]:
    """Each option with the words after it; first None with the words before any option."""
    option, values = None, []
    for word in rest:
        if word.startswith("--"):
            yield option, values
            head, equals, value = word.partition("=")
            option, values = _option(head[2:]), [value] if equals else []
        else:
            values.append(word)
    yield option, values


def _value_error(option: str, values: list[str], hint: Any) -> str | None:
    """The first error in the values of an option."""
    if not values:
        return f"{option} needs a value" if _value_count(hint) == 1 else None
    for type_ in _types(hint):
        choices = get_args(type_) if get_origin(type_) is Literal else ()
        if choices and values[0] not in choices:
            return f"{option} {values[0]}: {did_you_mean(values[0], choices)}expected one of {', '.join(choices)}"
        if type_ in NUMBERS and not _is_number(values[0], type_):
            return f"{option}: expected {NUMBERS[type_]}, got {values[0]!r}"
    return None


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
