"""The completion network: its loss against autograd, cells seen free that do not count, inputs that only mirror."""

from __future__ import annotations

import pytest
import torch
import torch.nn.functional as F

from kit1000.perception.completion.parts import (
    CODE,
    JACCARD,
    CompletionConfig,
    CompletionNet,
    completion_loss,
    network_input,
)

SIZES = (2, 8, 8, 16)


def batch(seed: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Logits, codes, solid."""
    torch.manual_seed(seed)
    codes = torch.randint(-CODE, CODE + 1, SIZES, dtype=torch.int8)
    codes[torch.rand(SIZES) < 0.3] = CODE
    return 3 * torch.randn(SIZES), codes, torch.randint(0, 256, SIZES).to(torch.uint8)


def plain_loss(logits: torch.Tensor, codes: torch.Tensor, solid: torch.Tensor) -> torch.Tensor:
    """The loss as it is defined, an example at a time."""
    losses = []
    for one, code, share in zip(logits, codes, solid.float() / 255, strict=True):
        counts = code < CODE
        x, t = one[counts], share[counts]
        p = torch.sigmoid(x)
        both = (p * t).sum()
        jaccard = 1 - both / ((p + t).sum() - both)
        losses.append(F.binary_cross_entropy_with_logits(x, t) + JACCARD * jaccard)
    return torch.stack(losses).mean()


@pytest.mark.parametrize("seed", range(3))
def test_the_loss_and_its_gradient_are_those_of_the_definition(seed: int) -> None:
    logits, codes, solid = batch(seed)
    ours, theirs = (logits.clone().requires_grad_() for _ in range(2))
    loss, expected = completion_loss(ours, codes, solid), plain_loss(theirs, codes, solid)
    torch.testing.assert_close(loss, expected)
    (3 * loss).backward()
    (3 * expected).backward()
    assert ours.grad is not None
    assert theirs.grad is not None
    torch.testing.assert_close(ours.grad, theirs.grad, atol=1e-7, rtol=1e-4)
    assert (ours.grad[codes == CODE] == 0).all()


def test_a_part_that_is_all_seen_free_has_a_finite_loss() -> None:
    logits, codes, solid = batch(0)
    loss = completion_loss(logits.requires_grad_(), torch.full_like(codes, CODE), torch.zeros_like(solid))
    loss.backward()
    assert torch.isfinite(loss)
    assert logits.grad is not None
    assert (logits.grad == 0).all()


def test_mirrored_evidence_is_a_mirrored_image_and_the_net_has_a_logit_a_cell() -> None:
    torch.manual_seed(0)
    codes = torch.randint(-CODE, CODE + 1, (1, 40, 40, 208), dtype=torch.int8)
    camera = torch.tensor([[0.7, 0.9]])
    here, there = network_input(codes, camera), network_input(codes.flip(2), camera)
    torch.testing.assert_close(here.flip(3), there)
    net = CompletionNet(CompletionConfig(widths=(8, 8, 8, 8), blocks=1)).to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
    with torch.autocast("cpu", torch.bfloat16):
        logits = net.eval()(codes, camera)
    assert logits.shape == codes.shape
    assert torch.isfinite(logits).all()
