"""Imports of the command `kit1000 kit`."""

from __future__ import annotations

import subprocess
import sys

from kit1000.cli.quick_imports import STAND_INS, quick_imports

MAKER = f"from {quick_imports.__module__} import quick_imports\n"
MAKER += "with quick_imports():\n    import kit1000.export.own_part\n"


def output_of(code: str) -> str:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


def test_kits_need_no_package_of_scipy() -> None:
    assert output_of(MAKER + f"import sys; print(sorted({set(STAND_INS)} & set(sys.modules)))") == "[]"


def test_hulls_are_those_of_scipy() -> None:
    code = "import kit1000.mesh, scipy.spatial; print(kit1000.mesh.ConvexHull is scipy.spatial.ConvexHull)"
    assert output_of(MAKER + code) == "True"


def test_packages_are_whole_when_they_are_imported_later() -> None:
    code = "import scipy.spatial, scipy.linalg, scipy.interpolate, scipy.optimize\n"
    code += "tree = scipy.spatial.KDTree([[0.0], [1.0]])\n"
    code += "print(tree.query([0.9])[1], scipy.linalg.LinAlgError.__name__)"
    assert output_of(MAKER + code) == "1 LinAlgError"


def test_packages_that_are_loaded_already_stay() -> None:
    code = "import scipy.spatial as before\n" + MAKER + "import scipy.spatial; print(scipy.spatial is before)"
    assert output_of(code) == "True"


def test_garbage_is_collected_after_the_imports() -> None:
    assert output_of(MAKER + "import gc; print(gc.isenabled(), gc.get_freeze_count() > 0)") == "True True"
