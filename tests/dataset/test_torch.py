"""Tests of items for learning: equal to the recording, the same from any worker, with memory of their own."""

from __future__ import annotations

import pickle
import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from kit1000.dataset.items import Item, pose_vector
from kit1000.dataset.reader import Dataset, Split
from kit1000.dataset.torch import QueryDataset, VolumeItem, decode_volumes, depth_item, to_tensors
from kit1000.dataset.volume_cache import VolumeCache
from kit1000.errors import InputError
from kit1000.pose import Pose
from kit1000.queries.motions import apply_error
from kit1000.values import Query, Truth
from kit1000.voxels import Grid, Volume, signed_distance, surface_points, to_float16, to_uint8
from tests.samples.checkout import ROOT

SMALL = {"shape": (24, 20, 16), "voxel_size": 4e-3}


@pytest.fixture(scope="module")
def data(mini: Path) -> Dataset:
    """A dataset of four scenes."""
    return Dataset(mini)


@pytest.fixture(scope="module")
def train(data: Dataset) -> Split:
    return data.split("train", truth=True)


def drawing_item(query: Query, truth: Truth | None, rng: np.random.Generator) -> Item:
    """An item with random numbers, as an augmentation draws them."""
    return {"id": query.id, "draw": rng.integers(0, 2**62, 4), "pivot": query.pivot + rng.normal(size=3)}


def refused(*_: object) -> None:
    raise AssertionError("an image was opened")


def same(a: Item, b: Item) -> bool:
    """To the bit."""
    assert list(a) == list(b)
    return all(
        a[name].numpy().tobytes() == b[name].numpy().tobytes() and a[name].dtype == b[name].dtype
        if isinstance(a[name], torch.Tensor)
        else a[name] == b[name]
        for name in a
    )


def pose_of(row: torch.Tensor) -> Pose:
    return Pose(row[:4].double().numpy(), row[4:].double().numpy())


def test_items_are_the_queries_of_a_split_and_track_in_order(data: Dataset) -> None:
    for name, track in (
        ("train", "snap"),
        ("train", "place"),
        ("test-all", "snap-d415"),
        ("curves", None),
        ("train", None),
        ("test", None),
    ):
        items = QueryDataset(data.split(name), track, drawing_item)
        ids = [query.id for query in data.split(name).queries(track)]
        assert [item["id"] for item in items] == ids
        assert len(items) == len(ids) > 0
        assert items[-1]["id"] == ids[-1]


def test_the_index_is_known_without_images(data: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Dataset, "labelled_depth", refused)
    items = QueryDataset(data.split("test-all"), "snap", drawing_item)
    assert items[len(items) - 1]["id"].endswith("-snap")
    with pytest.raises(AssertionError, match="an image was opened"):
        QueryDataset(data.split("test-all"), "snap")[0]


def test_depth_items_equal_the_recording(train: Split) -> None:
    items = QueryDataset(train, "snap-d415")
    for index, item in enumerate(items):
        query, truth = items.query_and_truth(index)
        assert truth is not None
        assert query.guess is not None
        assert np.array_equal(item["depth"].numpy(), query.view.depth)
        assert np.array_equal(item["part"].numpy(), query.part_mask)
        assert np.array_equal(item["kits"].numpy(), query.kit_region)
        assert torch.allclose(item["camera"], torch.tensor(query.view.camera.K, dtype=torch.float32))
        poses = {"world_from_camera": query.view.world_from_camera, "guess": query.guess, "goal": truth.goal_drawn}
        for name, pose in poses.items():
            assert torch.equal(item[name], torch.tensor([*pose.wxyz, *pose.xyz], dtype=torch.float32))


def test_offset_and_rotvec_lead_from_the_guess_to_the_goal(train: Split) -> None:
    for track in ("snap", "snap-tilt", "snap-d415"):
        items = QueryDataset(train, track)
        for index, item in enumerate(items):
            query, truth = items.query_and_truth(index)
            assert query.guess is not None
            assert truth is not None
            reached = apply_error(query.guess, query.pivot, item["offset"].numpy(), item["rotvec"].numpy())
            assert np.allclose(reached.matrix(), truth.goal_drawn.matrix(), atol=1e-6)
            moved = truth.goal_drawn.apply(query.pivot) - query.guess.apply(query.pivot)
            assert np.allclose(item["offset"], moved, atol=1e-7)
            assert item["offset"].abs().max() <= 0.028 + 1e-7
            assert item["rotvec"].norm() <= np.radians(27.5) + 1e-6


