"""`python -m kit1000` runs the command `kit1000`."""

from __future__ import annotations

import gc
import os
import sys

OF_USERS = ("predict", "edit")  # commands that may run a method of the user, which may want BLAS on all cores


def main() -> int:
    """Run the command line of this process; returns the exit status.

    No garbage is collected while modules are imported, nor at the end: it would only lengthen both. The threads that
    OpenBLAS starts on import, one a core, wait busily for work that these commands do not have.
    """
    if not set(OF_USERS) & set(sys.argv[1:2]):
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
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
