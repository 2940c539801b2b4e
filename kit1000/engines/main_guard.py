"""Whether the running script may start processes: each of them imports the script again, as its main module."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

from kit1000.errors import InputError


def check_main_guard() -> None:
    """Raise InputError when processes started now would run the whole script again, because it lacks a guard."""
    main = sys.modules.get("__main__")
    place = getattr(main, "__file__", None)
    if place is None or not str(place).endswith(".py"):  # a prompt, a notebook, a command
        return
    try:
        tree = ast.parse(Path(place).read_bytes())
    except (OSError, SyntaxError, ValueError):
        return
    if not any(isinstance(node, ast.Name) and node.id == "__name__" for node in ast.walk(tree)):
        raise InputError(
            f'{place}: starts processes, which run this script again: put the call below `if __name__ == "__main__":`, '
            "or ask for workers=1"
        )
