"""The dataset of a benchmark: the given one, or a tiny one."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from kit1000.dataset.reader import Dataset
from kit1000.generation.build import generate
from kit1000.generation.presets import preset


@contextmanager
def measured_dataset(folder: Path | None) -> Iterator[tuple[Dataset, Path]]:
    """The dataset of a folder, a new tiny one when None, and a temporary folder that is deleted afterwards."""
    with tempfile.TemporaryDirectory() as temporary:
        if folder is None:
            folder = Path(temporary) / "tiny"
            generate(preset("tiny"), folder, workers=1)
        yield Dataset(folder), Path(temporary)
