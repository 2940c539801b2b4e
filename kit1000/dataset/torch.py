"""The queries of a split as a map-style PyTorch dataset: items in any order, the same from any worker.

`kit1000.dataset.items` makes the items as numpy arrays.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from kit1000.dataset.items import Item, Maker, VolumeItem, depth_item
from kit1000.dataset.reader import Split
from kit1000.errors import InputError
from kit1000.rng import stream
from kit1000.values import Query, Truth

try:
    import torch
    from torch.utils.data import Dataset
except ImportError:
    raise InputError("kit1000.dataset.torch needs PyTorch: pip install 'kit1000[learn]'") from None

__all__ = ["QueryDataset", "VolumeItem", "decode_volumes", "depth_item", "to_tensors"]

CACHED_TRUTHS = (
    4096  # in memory of a worker, a few kB each: reading a truth takes longer than the rest of a cached item
)


class QueryDataset(Dataset):
    """The queries of a split and track, each as a dict of tensors made on access.

    An item depends only on seed, epoch and index, not on workers or order. Can be pickled and forked.
    """

    def __init__(self, split: Split, track: str | None = None, make: Maker = depth_item, seed: int = 0) -> None:
        """Find the queries; no image is opened.

        Args:
            split: opened with `truth=True` where items need learning targets.
            track: the track of the queries; all tracks when None.
            make: makes the item of a query, a dict of arrays. It must be picklable for spawned workers: a function
                of a module, or an instance.
            seed: of the random generators passed to `make`.
        """
        self.split = split
        self.make = make
        self.seed = seed
        self.query_keys = [
            (recorded.id, number)
            for recorded in split
            for number, query in enumerate(recorded.queries)
            if track in (None, query.track)
        ]
        if not self.query_keys:
            split.queries(track)  # raises for an unknown track
            raise InputError(f"split {split.name} has no queries in track {track}")
        self._epoch = torch.zeros((), dtype=torch.int64).share_memory_()  # persistent workers see changes
        self._truths: dict[int, Truth] = {}

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_truths": {}}

    def __len__(self) -> int:
        return len(self.query_keys)

    def __getitem__(self, index: int) -> Item:
        """The item of a query, arrays as tensors."""
        index = range(len(self))[index]  # resolves negative indices, raises IndexError
        return to_tensors(self.make(*self.query_and_truth(index), stream(self.seed, "item", self.epoch, index)))

    def __iter__(self) -> Iterator[Item]:
        return map(self.__getitem__, range(len(self)))

    @property
    def epoch(self) -> int:
        """The current epoch; it seeds the random draws of `make`."""
        return int(self._epoch)

    def set_epoch(self, epoch: int) -> None:
        """Set the epoch, also in running workers. Without it, every epoch has the same random draws."""
        stream(self.seed, "item", epoch)  # raises for an invalid one
        self._epoch.fill_(epoch)

    def query_and_truth(self, index: int) -> tuple[Query, Truth | None]:
        """The query of an item and its truth; the truth is None where the split was opened without it."""
        scene_id, number = self.query_keys[index]
        recorded = self.split.scene(scene_id)
        query, truth = recorded.queries[number], self._truths.get(index)
        if truth is None and self.split.truth:
            truth = recorded.truth_of(query.id)
            if len(self._truths) < CACHED_TRUTHS:
                self._truths[index] = truth
        return query, truth


def to_tensors(item: Mapping[str, Any]) -> Item:
    """Arrays as tensors that share their memory; other values are unchanged.

    A tensor cannot be read-only, so read-only arrays, which are shared with others, are copied.
    """
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


def decode_volumes(codes: torch.Tensor, unknown: float = 1.0) -> torch.Tensor:
    """Encoded volumes, uint8 or float16, as float32 on the same device; unknown voxels get the value `unknown`."""
    if codes.dtype == torch.float16:
        return codes.float().nan_to_num(nan=unknown)
    if codes.dtype != torch.uint8:
        raise InputError(f"codes: expected uint8 or float16, got {codes.dtype}")
    return torch.where(codes == 0, unknown, (codes.float() - 128) / 127)
