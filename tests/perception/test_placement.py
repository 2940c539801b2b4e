"""The network that places fits: untrained it is plain least squares, exact for small moves; mirrored patches agree."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from kit1000.perception.networks.unet import UNetConfig
from kit1000.perception.placement import CELLS, Channel
from kit1000.perception.placement.network import (
    HOLD,
    LEVER,
    MIRRORED,
    MOVE_STEP,
    SHARE,
    PlacementNet,
    Placer,
    cavity_slopes,
    placed,
)

SMALL = UNetConfig(widths=(8, 8, 8))
UNITS = np.array([LEVER, 1e3, 1e3])
HELD = np.array([0.75, 0.45, 0.45])  # shares of a move by which a fit may be held where it was


def noise(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, 0.5, (len(Channel), CELLS, CELLS)).astype(np.float32)


def network(trained: bool) -> PlacementNet:
    """trained: with weights at random at its end too."""
    torch.manual_seed(0)
    net = PlacementNet(SMALL)
    if trained:
        torch.nn.init.normal_(net.head.weight, std=0.1)
    return net.eval()


def smooth_cavity(yaw: float = 0.0, x_mm: float = 0.0, y_mm: float = 0.0) -> np.ndarray:
    """(n, n) [px] of a cavity of an odd shape with soft rims, rotated about the middle and shifted."""
    along = np.arange(CELLS) - (CELLS - 1) / 2
    x, y = np.meshgrid(along - x_mm, along - y_mm, indexing="ij")
    u, v = np.cos(yaw) * x + np.sin(yaw) * y, np.cos(yaw) * y - np.sin(yaw) * x
    inside = np.minimum(np.minimum(18 - np.abs(u), 11 - np.abs(v)), np.hypot(u - 18, v - 11) - 9)
    return -1.2 / (1 + np.exp(-inside / 2.5))


def patch_of(shown: np.ndarray, cavity: np.ndarray) -> np.ndarray:
    channels = np.zeros((len(Channel), CELLS, CELLS), np.float32)
    channels[[Channel.RESTORED, Channel.MEASURED]] = shown
    channels[[Channel.IS_RESTORED, Channel.IS_MEASURED]] = 1
    channels[[Channel.CAVITY, Channel.WIDER, Channel.SLIMMER]] = cavity
    return channels


@given(yaw=st.floats(-0.05, 0.05), x_mm=st.floats(-1.0, 1.0), y_mm=st.floats(-1.0, 1.0))
def test_untrained_it_finds_where_the_image_shows_the_cavity(yaw: float, x_mm: float, y_mm: float) -> None:
    move = Placer(network(trained=False))(patch_of(smooth_cavity(yaw, x_mm, y_mm), smooth_cavity()))
    true = np.array([LEVER * yaw, x_mm, y_mm])
    assert (np.abs(move * UNITS / SHARE - true) < HELD * np.abs(true) + 0.2).all()


def test_a_face_that_is_bent_moves_nothing() -> None:
    along = np.linspace(-0.2, 0.2, CELLS)
    bent = smooth_cavity() + 0.3 + along[:, None] - 0.5 * along
    move = Placer(network(trained=False))(patch_of(bent, smooth_cavity()))
    np.testing.assert_allclose(move * UNITS, 0, atol=0.05)


@pytest.mark.parametrize("which", [0, 1, 2])
def test_slopes_are_those_of_rendered_cavities(which: int) -> None:
    step = np.eye(3)[which] * (0.02, 0.4, 0.4)
    ahead, behind = (torch.from_numpy(smooth_cavity(*(sign * step)))[None] for sign in (1, -1))
    slopes = cavity_slopes(torch.from_numpy(smooth_cavity())[None])[0, which].numpy()
    differences = ((ahead - behind) / (2 * (step[which] * (LEVER if which == 0 else 1.0))))[0].numpy()
    assert np.corrcoef(slopes.ravel(), differences.ravel())[0, 1] > 0.9  # slopes are of averaged cavities


def test_the_least_squares_are_those_of_numpy() -> None:
    rng = np.random.default_rng(0)
    slopes, residuals, weights = rng.normal(size=(3, 8, 8)), rng.normal(size=(8, 8)), rng.random((8, 8))
    along = (np.arange(8) - 3.5) / 4
    bend = np.stack([np.ones((8, 8)), np.broadcast_to(along[:, None], (8, 8)), np.broadcast_to(along, (8, 8))])
    terms = np.concatenate([slopes, bend]).reshape(6, -1)
    held = np.diag(np.sqrt([HOLD] * 3 + [1e-2] * 3))
    root = np.sqrt(weights.ravel())
    expected = np.linalg.lstsq(
        np.concatenate([(terms * root).T, held]), np.append(root * residuals.ravel(), np.zeros(6)), rcond=None
    )[0][:3]
    found = placed(*(torch.from_numpy(each)[None] for each in (slopes, residuals, weights)))
    np.testing.assert_allclose(found[0].numpy(), expected, rtol=1e-9)


def test_cells_without_weight_count_for_nothing() -> None:
    shown, cavity = smooth_cavity(0.0, 1.0, 0.0), smooth_cavity()
    half = patch_of(shown, cavity)
    half[[Channel.IS_RESTORED, Channel.IS_MEASURED], :, CELLS // 2 :] = 0
    wrong = half.copy()
    wrong[[Channel.RESTORED, Channel.MEASURED], :, CELLS // 2 :] = 5.0
    placer = Placer(network(trained=False))
    np.testing.assert_array_equal(placer(half), placer(wrong))


@given(seed=st.integers(0, 5))
def test_a_patch_and_its_mirror_image_are_asked_alike(seed: int) -> None:
    """The network knows which is which: the shadows of a stereo camera lie on one side."""
    net, seen = network(trained=True), noise(seed)
    with torch.inference_mode():
        plain, mirrored = (
            net(torch.from_numpy(each)[None], torch.tensor([is_mirrored]))[0].numpy()
            for each, is_mirrored in ((seen, False), (seen[:, :, ::-1].copy(), True))
        )
    move = Placer(net)(seen) * UNITS
    np.testing.assert_allclose(move, SHARE * (plain + MIRRORED * mirrored) / 2, atol=2 * MOVE_STEP)
    np.testing.assert_allclose(move / MOVE_STEP, np.rint(move / MOVE_STEP), atol=1e-6)


def test_nothing_shown_moves_nothing() -> None:
    assert not Placer(network(trained=True))(np.zeros((len(Channel), CELLS, CELLS), np.float32)).any()
