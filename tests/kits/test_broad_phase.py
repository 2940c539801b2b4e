"""Tests of the loops that leave pairs out: their answers are those of trying every pair, to the last digit."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import maximum_filter

from kit1000.kits.contact import highest_edge_contact, highest_vertex_contact
from kit1000.kits.height_fields import grown

FULL = (-np.inf, np.inf)  # a search for the highest contact from nothing to its end


@pytest.mark.parametrize("cells", [0, 1, 2, 3, 5, 12, 21])
@pytest.mark.parametrize("shape", [(1, 1), (3, 40), (60, 45)])
def test_a_relief_grows_by_the_maximum_over_a_disc(cells: int, shape: tuple[int, int]) -> None:
    depths = np.maximum(np.random.default_rng(cells).normal(size=shape), 0)
    across = np.arange(-cells, cells + 1)
    disc = np.hypot(*np.meshgrid(across, across)) <= cells + 0.5
    assert np.array_equal(grown(depths, cells + 0.5), maximum_filter(depths, footprint=disc, mode="constant"))


@pytest.mark.parametrize(("count", "size"), [(1, 0.1), (7, 0.05), (60, 0.01), (60, 0.002)])
@pytest.mark.parametrize("rounded", [False, True])
def test_contacts_are_those_of_every_pair_tried_alone(count: int, size: float, rounded: bool) -> None:
    rng = np.random.default_rng(count)

    def shapes(corners: int) -> np.ndarray:
        found = rng.normal(size=(count, 1, 3)) * 0.02 + rng.normal(size=(count, corners, 3)) * size
        return np.round(found, 2) if rounded else found  # many coordinates are then equal

    moving, fixed, faces = shapes(2), shapes(2), shapes(3)
    alone = max(highest_edge_contact(a[None], b[None], *FULL) for a in moving for b in fixed)
    assert highest_edge_contact(moving, fixed, *FULL) == alone
    points = np.concatenate([moving.reshape(-1, 3), faces.reshape(-1, 3)])
    for sign in (1.0, -1.0):
        alone = max(highest_vertex_contact(point[None], face[None], sign, *FULL) for point in points for face in faces)
        assert highest_vertex_contact(points, faces, sign, *FULL) == alone
        assert highest_vertex_contact(points, faces, sign, alone - 1e-3, alone - 2e-3) == alone - 1e-3
        assert highest_vertex_contact(points, faces, sign, -np.inf, alone - 1e-3) > alone - 1e-3


def test_nothing_touches_nothing() -> None:
    none, one = np.zeros((0, 2, 3)), np.zeros((1, 2, 3))
    assert highest_edge_contact(none, one, *FULL) == highest_edge_contact(one, none, *FULL) == -np.inf
    assert highest_vertex_contact(np.zeros((0, 3)), np.zeros((1, 3, 3)), 1.0, *FULL) == -np.inf