def test_a_missing_guess_is_nan(train: Split) -> None:
    for item in QueryDataset(train, "place"):
        assert all(item[name].isnan().all() for name in ("guess", "offset", "rotvec"))
        assert item["goal"].isfinite().all()
    assert np.isnan(pose_vector(None)).all()


def test_without_the_truth_items_have_no_targets(data: Dataset) -> None:
    assert not {"goal", "offset", "rotvec"} & set(QueryDataset(data.split("train"), "snap")[0])


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_any_number_of_workers_gives_the_same_bytes(data: Dataset, train: Split, tmp_path: Path) -> None:
    makers = (
        drawing_item,
        depth_item,
        VolumeItem(data, **SMALL),
        VolumeItem(data, **SMALL, cache=VolumeCache(tmp_path), codes=True),
    )
    for make in makers:
        items = QueryDataset(train, "snap", make, seed=3)
        items.set_epoch(5)
        alone = [items[i] for i in range(len(items))]
        for workers in (0, 1, 2):
            loaded = list(DataLoader(items, batch_size=None, num_workers=workers))
            assert len(loaded) == len(alone)
            assert all(same(a, b) for a, b in zip(alone, loaded, strict=True))


def test_workers_that_are_spawned_give_the_same_bytes(data: Dataset, train: Split) -> None:
    items = QueryDataset(train, "snap", VolumeItem(data, **SMALL), seed=3)
    loader = DataLoader(items, batch_size=None, num_workers=1, multiprocessing_context="spawn")
    assert all(same(items[i], loaded) for i, loaded in enumerate(loader))


def test_draws_depend_on_seed_epoch_and_index_alone(train: Split) -> None:
    def draws(seed: int, epoch: int) -> list[bytes]:
        items = QueryDataset(train, None, drawing_item, seed)
        items.set_epoch(epoch)
        backward = [items[i]["draw"].numpy().tobytes() for i in reversed(range(len(items)))]
        assert [items[i]["draw"].numpy().tobytes() for i in range(len(items))] == backward[::-1]
        return backward

    assert draws(0, 0) == draws(0, 0)
    every = [*draws(0, 0), *draws(0, 1), *draws(1, 0)]
    assert len(set(every)) == len(every)


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_persistent_workers_see_the_epoch_change(train: Split) -> None:
    items = QueryDataset(train, "snap", drawing_item)
    loader = DataLoader(items, batch_size=None, num_workers=2, persistent_workers=True)
    for epoch in (0, 1, 7):
        items.set_epoch(epoch)
        assert items.epoch == epoch
        assert all(same(items[i], loaded) for i, loaded in enumerate(loader))


def test_a_dataset_survives_pickling(data: Dataset, train: Split) -> None:
    items = QueryDataset(train, "snap", VolumeItem(data, **SMALL), seed=9)
    items.set_epoch(2)
    before = items[0]
    again = pickle.loads(pickle.dumps(items))
    assert same(again[0], before)
    assert again.epoch == 2
    assert len(pickle.dumps(items)) < 5000  # no images, no truths


def test_tensors_share_memory_with_arrays() -> None:
    for dtype in ("float32", "float16", "uint8", "bool", "int64", "float64", "uint16"):
        array = np.zeros((4, 5), dtype)[1:, ::2]
        (tensor,) = to_tensors({"any": array}).values()
        assert tensor.data_ptr() == array.ctypes.data
        array[2, 1] = 1
        assert tensor[2, 1] == 1
    assert to_tensors({"id": "a", "n": 3, "t": np.float32(0.5)}) == {"id": "a", "n": 3, "t": torch.tensor(0.5)}


def test_the_arrays_of_a_volume_item_are_not_copied(data: Dataset, train: Split, tmp_path: Path) -> None:
    made: list[Item] = []
    for make in (VolumeItem(data, **SMALL), VolumeItem(data, **SMALL, cache=VolumeCache(tmp_path), codes=True)):

        def kept(query: Query, truth: Truth | None, rng: np.random.Generator, make: VolumeItem = make) -> Item:
            made.append(make(query, truth, rng))
            return made[-1]

        item = QueryDataset(train, "snap", kept)[0]
        for name in ("part", "kit", "guess", "goal"):
            assert item[name].data_ptr() == made[-1][name].ctypes.data


