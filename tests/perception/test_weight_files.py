"""Weights: read back to the bit or within rounding, damage is noticed, and folded networks say the same."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import nn

from kit1000.errors import InputError
from kit1000.perception.completion.kits import KitCompleter
from kit1000.perception.completion.parts import PartCompleter
from kit1000.perception.networks.precision import Precision
from kit1000.perception.networks.unet import BandedConv2d, UNet, UNetConfig, folded, in_float64
from kit1000.perception.networks.weight_files import LARGEST, copied_state, load_into, load_weights, save_weights
from kit1000.perception.placement.network import Placer
from kit1000.perception.restoration.restorer import Restorer
from kit1000.perception.segmentation.part_finder import PartFinder


def network(seed: int = 0, width: int = 5) -> nn.Sequential:
    """Weights, biases, running statistics and a counter."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        return nn.Sequential(nn.Linear(3, width), nn.BatchNorm1d(width), nn.Linear(width, 2))


def same(a: dict[str, torch.Tensor], b: dict[str, torch.Tensor]) -> bool:
    """To the bit."""
    return a.keys() == b.keys() and all(a[name].dtype == b[name].dtype and a[name].equal(b[name]) for name in a)


@pytest.fixture
def stem(tmp_path: Path) -> Path:
    return tmp_path / "position-0.89"  # not a suffix


def test_weights_are_read_back_to_the_bit_with_their_info(stem: Path) -> None:
    model, info = network(), {"steps": 7, "metrics": {"position_mm": 1.5}, "name": "größer"}
    save_weights(stem, model, info)
    tensors, read = load_weights(stem)
    assert same(tensors, copied_state(model))
    assert read == info
    assert sorted(path.name for path in stem.parent.iterdir()) == [f"{stem.name}.json", f"{stem.name}.safetensors"]


def test_half_weights_take_half_the_bytes_and_are_read_as_float32_within_rounding(stem: Path) -> None:
    model = network(width=400)
    save_weights(stem, model, {})
    whole = stem.with_name(stem.name + ".safetensors").stat().st_size
    save_weights(stem, model, {}, precision="float16")
    assert stem.with_name(stem.name + ".safetensors").stat().st_size < 0.6 * whole
    tensors, _ = load_weights(stem)
    for name, value in model.state_dict().items():
        assert tensors[name].dtype == value.dtype
        torch.testing.assert_close(tensors[name], value, rtol=2**-11, atol=2**-25)


def test_int8_weights_take_a_quarter_of_the_bytes_and_are_read_within_half_a_127th_of_their_row(stem: Path) -> None:
    model = nn.Linear(200, 100)
    model.weight.data[3] = 0  # a row without numbers has a scale too
    save_weights(stem, model, {})
    path = stem.with_name(stem.name + ".safetensors")
    whole = path.stat().st_size
    save_weights(stem, model, {}, precision="int8")
    assert path.stat().st_size < 0.3 * whole
    tensors, _ = load_weights(stem)
    row = model.weight.detach().abs().amax(1, keepdim=True)
    assert ((tensors["weight"] - model.weight).abs() <= row * (0.5001 / 127)).all()
    assert tensors["bias"].equal(model.bias)
    assert {value.dtype for value in tensors.values()} == {torch.float32}
    load_into(model, tensors, stem)


def test_without_pytorch_one_line_says_what_to_install() -> None:
    code = "import sys; sys.modules['torch'] = None; import kit1000.perception.networks.weight_files"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stderr.strip().endswith("the networks need PyTorch and safetensors: pip install 'kit1000[learn]'")


@pytest.mark.parametrize(
    ("precision", "number", "reason"), [("int8", torch.inf, "not finite"), ("float16", 1e5, "too large for float16")]
)
def test_numbers_beyond_a_precision_are_refused_before_anything_is_written(
    stem: Path, precision: Precision, number: float, reason: str
) -> None:
    model = network()
    model.get_parameter("0.weight").data[0, 0] = number
    with pytest.raises(InputError, match=rf"0\.weight has numbers .*{reason}"):
        save_weights(stem, model, {}, precision=precision)
    assert not list(stem.parent.iterdir())


def test_a_file_that_is_too_large_is_refused(stem: Path) -> None:
    model = nn.Linear(2048, LARGEST // 4 // 2048, bias=False)  # the tensors alone reach the limit
    with pytest.raises(InputError, match=r"16\.0 MiB.*more than.*16 MiB.*float16"):
        save_weights(stem, model, {})
    assert not list(stem.parent.iterdir())
    save_weights(stem, model, {}, precision="float16")
    save_weights(stem, model, {}, largest=None)


def test_shared_weights_are_written_for_each_name(stem: Path) -> None:
    model = nn.Sequential(nn.Linear(4, 4), nn.Linear(4, 4))
    model[1].weight = model[0].weight
    save_weights(stem, model, {})
    assert same(load_weights(stem)[0], copied_state(model))


@given(place=st.floats(0, 1, exclude_max=True), flip=st.integers(1, 255))
def test_any_changed_byte_of_weights_is_noticed(
    tmp_path_factory: pytest.TempPathFactory, place: float, flip: int
) -> None:
    stem = tmp_path_factory.mktemp("weights") / "w"
    save_weights(stem, network(), {})
    path = stem.with_suffix(".safetensors")
    data = bytearray(path.read_bytes())
    data[int(place * len(data))] ^= flip
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"w\.safetensors: damaged.*w\.json"):
        load_weights(stem)


