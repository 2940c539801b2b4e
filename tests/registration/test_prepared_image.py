"""What the parts of an image share is what each of them would find alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import kit1000.registration.kit_volume as kit_volume
from kit1000.dataset.reader import Dataset
from kit1000.perception.restoration import calibrated_image
from kit1000.perception.restoration.restorer import Restorer
from kit1000.perception.sensor_facts import SensorFacts, simulated_sensor
from kit1000.queries.pivots import part_pivots
from kit1000.registration.geometry.cavity import Cavity
from kit1000.registration.method import FitSearch, PartRegistration, fits_in
from kit1000.registration.part_volume import PartShape
from kit1000.registration.prepared_image import Networks, PreparedImage, RestoredImage
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, LabelledDepth, Query
from kit1000.weights import WEIGHTS
from tests.samples.registration_cases import CLEARANCE

D415, PHOTONEO = simulated_sensor("d415"), simulated_sensor("photoneo")


def queries_of(mini: Path, track: str) -> list[Query]:
    """The first query of a track, its part's mask cut into those of two parts, left and right: about each of them."""
    query = next(query for split in ("train", "val", "test") for query in Dataset(mini).split(split).queries(track))
    labels = query.image.labels.copy()
    rows, columns = np.nonzero(query.part_mask)
    right = columns > np.median(columns)
    labels[rows[right], columns[right]] = labels.max() + 1
    image = LabelledDepth(query.image.view, labels)
    query = replace(query, read_image=lambda: image)
    pivots = part_pivots(query.view, labels)
    return [replace(query, part=part, pivot=pivot) for part, pivot in pivots.items()]


def same(image: LabelledDepth, other: LabelledDepth, labels: tuple[int, ...]) -> bool:
    """Whether two images agree to the bit in the pixels of some labels."""
    where = np.isin(image.labels, labels)
    return image.view.depth[where].tobytes() == other.view.depth[where].tobytes()


@pytest.mark.parametrize("network", [False, True])
def test_each_part_reads_the_image_that_it_would_read_alone(mini: Path, network: bool) -> None:
    queries = queries_of(mini, "place-d415")
    networks = Networks(restorer=Restorer(WEIGHTS / "restoration")) if network else Networks()
    shared, before = PreparedImage(queries[0], D415, networks), queries[0].image.view.depth.tobytes()
    for query in queries:
        alone = PreparedImage(query, D415, networks)
        ((_, found),), ((_, expected),) = shared.parts(query), alone.parts(query)
        label = FIRST_PART_LABEL + query.part
        assert same(found.restored, expected.restored, (0, ASSEMBLY_LABEL, label))
        if network:
            assert not same(expected.restored, shared.measured, (label,))
    assert queries[0].image.view.depth.tobytes() == before


@pytest.mark.parametrize("track", ["place", "place-d415"])
def test_cavities_are_found_once_and_the_fits_stay(mini: Path, track: str, monkeypatch: pytest.MonkeyPatch) -> None:
    queries = queries_of(mini, track)
    sensor = simulated_sensor(queries[0].sensor)

    def costs(scene: PreparedImage, query: Query) -> list[tuple[float, list[float]]]:
        ((part, image),) = scene.parts(query)
        fits = FitSearch(PartRegistration(scene, part, image, query, CLEARANCE)).first_fits()
        return [(fit.cost, fit.goal_from_now.xyz.tolist()) for fit in fits]

    alone = costs(PreparedImage(queries[-1], sensor), queries[-1])
    searches: list[float] = []
    search = kit_volume.find_cavities

    def counted(kits: kit_volume.Kits, query: Query, side: float) -> list[Cavity]:
        searches.append(side)
        return search(kits, query, side)

    monkeypatch.setattr(kit_volume, "find_cavities", counted)
    shared = PreparedImage(queries[0], sensor)
    together = [costs(shared, query) for query in queries]
    assert len(queries) == 2
    assert len(searches) == len(set(searches)) == 1
    assert together[-1] == alone


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

    def costs(ways: slice) -> list[float]:
        def some(self: PreparedImage, query: Query) -> Iterator[tuple[PartShape, RestoredImage]]:
            return iter(list(parts(self, query))[ways])

        monkeypatch.setattr(PreparedImage, "parts", some)
        return [fit.cost for fit in fits_in(PreparedImage(query, PHOTONEO), (CLEARANCE,))]

    both, first, second = costs(slice(0, 2)), costs(slice(0, 1)), costs(slice(1, 2))
    assert first != second
    assert both in (first, second)
    assert both[0] == min(first[0], second[0])


def test_only_a_noisy_camera_in_the_simulated_world_is_uncertain(mini: Path) -> None:
    query = queries_of(mini, "place-d415")[0]
    sensors = (simulated_sensor("ideal"), SensorFacts(simulated_table=False), D415, PHOTONEO)
    prepared = [PreparedImage(query, sensor) for sensor in sensors]
    assert [image.camera is None for image in prepared] == [True, True, False, False]
    for image, sensor in zip(prepared, sensors, strict=True):
        assert same(image.measured, calibrated_image(query.image, sensor), tuple(range(256)))
