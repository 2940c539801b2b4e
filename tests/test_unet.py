"""The network of completion and restoration: folded normalisation changes nothing but the time it takes."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from baselines.unet import UNet, folded


def random_net(blocks: int) -> UNet:
    """A small one whose norms have seen data."""
    torch.manual_seed(blocks)
    net = UNet(3, 2, (8, 12, 16), blocks)
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
