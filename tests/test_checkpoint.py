"""Weights and states: what is written comes back, and whatever is wrong with a file is said in one line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn

from baselines.training.checkpoint import (
    LARGEST,
    fill,
    fill_optimizer,
    load_weights,
    optimizer_tensors,
    read_state,
    save_weights,
    stored,
    write_state,
)
from kit1000.errors import InputError


def network(seed: int = 0, width: int = 5) -> nn.Sequential:
    """Weights, biases, running statistics and a counter."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        return nn.Sequential(nn.Linear(3, width), nn.BatchNorm1d(width), nn.Linear(width, 2))


def same(a: dict[str, torch.Tensor], b: dict[str, torch.Tensor]) -> bool:
    """To the bit."""
    return a.keys() == b.keys() and all(a[name].dtype == b[name].dtype and a[name].equal(b[name]) for name in a)


def refusal(path: Path) -> str | None:
    """What is said of a state that cannot be read, or not into this network."""
    try:
        fill(network(1), read_state(path)[0]["model"], path)
    except InputError as error:
        return str(error)
    return None


@pytest.fixture
def stem(tmp_path: Path) -> Path:
    return tmp_path / "position-0.89"  # not a suffix


def test_weights_come_back_to_the_bit_with_what_was_said_of_them(stem: Path) -> None:
    model, info = network(), {"steps": 7, "metrics": {"position_mm": 1.5}, "name": "größer"}
    save_weights(stem, model, info)
    tensors, said = load_weights(stem)
    assert same(tensors, stored(model))
    assert said == info
    assert sorted(path.name for path in stem.parent.iterdir()) == [f"{stem.name}.json", f"{stem.name}.safetensors"]


def test_half_weights_are_half_as_long_and_come_back_as_float32_within_rounding(stem: Path) -> None:
    model = network(width=400)
    save_weights(stem, model, {})
    whole = stem.with_name(stem.name + ".safetensors").stat().st_size
    save_weights(stem, model, {}, half=True)
    assert stem.with_name(stem.name + ".safetensors").stat().st_size < 0.6 * whole
    tensors, _ = load_weights(stem)
    for name, value in model.state_dict().items():
        assert tensors[name].dtype == value.dtype
        torch.testing.assert_close(tensors[name], value, rtol=2**-11, atol=2**-25)


def test_the_same_weights_give_the_same_bytes(tmp_path: Path) -> None:
    for name in "ab":
        save_weights(tmp_path / name, network(), {"steps": 1})
    assert (tmp_path / "a.safetensors").read_bytes() == (tmp_path / "b.safetensors").read_bytes()
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()


def test_numbers_beyond_float16_are_refused_before_anything_is_written(stem: Path) -> None:
    model = network()
    model.get_parameter("0.weight").data[0, 0] = 1e5
    with pytest.raises(InputError, match=r"0\.weight holds numbers that are too large for float16"):
        save_weights(stem, model, {}, half=True)
    assert not list(stem.parent.iterdir())


def test_a_file_that_is_too_long_is_refused(stem: Path) -> None:
    model = nn.Linear(2048, LARGEST // 4 // 2048, bias=False)  # the tensors alone fill the file; there is a header too
    with pytest.raises(InputError, match=r"16\.0 MiB of weights, more than the 16 MiB .*half=True halves them"):
        save_weights(stem, model, {})
    assert not list(stem.parent.iterdir())
    save_weights(stem, model, {}, half=True)
    save_weights(stem, model, {}, largest=None)


def test_shared_weights_are_written_for_each_name(stem: Path) -> None:
    model = nn.Sequential(nn.Linear(4, 4), nn.Linear(4, 4))
    model[1].weight = model[0].weight
    save_weights(stem, model, {})
    assert same(load_weights(stem)[0], stored(model))


@given(place=st.floats(0, 1, exclude_max=True), flip=st.integers(1, 255))
@settings(max_examples=30)
def test_any_changed_byte_of_weights_is_noticed(
    tmp_path_factory: pytest.TempPathFactory, place: float, flip: int
) -> None:
    stem = tmp_path_factory.mktemp("weights") / "w"
    save_weights(stem, network(), {})
    path = stem.with_suffix(".safetensors")
    data = bytearray(path.read_bytes())
    data[int(place * len(data))] ^= flip
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"w\.safetensors: damaged, or not the weights that w\.json tells of"):
        load_weights(stem)


def test_missing_halves_and_foreign_files_are_named(stem: Path) -> None:
    words, tensors = (stem.with_name(stem.name + suffix) for suffix in (".json", ".safetensors"))
    with pytest.raises(InputError, match=r"no file .*\.json"):
        load_weights(stem)
    save_weights(stem, network(), {})
    tensors.unlink()
    with pytest.raises(InputError, match=r"no file .*\.safetensors"):
        load_weights(stem)
    words.write_text('{"steps": 3}')
    with pytest.raises(InputError, match="tells of no weights"):
        load_weights(stem)
    words.write_text("{")
    with pytest.raises(InputError, match="damaged or no JSON"):
        load_weights(stem)


