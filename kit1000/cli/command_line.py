"""Runs a command line of subcommands, each of which is a dataclass.

Results go to stdout, progress and error messages to stderr. Exit status: 0 success, 1 a check found faults, 2 wrong
usage or invalid input, 3 a bug of the package, 130 interrupted.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from typing import Any

from kit1000.cli.arguments import asks_for_help, made_command, usage_error
from kit1000.cli.output import checked_output, system_fault
from kit1000.errors import InternalError, Kit1000Error, internal_error, shown
from kit1000.interrupts import terminated_as_interrupted

USAGE_ERROR, INTERNAL_ERROR = 2, 3  # exit status: wrong usage or invalid input, bug of the package
INTERRUPTED = 130  # exit status of a command stopped by Ctrl-C, as in shells
VERSION_WORDS = (["--version"], ["-V"])


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
            if asks_for_help(words, commands):
                from kit1000.cli.help_pages import print_help  # only here: it takes longer than most commands to start

                print_help(program, commands, about, words)
            return _status(made_command(words, commands), words[0])
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
