"""IoU of predicted instance masks with the objects of an image, matched one to one."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from kit1000.errors import InputError, ShapeError


class MatchedMasks(NamedTuple):
    """The best one-to-one matching of k objects with m predicted masks."""

    match: np.ndarray
    """(k,) int: index of the mask of each object; -1 for none."""
    iou: np.ndarray
    """(k,) IoU of each object with its mask, 0 to 1; 0 without one."""


def mean_iou(predicted: np.ndarray, true: np.ndarray) -> float:
    """Mean IoU over the objects of an image, each with its matched mask, 0 to 1; an object without one counts 0.

    See `matched_masks` for the arguments. An image without objects has 1 when no mask is predicted, else 0.
    """
    matched = matched_masks(predicted, true)
    if len(matched.iou):
        return float(matched.iou.mean())
    return 0.0 if len(_as_masks("predicted", predicted)) else 1.0


def matched_masks(predicted: np.ndarray, true: np.ndarray) -> MatchedMasks:
    """Match objects and masks one to one, so that the sum of their IoU is largest.

    Args:
        predicted: (H, W) integers, each number above 0 labels the pixels of one mask, in the order of the numbers; or
            (m, H, W) bool masks, which may overlap.
        true: the masks of the objects, in either form. Each has a pixel or more.
    """
    masks, objects = _as_masks("predicted", predicted), _as_masks("true", true)
    if masks.shape[1:] != objects.shape[1:]:
        raise ShapeError(f"masks: expected images of one size, got {masks.shape[1:]} and {objects.shape[1:]}")
    iou = _pairwise_iou(objects, masks)
    rows, columns = linear_sum_assignment(iou, maximize=True)
    match, best = np.full(len(objects), -1), np.zeros(len(objects))
    best[rows] = iou[rows, columns]
    match[rows] = np.where(best[rows] > 0, columns, -1)
    return MatchedMasks(match, best)


def _pairwise_iou(objects: np.ndarray, masks: np.ndarray) -> np.ndarray:
    """(k, m) IoU of objects (k, H, W) and masks (m, H, W), both bool."""
    pixels = math.prod(masks.shape[1:])
    a, b = (flat.reshape(len(flat), pixels).astype(np.float64) for flat in (objects, masks))  # sums exact to 2^53
    size = a.sum(1)
    if not size.all():
        raise InputError(f"true: object {int(np.argmin(size))} has no pixel: leave out objects that are not visible")
    shared = a @ b.T
    return shared / (size[:, None] + b.sum(1) - shared)


def _as_masks(name: str, masks: np.ndarray) -> np.ndarray:
    """(k, H, W) bool of masks in either form."""
    array = np.asarray(masks)
    if array.ndim == 3 and array.dtype == bool:
        return array
    if array.ndim == 2 and array.dtype.kind in "iu":
        numbers = np.unique(array)
        return array == numbers[numbers > 0][:, None, None]
    expected = "labels (H, W) of integers or masks (k, H, W) of bool"
    raise ShapeError(f"{name}: expected {expected}, got {array.dtype} of shape {array.shape}")
