"""Running a command line of subcommands, and what is wrong with it, in one line that names the near word.

Results go to stdout, progress to stderr. Exit 0 good, 1 the answer is no, 2 wrong usage or bad input with one line,
3 a fault of the package, 130 interrupted.
"""

from __future__ import annotations

import os
import signal
import sys
import types
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, fields
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import tyro

from kit1000.errors import InternalError, Kit1000Error, internal_error, did_you_mean

WRONG, FAULTY = 2, 3  # exit status: of the user, of the package
INTERRUPTED = 130  # exit status of a command stopped by Ctrl-C, as shells have it
NUMBERS = {int: "a whole number", float: "a number"}
POSITIONAL = get_args(tyro.conf.Positional[str])[1]  # what marks a field that is no option


def run(program: str, commands: Mapping[str, type], about: str, arguments: Sequence[str] | None = None) -> int:
    """Run a command line; returns the exit status.

    Args:
        program: what users type before the command, such as kit1000.
        commands: dataclasses by name, whose fields are options and whose method `run` gives the exit status.
        about: what --help begins with.
        arguments: the words behind the program; those of this process when absent.
    """
    words = sys.argv[1:] if arguments is None else list(arguments)
    said = misuse(words, commands, program)
    if said:
        return _answer(program, said, WRONG)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # workers and locks go down in order
    command = tyro.extras.subcommand_cli_from_dict(dict(commands), prog=program, description=about, args=words)
    try:
        status = command.run()
        sys.stdout.flush()
        return status
    except Kit1000Error as error:
        return _answer(program, str(error), FAULTY if isinstance(error, InternalError) else WRONG)
    except KeyboardInterrupt:
        return _answer(program, "interrupted; run the same command again to continue", INTERRUPTED)
    except BrokenPipeError:  # whoever read the results has had enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        return _answer(program, str(internal_error(words[0], error)), FAULTY)


def _answer(program: str, line: str, status: int) -> int:
    print(f"{program}: {line}", file=sys.stderr)
    return status


def misuse(arguments: Sequence[str], commands: Mapping[str, type], program: str = "kit1000") -> str | None:
    """The first fault of a command line, or None; commands: dataclasses by name; program: what stands before them."""
    if not arguments:
        return f"no command; there are {', '.join(commands)} ({program} --help says more)"
    name, rest = arguments[0], list(arguments[1:])
    if name in ("-h", "--help") or (name in commands and not {"-h", "--help"}.isdisjoint(rest)):
        return None
    if name not in commands:
        return f"no command {name!r}; {did_you_mean(name, commands)}there are {', '.join(commands)}"
    said = _misused(rest, commands[name])
    return said and f"{name}: {said} ({program} {name} --help says more)"


def _misused(rest: list[str], command: type) -> str | None:
    """The first fault behind the name of a command."""
    hints = {_option(name): hint for name, hint in get_type_hints(command, include_extras=True).items()}
    options = {option: hint for option, hint in hints.items() if POSITIONAL not in getattr(hint, "__metadata__", ())}
    options |= {f"--no-{option[2:]}": hint for option, hint in options.items() if hint is bool}
    positional = [option for option in hints if option not in options]
    given: set[str | None] = set()
    spare: list[str] = []
    for option, values in _grouped(rest):
        if option is not None and option not in options:
            return f"no option {option}; {did_you_mean(option, options)}there are {', '.join(options)}"
        said = option and _misfit(option, values, options[option])
        if said:
            return said
        given.add(option)
        own = _taken(options[option]) if option else 0
        spare += [] if own is None else values[own:]
    many = bool(positional) and _taken(hints[positional[-1]]) is None
    if len(spare) > len(positional) and not many:
        return f"{spare[len(positional)]!r} is one word too many"
    given |= set(positional[: len(spare)])
    missing = [_option(field.name) for field in fields(command) if field.default is MISSING]
    said = [option if option in options else option[2:].upper() for option in missing if option not in given]
    return f"{' and '.join(said)} missing" if said else None


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _taken(hint: Any) -> int | None:
    """How many of the words behind an option are its own; None for all of them."""
    if bool in _kinds(hint):
        return 0
    return None if any(get_origin(kind) is tuple for kind in _kinds(hint)) else 1


def _grouped(rest: list[str]) -> Iterator[tuple[str | None, list[str]]]:
    """Each option with the words behind it, first of all the words before any option."""
    option, values = None, []
    for word in rest:
        if word.startswith("--"):
            yield option, values
            head, equals, value = word.partition("=")
            option, values = _option(head[2:]), [value] if equals else []
        else:
            values.append(word)
    yield option, values


def _misfit(option: str, values: list[str], hint: Any) -> str | None:
    """What is wrong with the values of an option."""
    if not values:
        return f"{option} wants a value" if _taken(hint) == 1 else None
    for kind in _kinds(hint):
        choices = get_args(kind) if get_origin(kind) is Literal else ()
        if choices and values[0] not in choices:
            return f"{option} {values[0]}: {did_you_mean(values[0], choices)}expected one of {', '.join(choices)}"
        if kind in NUMBERS and not _is_number(values[0], kind):
            return f"{option}: expected {NUMBERS[kind]}, got {values[0]!r}"
    return None


def _kinds(hint: Any) -> tuple[Any, ...]:
    """The types that an option may have."""
    if get_origin(hint) is Annotated:
        return _kinds(get_args(hint)[0])
    return get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,)


def _is_number(word: str, kind: type) -> bool:
    try:
        kind(word)
    except ValueError:
        return False
    return True
