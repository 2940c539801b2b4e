"""`python -m kit1000` runs the command `kit1000`."""

from __future__ import annotations

import os
import sys

OF_USERS = ("predict", "edit")  # commands that may run a method of the user, which may want BLAS on all cores


def main() -> int:
    """Run the command line of this process; returns the exit status.

    The threads that OpenBLAS starts on import, one a core, wait busily for work that most commands do not have.
    """
    if not set(OF_USERS) & set(sys.argv[1:2]):
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from kit1000.cli import main as command

    return command()


if __name__ == "__main__":
    sys.exit(main())