def test_read_only_arrays_are_copied_without_a_warning() -> None:
    array = np.arange(6.0)
    array.setflags(write=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = to_tensors({"sealed": array, "broadcast": np.broadcast_to(1.0, (2, 3)), "turned": np.arange(3)[::-1]})
    found["sealed"][:] = 0
    assert array.tolist() == [0, 1, 2, 3, 4, 5]
    assert found["broadcast"].shape == (2, 3)
    assert found["turned"].tolist() == [2, 1, 0]


def test_changing_an_item_changes_no_other(data: Dataset, train: Split, tmp_path: Path) -> None:
    cache = VolumeCache(tmp_path)
    for make in (
        depth_item,
        VolumeItem(data, **SMALL, cache=cache),
        VolumeItem(data, **SMALL, cache=cache, codes=True),
    ):
        items = QueryDataset(train, "snap", make)
        first = items[0]
        kept = {name: value.clone() if isinstance(value, torch.Tensor) else value for name, value in first.items()}
        for value in first.values():
            if isinstance(value, torch.Tensor):
                value.zero_()
        assert same(items[0], kept)


def test_the_goal_aligns_the_part_with_the_kit(data: Dataset, train: Split) -> None:
    """With the goal as the guess, no voxel is solid in both volumes, and their surfaces are close."""
    items = QueryDataset(train, "snap")
    make = VolumeItem(data, (64, 64, 64), 1.5e-3, source="truth")
    for index in range(len(items)):
        query, truth = items.query_and_truth(index)
        assert truth is not None
        item = make(replace(query, guess=truth.goal_drawn), truth, np.random.default_rng(0))
        part, kit = item["part"], item["kit"]
        assert not ((part < -0.2) & (kit < -0.2)).any()  # deeper than a voxel in both
        assert ((part < 0.5) & (kit < 0.5)).sum() > 50  # 4 mm from both: in the cavity


def test_the_guess_carries_the_grid_of_the_part_onto_that_of_the_kit(data: Dataset, train: Split) -> None:
    items = QueryDataset(train, "snap", VolumeItem(data, **SMALL))
    for index, item in enumerate(items):
        query, _ = items.query_and_truth(index)
        assert query.guess is not None
        carried, kit = query.guess @ pose_of(item["part_grid"]), pose_of(item["kit_grid"])
        assert np.allclose(carried.matrix(), kit.matrix(), atol=1e-6)
        grids = {"part": pose_of(item["part_grid"]), "kit": kit}
        middles = {name: Grid(SMALL["shape"], 4e-3, pose).world((11.5, 9.5, 7.5)) for name, pose in grids.items()}
        assert np.allclose(middles["part"], query.pivot, atol=1e-6)
        assert np.allclose(middles["kit"], query.guess.apply(query.pivot), atol=1e-6)


def test_true_volumes_are_those_of_the_meshes_at_their_poses(data: Dataset, train: Split) -> None:
    make = VolumeItem(data, (48, 48, 48), 2e-3, source="truth")
    for recorded in train:
        for query in recorded.queries:
            truth = recorded.truths[query.id]
            kit, part = make.kit(query, truth), make.part(query, truth)
            _, stands, *_ = recorded.bodies()
            wanted = signed_distance(kit.grid, [stands])
            assert np.allclose(kit.values, wanted.values, atol=1e-4)
            lies = recorded.bodies()[2 + query.part]
            assert np.allclose(part.values, signed_distance(part.grid, [lies]).values, atol=1e-4)
            assert part.occupied.any()


def test_volumes_from_depth_lie_on_true_surfaces(data: Dataset, train: Split) -> None:
    seen, true = VolumeItem(data, (48, 48, 48), 2e-3), VolumeItem(data, (48, 48, 48), 2e-3, source="truth")
    for index in range(len(items := QueryDataset(train, "snap"))):
        query, truth = items.query_and_truth(index)
        for of in (VolumeItem.part, VolumeItem.kit):
            partial, whole = of(seen, query, truth), of(true, query, truth)
            i, j, k = np.rint(whole.grid.indices(surface_points(partial))).astype(int).T
            assert np.median(np.abs(whole.values[i, j, k])) < 0.1  # 1 mm, truncated at five voxels of 2 mm
        assert np.allclose(seen.part(query).grid.world((23.5, 23.5, 23.5)), query.pivot)


def test_without_a_guess_the_grid_is_centred_on_the_kits(data: Dataset, train: Split) -> None:
    make = VolumeItem(data, (32, 32, 32), 3e-3, kit_shape=(96, 96, 64))
    for query in train.queries("place"):
        item = make(query, None, np.random.default_rng(0))
        assert item["part"].shape == (32, 32, 32)
        assert item["kit"].shape == (96, 96, 64)
        view = query.view
        points = view.world_from_camera.apply(view.camera.unproject(view.depth)[query.kit_region & (view.depth > 0)])
        middle = make.kit(query).grid.world((47.5, 47.5, 31.5))
        assert np.allclose(middle, (points.min(0) + points.max(0)) / 2)


def test_a_cache_changes_nothing_but_the_last_digits(data: Dataset, train: Split, tmp_path: Path) -> None:
    fresh = QueryDataset(train, "snap", VolumeItem(data, **SMALL))
    for encoding, step in (("uint8", 1 / 127), ("float16", 2**-12)):
        cache = VolumeCache(tmp_path, encoding)
        items = QueryDataset(train, "snap", VolumeItem(data, **SMALL, cache=cache))
        codes = QueryDataset(train, "snap", VolumeItem(data, **SMALL, cache=cache, codes=True))
        for index, item in enumerate(fresh):
            first, again = items[index], items[index]
            assert same(first, again)
            for name in ("part", "kit"):
                assert (first[name] - item[name]).abs().max() <= step
                assert torch.equal(decode_volumes(codes[index][name]), first[name])


def test_cached_volumes_open_no_image(
    data: Dataset, train: Split, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for track in ("snap", "place"):
        items = QueryDataset(train, track, VolumeItem(data, **SMALL, cache=VolumeCache(tmp_path)))
        before = [items[i] for i in range(len(items))]
        with monkeypatch.context() as patch:
            patch.setattr(Dataset, "labelled_depth", refused)
            assert all(same(items[i], before[i]) for i in range(len(items)))


@pytest.mark.parametrize("unknown", [1.0, -1.0, 0.5])
def test_codes_decode_to_the_values_with_unknown_filled(unknown: float) -> None:
    rng = np.random.default_rng(0)
    values = rng.uniform(-1, 1, (8, 9, 10)).astype(np.float32)
    values[rng.random(values.shape) < 0.3] = np.nan
    volume = Volume(Grid(values.shape, 1e-3, Pose.identity()), values)
    for to, step in ((to_uint8, 1 / 127), (to_float16, 2**-12)):
        found = decode_volumes(torch.from_numpy(to(volume)), unknown).numpy()
        assert found.dtype == np.float32
        assert np.abs(found - volume.filled(unknown)).max() <= step
        assert np.array_equal(found[~volume.known], volume.filled(unknown)[~volume.known])
    with pytest.raises(InputError, match=r"expected uint8 or float16, got torch.int32"):
        decode_volumes(torch.zeros(3, dtype=torch.int32))


def test_invalid_arguments_are_refused(data: Dataset, train: Split, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no track 'snapp' in split train; there are snap"):
        QueryDataset(train, "snapp")
    with pytest.raises(InputError, match="source 'dpeth': expected one of depth, truth"):
        VolumeItem(data, source="dpeth")
    with pytest.raises(InputError, match="codes: need a cache, as in"):
        VolumeItem(data, codes=True)
    with pytest.raises(InputError, match="expected 1 voxel or more"):
        VolumeItem(data, kit_shape=(0, 4, 4))
    cache = VolumeCache(tmp_path)
    assert QueryDataset(train, "snap", VolumeItem(data, **SMALL, source="truth", cache=cache))[0]
    blind = QueryDataset(data.split("train"), "snap", VolumeItem(data, **SMALL, source="truth", cache=cache))
    with pytest.raises(InputError, match="true volumes need the truth; use dataset"):
        blind[0]
    with pytest.raises(InputError, match="item 'name': torch has no tensors of <U3"):
        to_tensors({"name": np.array("abc")})
    with pytest.raises(InputError, match="stream key: expected"):
        blind.set_epoch(-1)
    with pytest.raises(IndexError):
        blind[len(blind)]


def test_without_torch_items_are_made_and_the_error_says_how_to_install_it() -> None:
    ask = "import sys; sys.modules['torch'] = None; import kit1000.dataset.items\ntry: import kit1000.dataset.torch"
    ask += "\nexcept Exception as error: print(repr(error))"
    answer = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, check=True, cwd=ROOT)
    assert answer.stdout == "InputError(\"kit1000.dataset.torch needs PyTorch: pip install 'kit1000[learn]'\")\n"
