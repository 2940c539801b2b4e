"""Depth images of real sensors, where they lie beside the checkout: each imports, and few bodies are none."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from kit1000.capture.importing import imported_scenes
from kit1000.capture.options import ImportOptions
from kit1000.perception.calibration import calibrated_by
from kit1000.perception.restoration import restored
from kit1000.values import ASSEMBLY_LABEL
from tests.samples.checkout import ROOT

FOLDER = ROOT.parent / "shared" / "real-depth"
MANIFEST = FOLDER / "manifest.csv"
ROWS = list(csv.DictReader(MANIFEST.open(encoding="utf-8"))) if MANIFEST.is_file() else []
pytestmark = pytest.mark.skipif(not ROWS, reason="no real images beside the checkout")
MOST_BODIES = 14  # of an image; none shows more than 12


@pytest.mark.slow
@pytest.mark.parametrize("row", ROWS, ids=lambda row: Path(row["file"]).stem)
def test_a_real_image_is_imported(row: dict[str, str]) -> None:
    intrinsics = tuple(row[name] for name in ("fx", "fy", "cx", "cy"))
    options = ImportOptions(
        sources=(FOLDER / row["file"],),
        out=FOLDER / "out",
        intrinsics=intrinsics,
        depth_scale=float(row["metres_a_unit"]),
        device=row["sensor"],
    )
    (scene,) = imported_scenes(options)
    assert 1 < len(scene.bodies) <= MOST_BODIES
    assert scene.facts.scanner == ("PhoXi" in row["sensor"])
    view, labels = scene.image.view, scene.image.labels
    moved = calibrated_by(view, labels, scene.facts).world_from_camera.xyz - view.world_from_camera.xyz
    assert np.sqrt((moved**2).sum()) < 1e-3
    if scene.facts.scanner:
        kit = labels == ASSEMBLY_LABEL
        read = restored(scene.image, scene.facts).view.depth
        assert ((read[kit] > 0) == (view.depth[kit] > 0)).all()
    if row["foreground_mask"]:
        seen = view.depth > 0
        size = (view.camera.width, view.camera.height)
        mask = np.asarray(Image.open(FOLDER / row["foreground_mask"]).resize(size, Image.Resampling.NEAREST)) > 0
        both, either = mask & (labels > 0) & seen, (mask | (labels > 0)) & seen
        assert both.sum() > 0.9 * either.sum()
