"""What registration reads of an image: the holes of its parts, its camera, and each width of map once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import kit1000.registration.kit_volume as kit_volume
from kit1000.dataset.reader import Dataset
from kit1000.perception.restoration import calibrated_image
from kit1000.perception.sensor_facts import SensorFacts, simulated_sensor
from kit1000.registration.geometry.cavity import Cavity
from kit1000.registration.method import fits_in
from kit1000.registration.part_volume import PartShape
from kit1000.registration.prepared_image import PreparedImage, RestoredImage
from kit1000.values import LabelledDepth, Query
from tests.samples.registration_cases import CLEARANCE

D415, PHOTONEO = simulated_sensor("d415"), simulated_sensor("photoneo")


def query_of(mini: Path, track: str) -> Query:
    """The first query of a track."""
    return next(query for split in ("train", "val", "test") for query in Dataset(mini).split(split).queries(track))


def test_both_ways_to_close_holes_share_the_cavities(mini: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    searches: list[float] = []
    search = kit_volume.find_cavities

    def counted(kits: kit_volume.Kits, query: Query, side: float) -> list[Cavity]:
        searches.append(side)
        return search(kits, query, side)

    monkeypatch.setattr(kit_volume, "find_cavities", counted)
    scene = PreparedImage(query_of(mini, "snap-photoneo"), PHOTONEO)
    assert len(list(scene.parts())) == 2
    fits_in(scene, (CLEARANCE,))
    assert len(searches) == len(set(searches)) > 0


def test_of_two_ways_to_close_the_holes_of_a_part_the_better_fit_decides(
    mini: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    query = next(iter(Dataset(mini).split("train").queries("snap")))
    depth = query.image.view.depth.copy()
    rows, columns = np.nonzero(query.part_mask)
    depth[rows[::3], columns[::3]] = 0
    image = LabelledDepth(replace(query.image.view, depth=depth), query.image.labels)
    query = replace(query, sensor="photoneo", read_image=lambda: image)
    parts = PreparedImage.parts

    def scores(ways: slice) -> list[float]:
        def some(self: PreparedImage) -> Iterator[tuple[PartShape, RestoredImage]]:
            return iter(list(parts(self))[ways])

        monkeypatch.setattr(PreparedImage, "parts", some)
        return [fit.score for fit in fits_in(PreparedImage(query, PHOTONEO), (CLEARANCE,))]

    both, first, second = scores(slice(0, 2)), scores(slice(0, 1)), scores(slice(1, 2))
    assert first != second
    assert both in (first, second)
    assert both[0] == max(first[0], second[0])


def test_only_a_noisy_camera_in_the_simulated_world_is_uncertain(mini: Path) -> None:
    query = query_of(mini, "place-d415")
    sensors = (simulated_sensor("ideal"), SensorFacts(simulated_table=False), D415, PHOTONEO)
    prepared = [PreparedImage(query, sensor) for sensor in sensors]
    assert [image.camera is None for image in prepared] == [True, True, False, False]
    for image, sensor in zip(prepared, sensors, strict=True):
        expected = calibrated_image(query.image, sensor).view.depth
        np.testing.assert_array_equal(image.measured.view.depth, expected)