def test_weights_are_put_into_a_network_of_the_same_kind() -> None:
    model, other = network(0), network(1)
    memory = other.get_parameter("0.weight").data_ptr()
    fill(other, stored(model), "here")
    assert same(stored(other), stored(model))
    assert other.get_parameter("0.weight").data_ptr() == memory


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"0.weight": None}, r"w\.st: holds no 0\.weight, which this network has \(1 such\)"),
        ({"0.wieght": torch.ones(1)}, r"holds 0\.wieght, which this network has not; did you mean 0\.weight\? \(1"),
        ({"0.weight": torch.ones(4, 3)}, r"0\.weight has the shape \(4, 3\), in this network \(5, 3\)"),
    ],
)
def test_tensors_of_another_network_are_refused_and_change_nothing(
    change: dict[str, torch.Tensor | None], said: str
) -> None:
    model = network()
    before = stored(model)
    changed = {name: value for name, value in (stored(network(1)) | change).items() if value is not None}
    with pytest.raises(InputError, match=said):
        fill(model, changed, "w.st")
    assert same(stored(model), before)


def test_a_state_comes_back_to_the_bit(tmp_path: Path) -> None:
    words = {"step": 3, "third": 1 / 3, "nested": {"none": None}}
    write_state(tmp_path / "s", {"model": stored(network()), "average": {}}, words)
    parts, said = read_state(tmp_path / "s")
    assert same(parts["model"], stored(network()))
    assert parts["average"] == parts["optimizer"] == {}
    assert said == words


@given(place=st.floats(0, 1, exclude_max=True), flip=st.integers(1, 255))
@settings(max_examples=60)
def test_a_changed_byte_of_a_state_is_noticed_or_harmless(
    tmp_path_factory: pytest.TempPathFactory, place: float, flip: int
) -> None:
    path, words = tmp_path_factory.mktemp("state") / "s", {"step": 3}
    write_state(path, {"model": stored(network())}, words)
    data = bytearray(path.read_bytes())
    data[int(place * len(data))] ^= flip
    path.write_bytes(data)
    if (refused := refusal(path)) is None:
        parts, said = read_state(path)
        assert said == words
        assert all(parts["model"][name].equal(value) for name, value in stored(network()).items())
    else:
        assert str(path) in refused
        assert "\n" not in refused


@pytest.mark.parametrize("share", [0.0, 0.001, 0.1, 0.5, 0.99])
def test_a_state_cut_short_is_damaged(tmp_path: Path, share: float) -> None:
    path = tmp_path / "s"
    write_state(path, {"model": stored(network())}, {})
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    assert "damaged" in str(refusal(path))


def test_missing_and_foreign_states_are_named(tmp_path: Path) -> None:
    assert refusal(tmp_path / "s") == f"no file {tmp_path / 's'}"
    save_weights(tmp_path / "w", network(), {})  # good tensors, but no state
    assert "no checkpoint of a training run" in str(refusal(tmp_path / "w.safetensors"))
    (tmp_path / "t").write_text(json.dumps({"step": 3}))
    assert "no checkpoint of a training run" in str(refusal(tmp_path / "t"))
    assert "cannot read" in str(refusal(tmp_path))


def trained(model: nn.Module, optimizer: torch.optim.Optimizer, steps: int) -> None:
    for step in range(steps):
        x = torch.linspace(-1, 1, 12).view(4, 3) + step
        optimizer.zero_grad()
        model(x).square().mean().backward()
        optimizer.step()


def test_an_optimizer_goes_on_to_the_bit() -> None:
    model = network()
    model[2].bias.requires_grad_(False)  # some have nothing to remember
    optimizer = torch.optim.AdamW(model.parameters(), 0.1)
    trained(model, optimizer, 3)
    other = network(1)
    fill(other, stored(model), "")
    fresh = torch.optim.AdamW(other.parameters(), 0.1)
    fill_optimizer(other, fresh, optimizer_tensors(model, optimizer), "")
    other[2].bias.requires_grad_(False)
    trained(model, optimizer, 2)
    trained(other, fresh, 2)
    assert same(stored(other), stored(model))
    assert same(optimizer_tensors(other, fresh), optimizer_tensors(model, optimizer))


@pytest.mark.parametrize("change", [{"exp_avg.9.weight": torch.ones(5, 3)}, {"exp_avg.0.weight": torch.ones(4, 3)}])
def test_what_an_optimizer_remembers_of_another_network_is_refused(change: dict[str, torch.Tensor]) -> None:
    model = network()
    optimizer = torch.optim.AdamW(model.parameters(), 0.1)
    trained(model, optimizer, 1)
    with pytest.raises(InputError, match=rf"s: the optimizer's {next(iter(change))} fits no parameter"):
        fill_optimizer(model, optimizer, optimizer_tensors(model, optimizer) | change, "s")
