"""Quick imports for a command that ends soon: most of its time would go into packages that it does not use.

Of scipy a kit needs convex hulls, which are one compiled module. All that scipy imports around it takes a third of a
second, and so does the search for garbage among the objects that imports make.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

STAND_INS = ("scipy.linalg", "scipy.spatial")
HULLS = "scipy.spatial._qhull"


class _StandIn(ModuleType):
    """A package of which its hulls alone are there."""

    def __getattr__(self, name: str) -> Any:
        if not name.startswith("__") and HULLS.startswith(self.__name__):
            return getattr(import_module(HULLS), name)
        raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")


@contextmanager
def quick_imports() -> Iterator[None]:
    """Import in the block with stand-ins for packages of scipy, which later imports load as usual, and no collection.

    What is imported in the block may use of these packages their hulls.
    """
    collects = gc.isenabled()
    gc.disable()
    absent = [name for name in STAND_INS if name not in sys.modules]
    folder = Path(import_module("scipy").__path__[0])
    for name in absent:
        sys.modules[name] = stand_in = _StandIn(name)
        stand_in.__path__ = [str(folder.joinpath(*name.split(".")[1:]))]
    try:
        yield
    finally:
        for name in absent:
            del sys.modules[name]
        gc.freeze()  # modules stay until the command ends
        if collects:
            gc.enable()
