"""The process of the command `kit1000`."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

CODE = """
import os, sys
sys.argv = ["kit1000", *{words}]
from kit1000.__main__ import main
try:
    main()
except SystemExit:
    pass
import numpy
print(os.environ.get("OPENBLAS_NUM_THREADS"))
"""


@pytest.mark.parametrize(
    ("words", "given", "threads"),
    [
        (["--version"], {}, "1"),
        (["kit"], {}, "1"),
        (["kit"], {"OPENBLAS_NUM_THREADS": "3"}, "3"),
        (["predict"], {}, "None"),
    ],
)
def test_blas_has_threads_for_methods_of_users_alone(words: list[str], given: dict[str, str], threads: str) -> None:
    clean = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    done = subprocess.run(
        [sys.executable, "-c", CODE.format(words=words)], capture_output=True, text=True, check=True, env=clean | given
    )
    assert done.stdout.split()[-1] == threads
