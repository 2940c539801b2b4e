"""Imports of the command `kit1000 kit`."""

from __future__ import annotations

import subprocess
import sys

from kit1000.cli.quick_imports import UNUSED, import_scipy


def output_of(code: str) -> str:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


def test_geometry_of_scipy_needs_no_tools_of_numpy() -> None:
    unused = {f"numpy.{name}" for name in UNUSED}
    code = f"import sys; from {import_scipy.__module__} import import_scipy; import_scipy()"
    code += f"; import kit1000.export.own_part; print(sorted({unused} & set(sys.modules)))"
    assert output_of(code) == "[]"


def test_tools_of_numpy_are_whole_when_they_are_imported_later() -> None:
    code = "from kit1000.cli.quick_imports import import_scipy; import_scipy(); import numpy, numpy.testing"
    code += "; numpy.testing.assert_allclose(1, 1); print(numpy.f2py.__name__, hasattr(numpy.f2py, 'crackfortran'))"
    assert output_of(code) == "numpy.f2py True"


def test_tools_that_are_loaded_already_stay() -> None:
    code = "import numpy.testing as before; from kit1000.cli.quick_imports import import_scipy; import_scipy()"
    code += "; import numpy; print(numpy.testing is before, hasattr(before, 'assert_allclose'))"
    assert output_of(code) == "True True"
