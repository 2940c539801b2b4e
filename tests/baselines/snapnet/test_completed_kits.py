"""Kits that a network completes, as SnapNet reads them: for the rotation, and the same in another process."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import pytest

from baselines.catalog import all_methods, all_networks, weight_paths
from baselines.snapnet.config import PositionConfig, RotationConfig
from baselines.snapnet.examples import PositionExamples, QuerySampler, RotationExamples
from kit1000.dataset.reader import Dataset
from kit1000.perception.completion.kits import KitCompleter
from kit1000.rng import stream
from kit1000.weights import WEIGHTS

VOXEL, CELLS = 2e-3, (40, 44, 48)
POSITION = PositionConfig(VOXEL, (32, 32, 32), CELLS, (8, 8, 8))
ROTATION = RotationConfig(VOXEL, (32, 32, 32), CELLS, "inside", 300, 400, training_candidates=9, jitter=0.0)


@pytest.fixture(scope="module")
def samplers(mini: Path) -> tuple[QuerySampler, QuerySampler]:
    """By columns, and by the network."""
    data, network = Dataset(mini), KitCompleter(WEIGHTS / "kit-completion")
    return QuerySampler(data, "train", "depth"), QuerySampler(data, "train", "depth", kit_completer=network)


@pytest.mark.parametrize("seed", range(3))
def test_a_network_fills_more_of_the_kits_and_frees_nothing(
    samplers: tuple[QuerySampler, QuerySampler], seed: int
) -> None:
    config = replace(ROTATION, kit_distance=True)
    columns, network = (RotationExamples(each, config).draw(stream(seed))["kit_volume"] for each in samplers)
    assert ((columns < 0) & (network >= 0)).mean() < 1e-3  # but for distances that are rounded elsewhere
    assert ((network < 0) & (columns >= 0)).mean() > 1e-3


def test_the_position_is_read_from_what_is_seen(samplers: tuple[QuerySampler, QuerySampler]) -> None:
    columns, network = (PositionExamples(each, POSITION).draw(stream(1)) for each in samplers)
    assert {name: array.tobytes() for name, array in columns.items()} == {
        name: array.tobytes() for name, array in network.items()
    }


def test_another_process_completes_kits_to_the_same_bytes(samplers: tuple[QuerySampler, QuerySampler]) -> None:
    examples = RotationExamples(samplers[1], ROTATION)
    sent = pickle.loads(pickle.dumps(examples))
    here, there = (each.draw(stream(2)) for each in (examples, sent))
    assert all(here[name].tobytes() == there[name].tobytes() for name in here)


def test_the_rotation_network_learns_from_kits_as_the_method_completes_them() -> None:
    method, network = all_methods()["snapnet-kits"], all_networks()["snapnet-kits-rotation"]
    assert weight_paths(network.weights) == {name: method.weights[name] for name in ("completion", "kit_completion")}
