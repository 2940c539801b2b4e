"""Runs a command line of subcommands, each of which is a dataclass that tyro fills from the words.

Results go to stdout, progress and error messages to stderr. Exit status: 0 success, 1 a check found faults, 2 wrong
usage or invalid input, 3 a bug of the package, 130 interrupted.
"""

from __future__ import annotations

import errno
import io
import os
import re
import sys
from collections.abc import Mapping, Sequence
from contextlib import redirect_stderr, suppress
from dataclasses import MISSING, fields
from typing import Any

import tyro

from kit1000.errors import InputError, InternalError, Kit1000Error, did_you_mean, internal_error, shown
from kit1000.interrupts import terminated_as_interrupted

USAGE_ERROR, INTERNAL_ERROR = 2, 3  # exit status: wrong usage or invalid input, bug of the package
INTERRUPTED = 130  # exit status of a command stopped by Ctrl-C, as in shells
VERSION_WORDS = (["--version"], ["-V"])
DISK_FULL = (errno.ENOSPC, errno.EDQUOT)

COLOUR = re.compile(r"\x1b\[[\d;]*m")
BOX_ROW = re.compile(r"^[│ ] (.*?) *│?$", re.MULTILINE)  # a row of tyro's box; an ASCII stream gets no borders
RULE = re.compile(r" ?[─-]{9,} ?")  # a horizontal line in that box
ADVICE = re.compile(r"For full helptext|Argument helptext|Got errors")  # what follows is also on the page of --help


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
    _prepare_streams()
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        with terminated_as_interrupted():  # SIGTERM ends workers and releases locks as Ctrl-C does
            if sys.stdout is None:
                raise InputError("standard output is closed: redirect it to a file or to /dev/null")
            if version and words in VERSION_WORDS:
                print(f"{program} {version}")
                status = 0
            else:
                command = parse(program, commands, about, words)
                status = 0 if command is None else _run(command, words[0])
            sys.stdout.flush()
            return status
    except Kit1000Error as error:
        return _print_error(program, str(error), INTERNAL_ERROR if isinstance(error, InternalError) else USAGE_ERROR)
    except KeyboardInterrupt:
        return _print_error(program, "interrupted; run the same command again to continue", INTERRUPTED)
    except BrokenPipeError:  # the reader of the results has closed its end
        _discard_output()
        return 0
    except Exception as error:
        if isinstance(error, OSError) and error.errno in DISK_FULL:
            _discard_output()
            return _print_error(program, f"cannot write the results: {error.strerror}", USAGE_ERROR)
        return _print_error(program, str(internal_error(words[0], error)), INTERNAL_ERROR)


def parse(program: str, commands: Mapping[str, type], about: str, words: Sequence[str]) -> Any:
    """The command that words describe; None after a page of --help, which is printed. Arguments as of `run`.

    Raises InputError when the words are no valid command line; the message is one line.
    """
    name = words[0] if words else ""
    if name not in commands and words and not name.startswith("-"):
        raise InputError(f"no command {name!r}; {did_you_mean(name, commands)}there are {', '.join(commands)}")
    page = f"{program} {name}" if name in commands else program
    box = io.StringIO()
    options: dict[str, Any] = {"prog": page, "config": (tyro.conf.FlagCreatePairsOff,)}  # a switch has no opposite
    try:
        with redirect_stderr(box):
            if name in commands:
                return _not_empty(tyro.cli(commands[name], args=words[1:], **options))
            parser = tyro.extras.subcommand_cli_from_dict
            return parser(dict(commands), description=about, args=words, **options)
    except SystemExit as end:
        if not end.code:
            return None
    raise InputError(f"{_error_in(box.getvalue())} (see {page} --help)")


def _not_empty(command: Any) -> Any:
    """A command whose required lists have a value: tyro takes no word for an empty list."""
    for field in fields(command):
        if field.default is MISSING and getattr(command, field.name) == ():
            raise InputError(f"{field.name.upper()}: expected one or more")
    return command


def check_least(**options: tuple[int | None, int]) -> None:
    """Raise InputError when the value of an option is less than the least that it may be, by name."""
    for name, (value, least) in options.items():
        if value is not None and value < least:
            raise InputError(f"--{name}: expected {least} or more, got {value}")


def _error_in(box: str) -> str:
    """The error that tyro reports in a box, in one line and without the help texts of options."""
    rows = [row for row in BOX_ROW.findall(COLOUR.sub("", box)) if not row.startswith(8 * " ")]
    text = ADVICE.split(" ".join(row.strip() for row in rows))[0]
    return RULE.sub("; ", text).strip(" ;.")


def _run(command: Any, name: str) -> int:
    """Run a command; returns its exit status. Code that it calls cannot end the process instead."""
    try:
        return command.run()
    except SystemExit as error:
        raise internal_error(name, error) from error


def _prepare_streams() -> None:
    """Print characters that an encoding lacks as escapes; messages for a closed stderr go nowhere."""
    if sys.stderr is None:  # else they would be printed among the results
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 (until the process ends)
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, ValueError):
            stream.reconfigure(errors="backslashreplace")  # pyright: ignore[reportAttributeAccessIssue]


def _discard_output() -> None:
    """Throw away results that cannot be written, or Python would complain about them when it ends."""
    with suppress(OSError, ValueError, AttributeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _print_error(program: str, line: str, status: int) -> int:
    print(f"{program}: {shown(line)}", file=sys.stderr)
    return status
