"""The network of completion and restoration: folded norms and bands of rows change nothing but the time they take."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from kit1000.perception.networks.unet import BandedConv2d, UNet, UNetConfig, folded, in_float64


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


def test_a_network_in_training_is_folded_as_in_evaluation() -> None:
    net, image = random_net(1), torch.randn(1, 3, 8, 8)
    with torch.inference_mode():
        expected = net.image(image)
        found = folded(net.train()).image(image)
    assert net.training
    torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-4)


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
