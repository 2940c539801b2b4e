"""Volumes of a query: its image is read once, and cropped with every masked depth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from baselines.snapnet.query_volumes import QueryVolumes, image_crops
from kit1000.dataset.reader import Dataset
from kit1000.pose import Pose
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, Query

VOXEL, CELLS = 2e-3, (40, 44, 48)
YAWED = Pose.from_rotvec((0, 0, 0.7))


@pytest.fixture(scope="module")
def query(mini: Path) -> Query:
    return next(iter(Dataset(mini).split("train").queries("snap")))


def test_a_prediction_reads_the_image_of_its_query_once(query: Query) -> None:
    reads = []
    volumes = QueryVolumes(replace(query, read_image=lambda: reads.append(1) or query.read_image()), "depth")
    volumes.part_volume(Pose.identity(), YAWED, CELLS, VOXEL)
    volumes.kit_volume(YAWED, CELLS, VOXEL)
    assert (volumes.query.image.labels.any(), len(reads)) == (True, 1)


def test_crops_hold_every_masked_depth(query: Query) -> None:
    image = query.read_image()
    crops = image_crops(image, query)
    labels = set(np.unique(image.labels).tolist()) - {0, ASSEMBLY_LABEL}
    assert {FIRST_PART_LABEL + part for part in crops.parts} == labels
    assert crops.kits is not None
    cropped = {FIRST_PART_LABEL + part: crop for part, crop in crops.parts.items()} | {ASSEMBLY_LABEL: crops.kits.image}
    for label, crop in cropped.items():
        depth = crop.view.depth[crop.labels == label]
        np.testing.assert_array_equal(depth, image.view.depth[image.labels == label])
