"""The queries of a split as a map-style PyTorch dataset: items in any order, the same from any worker."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from kit1000.dataset.reader import Split
from kit1000.errors import InputError
from kit1000.pose import Pose
from kit1000.queries.motions import error_of
from kit1000.rng import stream
from kit1000.values import Query, Truth

try:
    import torch
    from torch.utils.data import Dataset
except ImportError:
    raise InputError("kit1000.dataset.torch needs PyTorch: pip install 'kit1000[learn]'") from None

__all__ = ["QueryDataset", "depth_item", "query_item", "to_tensors"]

Item = dict[str, Any]
Maker = Callable[[Query, Truth | None, np.random.Generator], Mapping[str, Any]]
"""Makes the item of a query. The truth is None when the split was opened without it. The generator is for random
augmentations; workers make the same items when a maker has no other source of randomness."""


def depth_item(query: Query, truth: Truth | None, rng: np.random.Generator) -> Item:
    """The depth image of a query with its masks and camera, and the entries of `query_item`.

    `depth` (H, W) float32 [m], 0 = no return; `part`, `kits` (H, W) bool masks; `camera` (3, 3) float32 intrinsics;
    `world_from_camera` (7,) float32.
    """
    view = query.view
    images = {"depth": view.depth, "part": query.part_mask, "kits": query.kit_region}
    camera = {"camera": view.camera.K.astype(np.float32), "world_from_camera": _pose_vector(view.world_from_camera)}
    return images | camera | query_item(query, truth)


def query_item(query: Query, truth: Truth | None) -> Item:
    """A query without its images, and with the truth the learning targets.

    `id` text; `pivot` (3,) float32 [m]; `guess` (7,) float32, `wxyz` then `xyz` [m], NaN without a guess. With the
    truth: `goal` (7,) float32, and the correction from the guess to the goal, along world axes: `offset` (3,) float32
    [m] of the pivot, `rotvec` (3,) float32 [rad]; `kit1000.queries.motions.apply_error` is the inverse.
    """
    item: Item = {"id": query.id, "pivot": query.pivot.astype(np.float32), "guess": _pose_vector(query.guess)}
    if truth is None:
        return item
    offset, rotvec = np.full((2, 3), np.nan)
    if query.guess is not None:
        offset, rotvec = error_of(truth.goal_drawn, query.guess, query.pivot)
    goal = _pose_vector(truth.goal_drawn)
    return item | {"goal": goal, "offset": offset.astype(np.float32), "rotvec": rotvec.astype(np.float32)}


def _pose_vector(pose: Pose | None) -> np.ndarray:
    """(7,) float32, `wxyz` then `xyz` [m]; NaN for None."""
    return np.full(7, np.nan, np.float32) if pose is None else np.r_[pose.wxyz, pose.xyz].astype(np.float32)


class QueryDataset(Dataset):
    """The queries of a split and track, each as a dict of tensors made on access. Can be pickled and forked.

    An item depends only on `seed`, `epoch` and index, not on workers or order. Set `epoch` before each pass for new
    random draws; a DataLoader without persistent workers passes it on.
    """

    def __init__(self, split: Split, track: str | None = None, make: Maker = depth_item, seed: int = 0) -> None:
        """Find the queries; no image is opened.

        Args:
            split: opened with `truth=True` when items need learning targets.
            track: the track of the queries; all tracks when None.
            make: makes the item of a query, a dict of arrays; a function of a module, so that it can be pickled.
            seed: seed of the random generators passed to `make`.

        Raises InputError when the split has no query on the track.
        """
        self.split, self.make, self.seed, self.epoch = split, make, seed, 0
        self.keys = [
            (recorded.id, number)
            for recorded in split
            for number, query in enumerate(recorded.queries)
            if track in (None, query.track)
        ]
        if not self.keys:
            split.queries(track)  # raises for an unknown track
            raise InputError(f"split {split.name} has no queries in track {track}")

    def __len__(self) -> int:
        return len(self.keys)

    def __getitem__(self, index: int) -> Item:
        """The item of a query, arrays as tensors."""
        index = range(len(self))[index]  # resolves negative indices, raises IndexError
        scene_id, number = self.keys[index]
        recorded = self.split.scene(scene_id)
        query = recorded.queries[number]
        truth = recorded.truth_of(query.id) if self.split.truth else None
        return to_tensors(self.make(query, truth, stream(self.seed, "item", self.epoch, index)))

    def __iter__(self) -> Iterator[Item]:
        return map(self.__getitem__, range(len(self)))


def to_tensors(item: Mapping[str, Any]) -> Item:
    """Arrays as tensors that share their memory; read-only arrays, which others use too, are copied."""
    return {name: _tensor(name, value) for name, value in item.items()}


def _tensor(name: str, value: Any) -> Any:
    if not isinstance(value, np.ndarray | np.generic):
        return value
    array = np.asarray(value)
    if not array.flags.writeable or min(array.strides, default=0) < 0:
        array = array.copy()
    try:
        return torch.from_numpy(array)
    except (TypeError, ValueError):  # ValueError: another byte order
        raise InputError(f"item {name!r}: torch has no tensors of {array.dtype}") from None
