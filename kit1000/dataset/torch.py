"""The queries of a split as a map-style dataset of PyTorch: any item in any order, the same from any worker.

This is the one module of the library that imports torch. Where items are made without it: `kit1000.dataset.items`.
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

__all__ = ["QueryDataset", "VolumeItem", "decoded", "depth_item", "tensors"]

TRUTHS = 4096  # remembered by a worker, a few kB each: reading one takes longer than all else of a cached item


class QueryDataset(Dataset):
    """Each query of a split and track, made into a dict of tensors when asked for.

    Items depend on seed, epoch and index alone, not on workers or order. May be pickled and forked.
    """

    def __init__(self, split: Split, track: str | None = None, make: Maker = depth_item, seed: int = 0) -> None:
        """Find the queries; no image is opened.

        Args:
            split: opened with `truth=True` where items are to hold what is to be learned.
            track: all tracks by default.
            make: makes the item of a query, a dict of arrays. Give a function of a module or an instance, so that
                it can be sent to workers that are spawned.
            seed: of the generators handed to `make`.
        """
        self.split = split
        self.make = make
        self.seed = seed
        self.places = [
            (recorded.id, number)
            for recorded in split
            for number, query in enumerate(recorded.queries)
            if track in (None, query.track)
        ]
        if not self.places:
            split.queries(track)  # knows the tracks there are
            raise InputError(f"split {split.name} asks nothing in track {track}")
        self._epoch = torch.zeros((), dtype=torch.int64).share_memory_()  # workers that persist see it change
        self._truths: dict[int, Truth] = {}

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_truths": {}}

    def __len__(self) -> int:
        return len(self.places)

    def __getitem__(self, index: int) -> Item:
        """The item of a query, arrays as tensors."""
        place = range(len(self))[index]  # counts from the end, raises IndexError beyond it
        return tensors(self.make(*self.asked(place), stream(self.seed, "item", self.epoch, place)))

    def __iter__(self) -> Iterator[Item]:
        return map(self.__getitem__, range(len(self)))

    @property
    def epoch(self) -> int:
        """Which pass over the data this is, as far as `make` draws."""
        return int(self._epoch)

    def set_epoch(self, epoch: int) -> None:
        """Have `make` draw anew; workers that are running see it too. Without it every epoch draws the same."""
        stream(self.seed, "item", epoch)  # says what is wrong with it
        self._epoch.fill_(epoch)

    def asked(self, index: int) -> tuple[Query, Truth | None]:
        """The query of an item and the truth about it; None where the split was opened without."""
        scene_id, number = self.places[index]
        recorded = self.split.scene(scene_id)
        query, truth = recorded.queries[number], self._truths.get(index)
        if truth is None and self.split.truth:
            truth = recorded.truth_of(query.id)
            if len(self._truths) < TRUTHS:
                self._truths[index] = truth
        return query, truth


def tensors(item: Mapping[str, Any]) -> Item:
    """Arrays as tensors on the same memory; whatever else stays as it is.

    A tensor cannot be read-only, so an array that is, because somebody else reads it too, is copied.
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
    except (TypeError, ValueError):  # ValueError: bytes in the other order
        raise InputError(f"item {name!r}: torch has no tensors of {array.dtype}") from None


def decoded(codes: torch.Tensor, unknown: float = 1.0) -> torch.Tensor:
    """Volumes of codes, uint8 or float16, as float32 on the same device; `unknown` where nobody knows."""
    if codes.dtype == torch.float16:
        return codes.float().nan_to_num(nan=unknown)
    if codes.dtype != torch.uint8:
        raise InputError(f"codes: expected uint8 or float16, got {codes.dtype}")
    return torch.where(codes == 0, unknown, (codes.float() - 128) / 127)
