"""Tests of items for learning: equal to the recording, and the same from any worker."""

from __future__ import annotations

import pickle
import subprocess
import sys

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from kit1000.dataset.reader import Dataset, Split
from kit1000.dataset.torch import Item, QueryDataset, depth_item, to_tensors
from kit1000.errors import InputError
from kit1000.queries.motions import apply_error
from kit1000.values import Query, Truth
from tests.samples.checkout import ROOT


@pytest.fixture(scope="module")
def train(data: Dataset) -> Split:
    return data.split("train", truth=True)


def drawing_item(query: Query, truth: Truth | None, rng: np.random.Generator) -> Item:
    """An item with random numbers, as an augmentation draws them."""
    return {"id": query.id, "draw": rng.integers(0, 2**62, 4), "pivot": query.pivot + rng.normal(size=3)}


def bytes_of(item: Item) -> dict[str, object]:
    """An item to the bit."""
    return {name: each.numpy().tobytes() if isinstance(each, torch.Tensor) else each for name, each in item.items()}


def queries_and_truths(split: Split, track: str) -> list[tuple[Query, Truth]]:
    return [(query, scene.truth_of(query.id)) for scene in split for query in scene.queries if query.track == track]


@pytest.mark.parametrize(
    ("name", "track"), [("train", "snap"), ("train", "place"), ("test-all", "snap-d415"), ("curves", None)]
)
def test_items_are_the_queries_of_a_split_and_track_in_order(name: str, track: str | None, data: Dataset) -> None:
    items = QueryDataset(data.split(name), track, drawing_item)
    ids = [query.id for query in data.split(name).queries(track)]
    assert [item["id"] for item in items] == ids
    assert len(items) == len(ids) > 0
    assert items[-1]["id"] == ids[-1]


def test_depth_items_equal_the_recording(train: Split) -> None:
    items = QueryDataset(train, "snap-d415")
    for item, (query, truth) in zip(items, queries_and_truths(train, "snap-d415"), strict=True):
        assert query.guess is not None
        assert np.array_equal(item["depth"].numpy(), query.view.depth)
        assert np.array_equal(item["part"].numpy(), query.part_mask)
        assert np.array_equal(item["kits"].numpy(), query.kit_region)
        assert torch.allclose(item["camera"], torch.tensor(query.view.camera.K, dtype=torch.float32))
        poses = {"world_from_camera": query.view.world_from_camera, "guess": query.guess, "goal": truth.goal_drawn}
        for name, pose in poses.items():
            assert torch.equal(item[name], torch.tensor([*pose.wxyz, *pose.xyz], dtype=torch.float32))


def test_offset_and_rotvec_lead_from_the_guess_to_the_goal(train: Split) -> None:
    for item, (query, truth) in zip(QueryDataset(train, "snap"), queries_and_truths(train, "snap"), strict=True):
        assert query.guess is not None
        reached = apply_error(query.guess, query.pivot, item["offset"].numpy(), item["rotvec"].numpy())
        assert np.allclose(reached.matrix(), truth.goal_drawn.matrix(), atol=1e-6)
        moved = truth.goal_drawn.apply(query.pivot) - query.guess.apply(query.pivot)
        assert np.allclose(item["offset"], moved, atol=1e-7)


def test_a_missing_guess_is_nan_and_without_the_truth_there_are_no_targets(data: Dataset, train: Split) -> None:
    for item in QueryDataset(train, "place"):
        assert all(item[name].isnan().all() for name in ("guess", "offset", "rotvec"))
        assert item["goal"].isfinite().all()
    assert not {"goal", "offset", "rotvec"} & set(QueryDataset(data.split("train"), "snap")[0])


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
@pytest.mark.parametrize(("make", "start"), [(drawing_item, "fork"), (depth_item, "spawn")])
def test_any_number_of_workers_gives_the_same_bytes(make, start: str, train: Split) -> None:
    items = QueryDataset(train, "snap", make, seed=3)
    items.epoch = 5
    alone = [bytes_of(items[i]) for i in reversed(range(len(items)))][::-1]
    for workers in (1, 2) if start == "fork" else (1,):
        loader = DataLoader(items, batch_size=None, num_workers=workers, multiprocessing_context=start)
        assert [bytes_of(item) for item in loader] == alone
    again = pickle.loads(pickle.dumps(items))
    assert [bytes_of(item) for item in again] == alone
    assert len(pickle.dumps(items)) < 5000  # no images, no truths


def test_draws_depend_on_seed_epoch_and_index_alone(train: Split) -> None:
    def draws(seed: int, epoch: int) -> list[bytes]:
        items = QueryDataset(train, None, drawing_item, seed)
        items.epoch = epoch
        return [item["draw"].numpy().tobytes() for item in items]

    assert draws(0, 0) == draws(0, 0)
    every = [*draws(0, 0), *draws(0, 1), *draws(1, 0)]
    assert len(set(every)) == len(every)


def test_tensors_share_memory_with_arrays_that_may_be_written() -> None:
    array = np.zeros((4, 5), "float16")[1:, ::2]
    assert to_tensors({"any": array})["any"].data_ptr() == array.ctypes.data
    assert to_tensors({"id": "a", "n": 3, "t": np.float32(0.5)}) == {"id": "a", "n": 3, "t": torch.tensor(0.5)}
    array.setflags(write=False)
    found = to_tensors({"sealed": array, "broadcast": np.broadcast_to(1.0, (2, 3)), "turned": np.arange(3)[::-1]})
    found["sealed"][:] = 1
    assert not array.any()
    assert found["turned"].tolist() == [2, 1, 0]
    with pytest.raises(InputError, match=r"'name'.*<U3"):
        to_tensors({"name": np.array("abc")})


def test_an_unknown_track_and_an_index_too_high_are_refused(train: Split) -> None:
    with pytest.raises(InputError, match="'snapp'"):
        QueryDataset(train, "snapp")
    items = QueryDataset(train, "snap", drawing_item)
    with pytest.raises(IndexError):
        items[len(items)]


def test_without_torch_the_error_says_how_to_install_it() -> None:
    ask = "import sys; sys.modules['torch'] = None\ntry: import kit1000.dataset.torch"
    ask += "\nexcept Exception as error: print(repr(error))"
    answer = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, check=True, cwd=ROOT)
    assert answer.stdout == "InputError(\"kit1000.dataset.torch needs PyTorch: pip install 'kit1000[learn]'\")\n"
