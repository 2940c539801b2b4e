"""How much of a part's outline something nearer hides."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kit1000.camera import Camera
from kit1000.pose import Pose
from kit1000.registration.part_volume import RING, hidden_outline
from kit1000.values import LabelledDepth, View

TABLE, PART, OTHER = 0, 2, 3
SIDE, FIRST, LAST = 40, 12, 28  # [px] of the image; of the square part
FAR, NEAR = 0.8, 0.7  # [m]


def image_of(depth: np.ndarray, labels: np.ndarray) -> LabelledDepth:
    camera = Camera(SIDE, SIDE, 100.0, 100.0, SIDE / 2, SIDE / 2)
    return LabelledDepth(View(camera, Pose.identity(), depth.astype(np.float32)), labels.astype(np.uint8))


def scene(beside: float, columns: slice = slice(LAST, SIDE)) -> LabelledDepth:
    """A square part at FAR; in some columns another body, at a depth of its own."""
    depth, labels = np.full((SIDE, SIDE), 0.9), np.zeros((SIDE, SIDE))
    depth[FIRST:LAST, FIRST:LAST], labels[FIRST:LAST, FIRST:LAST] = FAR, PART
    depth[:, columns], labels[:, columns] = beside, OTHER
    return image_of(depth, labels)


def test_a_body_nearer_along_one_side_hides_its_share_of_the_ring() -> None:
    side = LAST - FIRST
    ring = (side + 2 * RING) ** 2 - side**2
    assert hidden_outline(scene(NEAR), PART) == pytest.approx((side + 2 * RING) * RING / ring)


@pytest.mark.parametrize("beside", [FAR, 0.85, 0.0])
def test_a_body_behind_or_without_a_return_hides_nothing(beside: float) -> None:
    assert hidden_outline(scene(beside), PART) == 0


def test_the_table_hides_nothing_and_a_missing_part_has_no_outline() -> None:
    alone = scene(FAR, slice(0, 0))
    assert hidden_outline(image_of(alone.view.depth, np.where(alone.labels == OTHER, TABLE, alone.labels)), PART) == 0
    assert hidden_outline(alone, 7) == 0


@given(first=st.integers(LAST, SIDE), widths=st.tuples(st.integers(0, SIDE), st.integers(0, SIDE)))
def test_more_of_a_nearer_body_hides_no_less(first: int, widths: tuple[int, int]) -> None:
    less, more = (hidden_outline(scene(NEAR, slice(first, first + width)), PART) for width in sorted(widths))
    assert 0 <= less <= more <= 1


@given(turns=st.integers(0, 3), shift=st.tuples(st.integers(-6, 6), st.integers(-6, 6)))
def test_it_moves_with_the_image(turns: int, shift: tuple[int, int]) -> None:
    before = scene(NEAR, slice(LAST, LAST + 1))
    depth, labels = (np.rot90(np.roll(a, shift, (0, 1)), turns) for a in (before.view.depth, before.labels))
    assert hidden_outline(image_of(depth, labels), PART) == hidden_outline(before, PART)
