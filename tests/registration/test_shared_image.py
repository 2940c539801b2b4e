"""What the parts of an image share is what each of them would find alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import kit1000.registration.search.candidates as hypotheses
from kit1000.dataset.reader import Dataset
from kit1000.perception.restoration import calibrated_image
from kit1000.perception.restoration.restorer import Restorer
from kit1000.perception.sensor_facts import SensorFacts
from kit1000.queries.pivots import part_pivots
from kit1000.registration.geometry.observed_cavity import Cavity
from kit1000.registration.inputs.shared_image import SharedImage
from kit1000.registration.method import Registration
from kit1000.values import ASSEMBLY_LABEL, LabelledDepth, Query
from kit1000.weights import WEIGHTS


def query_of(mini: Path, track: str) -> Query:
    """The first of a track, its part's mask cut into those of two parts, left and right."""
    query = next(query for split in ("train", "val", "test") for query in Dataset(mini).split(split).queries(track))
    labels = query.image.labels.copy()
    rows, columns = np.nonzero(query.part_mask)
    right = columns > np.median(columns)
    labels[rows[right], columns[right]] = labels.max() + 1
    image = LabelledDepth(query.image.view, labels)
    return replace(query, read_image=lambda: image)


def same(image: LabelledDepth, other: LabelledDepth, labels: tuple[int, ...]) -> bool:
    """Whether two images agree to the bit in the pixels of some labels."""
    where = np.isin(image.labels, labels)
    return image.view.depth[where].tobytes() == other.view.depth[where].tobytes()


@pytest.mark.parametrize("network", [False, True])
def test_each_part_reads_the_image_that_it_would_read_alone(mini: Path, network: bool) -> None:
    query = query_of(mini, "place-d415")
    restorer = Restorer(WEIGHTS / "restoration") if network else None
    shared = SharedImage(query.image, query.sensor, restorer)
    first, *others = np.setdiff1d(query.image.labels, [0, ASSEMBLY_LABEL]).tolist()
    before = query.image.view.depth.tobytes()
    for label in (first, *others):
        alone = SharedImage(query.image, query.sensor, restorer).restored(label)
        assert same(shared.restored(label), alone, (0, ASSEMBLY_LABEL, label))
        if network:
            assert not same(alone, shared.measured, (label,))
    assert query.image.view.depth.tobytes() == before


@pytest.mark.parametrize("track", ["place", "place-d415"])
def test_cavities_are_found_once_and_the_fits_stay(mini: Path, track: str, monkeypatch: pytest.MonkeyPatch) -> None:
    query = query_of(mini, track)
    method = Registration(Dataset(mini))
    parts = part_pivots(query.view, query.image.labels).items()
    queries = [replace(query, part=part, pivot=pivot) for part, pivot in parts]
    alone = method.certain_fits(queries[-1], SharedImage(query.image, query.sensor))  # the first is alone anyway
    searches: list[float] = []
    search = hypotheses.find_cavities

    def counted(source: hypotheses.Source, of: Query, side: float, nested: bool) -> list[Cavity]:
        searches.append(side)
        return search(source, of, side, nested)

    monkeypatch.setattr(hypotheses, "find_cavities", counted)
    image = SharedImage(query.image, query.sensor)
    together = [method.certain_fits(each, image) for each in queries]
    assert len(queries) == 2
    assert len(searches) == len(set(searches)) == 1
    assert [fit.misfit for fit in alone] == [fit.misfit for fit in together[-1]]
    places = [[fit.goal_from_now.xyz.tolist() for fit in fits] for fits in (alone, together[-1])]
    assert places[0] == places[1]


def test_of_two_guesses_at_the_holes_of_a_part_that_counts_which_fits_better(
    mini: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    query = query_of(mini, "snap")
    depth = query.image.view.depth.copy()
    rows, columns = np.nonzero(query.part_mask)
    depth[rows[::3], columns[::3]] = 0
    image = LabelledDepth(replace(query.image.view, depth=depth), query.image.labels)
    query = replace(query, sensor="photoneo", read_image=lambda: image)
    method = Registration(Dataset(mini))

    def misfits() -> list[float]:
        return [fit.misfit for fit in method.certain_fits(query, SharedImage(image, "photoneo"))]

    assert [len(SharedImage(image, sensor).guesses) for sensor in ("ideal", "d415", "photoneo")] == [1, 1, 2]
    both, alone = misfits(), []
    for guess in (False, True):
        monkeypatch.setattr(SharedImage, "guesses", (guess,))
        alone.append(misfits())
    assert alone[0] != alone[1]
    assert both in alone
    assert both[0] == min(alone[0][0], alone[1][0])


def test_only_a_noisy_camera_in_the_simulated_world_is_uncertain(mini: Path) -> None:
    image = query_of(mini, "place-d415").image
    own = SensorFacts(simulated_table=False)
    assert [SharedImage(image, sensor).camera is None for sensor in ("ideal", own, "d415", SensorFacts())] == [
        True,
        True,
        False,
        False,
    ]
    for sensor in ("ideal", own, "d415", "photoneo"):
        assert same(SharedImage(image, sensor).measured, calibrated_image(image, sensor), tuple(range(256)))
