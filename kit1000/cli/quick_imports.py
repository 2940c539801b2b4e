"""Import of scipy without the tools of numpy that it drags in and nobody uses: a third of a second of every command.

scipy copies all public names of numpy, by which numpy loads its compiler of Fortran and its helpers of tests.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType

UNUSED = ("f2py", "testing")  # modules of numpy


def import_scipy() -> None:
    """Import scipy's geometry with empty modules in place of the unused ones, which later imports load as usual."""
    numpy = import_module("numpy")
    absent = [name for name in UNUSED if f"numpy.{name}" not in sys.modules]
    for name in absent:
        sys.modules[f"numpy.{name}"] = ModuleType(f"numpy.{name}")
        setattr(numpy, name, sys.modules[f"numpy.{name}"])
    try:
        import_module("scipy.spatial")
    finally:
        for name in absent:
            del sys.modules[f"numpy.{name}"]
            delattr(numpy, name)
