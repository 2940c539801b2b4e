"""IoU of matched masks: the best of all assignments, no mask twice, and the matching of the paper's release."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from kit1000.errors import InputError, ShapeError
from kit1000.metrics.segmentation import matched_masks, mean_iou

H, W = 4, 6


def masks(most: int) -> st.SearchStrategy[np.ndarray]:
    """At most `most` masks (k, H, W), which may overlap or be empty."""
    return st.integers(0, most).flatmap(lambda k: arrays.arrays(bool, (k, H, W)))


def nonempty_masks(most: int) -> st.SearchStrategy[np.ndarray]:
    """The same without empty masks."""
    return masks(most).map(lambda array: array[array.any(axis=(1, 2))])


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return np.count_nonzero(a & b) / max(np.count_nonzero(a | b), 1)


def best_of_all(predicted: np.ndarray, true: np.ndarray) -> float:
    """The largest sum of IoU that any assignment reaches, by trying them all."""
    nothing = np.zeros((len(true), H, W), bool)
    choices = permutations(np.concatenate([predicted, nothing]), len(true))
    return max(
        sum(iou(mask, object_mask) for mask, object_mask in zip(choice, true, strict=True)) for choice in choices
    )


@given(predicted=masks(3), true=nonempty_masks(3))
def test_no_assignment_is_better(predicted: np.ndarray, true: np.ndarray) -> None:
    matched = matched_masks(predicted, true)
    assert matched.iou.sum() == pytest.approx(best_of_all(predicted, true), abs=1e-12)
    taken = matched.match[matched.match >= 0]
    assert len(set(taken.tolist())) == len(taken)
    assert (matched.match >= -1).all()
    for object_mask, mask, share in zip(true, matched.match.tolist(), matched.iou.tolist(), strict=True):
        assert share == (iou(predicted[mask], object_mask) if mask >= 0 else 0)
    if len(true):
        assert mean_iou(predicted, true) == pytest.approx(matched.iou.mean())


@given(predicted=masks(3), true=nonempty_masks(3))
def test_unmatched_masks_cost_nothing_and_unmatched_objects_count_zero(predicted: np.ndarray, true: np.ndarray) -> None:
    if not len(true):
        return
    more = np.concatenate([predicted, np.zeros((2, H, W), bool)])
    assert mean_iou(more, true) == pytest.approx(mean_iou(predicted, true))
    fewer = matched_masks(predicted[:-1], true).iou.sum()
    assert fewer <= matched_masks(predicted, true).iou.sum() + 1e-12


@given(labels=arrays.arrays(np.int16, (H, W), elements=st.integers(0, 4)))
def test_labels_equal_their_masks(labels: np.ndarray) -> None:
    true = np.zeros((1, H, W), bool)
    true[0, :2, :3] = True
    stack = np.array([labels == number for number in np.unique(labels[labels > 0])], bool).reshape(-1, H, W)
    from_labels, from_masks = matched_masks(labels, true), matched_masks(stack, true)
    assert (from_labels.match.tolist(), from_labels.iou.tolist()) == (
        from_masks.match.tolist(),
        from_masks.iou.tolist(),
    )
    renumbered = np.where(labels > 0, labels.astype(np.uint16) * 1000, 0)
    assert mean_iou(renumbered, true) == mean_iou(labels, true)


def test_an_image_without_objects() -> None:
    nothing, something = np.zeros((H, W), int), np.ones((H, W), int)
    assert mean_iou(nothing, nothing) == 1
    assert mean_iou(something, nothing) == 0
    assert mean_iou(nothing, something) == 0


def test_anything_but_masks_is_refused() -> None:
    labels, stack = np.ones((H, W), int), np.ones((2, H, W), bool)
    for wrong in (labels * 0.5, stack * 0.5, stack[0], stack.astype(int), stack[None]):
        with pytest.raises(ShapeError, match=r"predicted: expected .*\(H, W\).*\(k, H, W\)"):
            mean_iou(wrong, labels)
    with pytest.raises(ShapeError, match=r"images of one size, got \(4, 5\) and \(4, 6\)"):
        mean_iou(labels[:, 1:], labels)
    with pytest.raises(ShapeError, match=r"images of one size, got \(3, 6\) and \(4, 6\)"):
        mean_iou(labels[1:], labels)
    with pytest.raises(InputError, match="true: object 1 has no pixel"):
        mean_iou(stack, np.array([labels > 0, labels > 1]))
