"""`python -m kit1000` runs the command `kit1000`."""

from __future__ import annotations

import gc
import sys


def main() -> int:
    """Run the command line of this process; returns the exit status.

    No garbage is collected while modules are imported, nor at the end: it would only lengthen both.
    """
    gc.disable()
    try:
        from kit1000.cli import main as command
    finally:
        gc.enable()
    try:
        return command()
    finally:
        gc.freeze()


if __name__ == "__main__":
    sys.exit(main())
