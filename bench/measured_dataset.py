"""The dataset that a benchmark measures on: the one asked for, or a tiny one."""

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
    """The dataset of a folder, or where there is none a tiny one; and a folder for whatever else, gone afterwards."""
    with tempfile.TemporaryDirectory() as spare:
        if folder is None:
            folder = Path(spare) / "tiny"
            generate(preset("tiny"), folder, workers=1)
        yield Dataset(folder), Path(spare)
