"""The command `kit1000`: each subcommand is a typed dataclass whose fields are its options.

Results go to stdout, progress and error messages to stderr. Exit status: 0 success, 1 a check found faults, 2 wrong
usage or invalid input, 3 a bug of kit1000, 130 interrupted.
"""

from __future__ import annotations

from collections.abc import Sequence

from kit1000.cli.capture import ImportImages
from kit1000.cli.command_line import run
from kit1000.cli.datasets import Check, Export, Generate, Info, Show, Verify
from kit1000.cli.labels import Join, Label
from kit1000.cli.own_kits import MakeKit
from kit1000.cli.scenes import Edit, Predict, Run, Study
from kit1000.version import __version__

ABOUT = """KIT1000: parts, kits that fit them, angled assemblies of kits, and depth scenes for learning kit assembly.

`kit1000 COMMAND --help` describes a command, `kit1000 --version` prints the version.

Results go to stdout, progress and error messages to stderr. Exit status: 0 success, 1 a check found faults,
2 wrong usage or invalid input, 3 a bug of kit1000, 130 interrupted."""


COMMANDS = {
    "generate": Generate,
    "kit": MakeKit,
    "info": Info,
    "show": Show,
    "verify": Verify,
    "export": Export,
    "check": Check,
    "import": ImportImages,
    "edit": Edit,
    "label": Label,
    "join": Join,
    "predict": Predict,
    "run": Run,
    "study": Study,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line, that of this process when None; returns the exit status."""
    return run("kit1000", COMMANDS, ABOUT, arguments, __version__)
