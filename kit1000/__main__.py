"""`python -m kit1000` runs the command `kit1000`."""

from __future__ import annotations

import sys

from kit1000.cli import main

if __name__ == "__main__":
    sys.exit(main())
