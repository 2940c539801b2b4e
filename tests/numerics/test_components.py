"""Connected components against those of scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from kit1000.numerics.components import component_labels


@pytest.mark.parametrize("edge_count", [0, 5, 60, 120, 400])
def test_labels_equal_those_of_scipy(edge_count: int) -> None:
    rng = np.random.default_rng(edge_count)
    for _ in range(20):
        a, b = rng.integers(0, 100, (2, edge_count))
        graph = coo_array((np.ones(edge_count), (a, b)), shape=(100, 100))
        assert np.array_equal(component_labels(100, a, b), connected_components(graph, directed=False)[1])


def test_a_long_chain_is_one_component() -> None:
    order = np.random.default_rng(0).permutation(10_000)
    assert not component_labels(10_000, order[:-1], order[1:]).any()


def test_no_nodes_have_no_labels() -> None:
    assert component_labels(0, np.zeros(0, np.int32), np.zeros(0, np.int32)).shape == (0,)
