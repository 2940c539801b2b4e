"""Bounds of the work: they fall with size, never below the least, and touch no scene of the presets."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kit1000.dataset.reader import Dataset
from kit1000.perception.observed.parts import HALF_WIDTH, ObservedPart
from kit1000.pose import Pose
from kit1000.queries.pivots import part_pivots
from kit1000.registration.method import MOST_TRIED
from kit1000.registration.predictor import Registration
from kit1000.registration.search import LARGEST, tries_of, work_of
from kit1000.values import FIRST_PART_LABEL, LabelledDepth

widths = st.floats(0.01, 0.5)
REAL_LIKE = 0.0636  # [m] the largest half width that parts of 80 mm were seen to have


@given(one=widths, other=widths)
def test_larger_parts_take_more_work_and_get_fewer_tries(one: float, other: float) -> None:
    small, large = sorted((one, other))
    assert 1 <= work_of(small) <= work_of(large)
    assert MOST_TRIED >= tries_of(small, 9, MOST_TRIED) >= tries_of(large, 9, MOST_TRIED) >= 9


def test_parts_of_the_presets_reach_no_bound() -> None:
    assert work_of(HALF_WIDTH) == 1
    assert tries_of(REAL_LIKE, 9, MOST_TRIED) == MOST_TRIED


@pytest.fixture(scope="module")
def data(mini: Path) -> Dataset:
    return Dataset(mini)


def test_a_part_of_half_a_metre_gets_no_fit_at_once(data: Dataset) -> None:
    query = next(data.split("train").queries("place"))
    view = query.image.view
    far = replace(view, depth=8 * view.depth)  # all is eight times as large, and as far away
    image = LabelledDepth(far, query.image.labels)
    pivot = part_pivots(far, image.labels)[query.part]
    assert ObservedPart(image, FIRST_PART_LABEL + query.part, pivot).half_width > LARGEST
    method = Registration(data)
    predicted = method(replace(query, pivot=pivot, read_image=lambda: image))
    assert predicted.confidence == 0
    assert np.array_equal(predicted.goal_from_now.matrix(), Pose.identity().matrix())