def test_missing_and_foreign_files_are_named(stem: Path) -> None:
    json_path, tensors = (stem.with_name(stem.name + suffix) for suffix in (".json", ".safetensors"))
    with pytest.raises(InputError, match=r"no file .*\.json"):
        load_weights(stem)
    save_weights(stem, network(), {})
    tensors.unlink()
    with pytest.raises(InputError, match=r"no file .*\.safetensors"):
        load_weights(stem)
    json_path.write_text('{"steps": 3}')
    with pytest.raises(InputError, match="describes no weights"):
        load_weights(stem)
    json_path.write_text("{")
    with pytest.raises(InputError, match="damaged or no JSON"):
        load_weights(stem)


@pytest.mark.parametrize("make", [PartCompleter, KitCompleter, PartFinder, Placer, Restorer])
def test_weights_of_another_network_are_refused(stem: Path, make: Callable[[Path], Any]) -> None:
    save_weights(stem, network(), {"about": {"network": {"widths": [8, 8, 8]}}})
    with pytest.raises(InputError, match=r"which this network (has|has not);? "):
        make(stem)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"0.weight": None}, r"w\.st: has no 0\.weight, which this network has \(1 such\)"),
        ({"0.wieght": torch.ones(1)}, r"0\.wieght.*did you mean 0\.weight\?"),
        ({"0.weight": torch.ones(4, 3)}, r"0\.weight has the shape \(4, 3\), in this network \(5, 3\)"),
    ],
)
def test_tensors_of_another_network_are_refused_and_change_nothing(
    change: dict[str, torch.Tensor | None], message: str
) -> None:
    model = network()
    before = copied_state(model)
    changed = {name: value for name, value in (copied_state(network(1)) | change).items() if value is not None}
    with pytest.raises(InputError, match=message):
        load_into(model, changed, "w.st")
    assert same(copied_state(model), before)


def random_net(blocks: int) -> UNet:
    """A small one whose norms have seen data."""
    torch.manual_seed(blocks)
    net = UNet(3, 2, UNetConfig((8, 12, 16), blocks))
    for module in net.modules():
        if isinstance(module, nn.BatchNorm2d):
            for values, low, high in (
                (module.running_mean, -1.0, 1.0),
                (module.running_var, 0.2, 3.0),
                (module.weight, -1.0, 2.0),
                (module.bias, -1.0, 1.0),
            ):
                assert values is not None
                nn.init.uniform_(values, low, high)
    return net.eval()


@pytest.mark.parametrize("blocks", [1, 2])
def test_a_folded_network_says_the_same(blocks: int) -> None:
    net = random_net(blocks)
    before = {name: values.clone() for name, values in net.state_dict().items()}
    faster = folded(net)
    image = torch.randn(2, 3, 16, 24)
    with torch.inference_mode():
        expected, found = net.image(image), faster.image(image)
    assert expected.std() > 0.1
    torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-4)
    assert not any(isinstance(module, nn.BatchNorm2d) for module in faster.modules())
    assert all(torch.equal(values, before[name]) for name, values in net.state_dict().items())


@pytest.mark.parametrize("rows", [1, 3, 4, 5, 16])
def test_bands_of_rows_are_the_whole_convolution(rows: int) -> None:
    torch.manual_seed(rows)
    whole = nn.Conv2d(3, 5, 3, padding=1).double()
    image = torch.randn(2, 3, rows, 7, dtype=torch.float64)
    torch.testing.assert_close(BandedConv2d(whole)(image), whole(image), rtol=0, atol=1e-12)


def test_a_network_in_float64_says_the_same_with_more_digits() -> None:
    net, image = random_net(2), torch.randn(2, 3, 16, 24)
    exact = in_float64(net)
    with torch.inference_mode():
        expected, found = net.image(image), exact.image(image.double())
        torch.testing.assert_close(found, net.double().image(image.double()), rtol=0, atol=1e-9)
    assert found.dtype == torch.float64
    torch.testing.assert_close(found.float(), expected, rtol=1e-4, atol=1e-4)
    assert any(isinstance(module, BandedConv2d) for module in exact.modules())
    assert not any(isinstance(module, nn.Conv2d) and module.kernel_size == (3, 3) for module in exact.modules())
