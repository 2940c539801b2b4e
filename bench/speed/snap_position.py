"""The position network against a plain implementation of the release's scheme: seconds, ratios, differences.

    .venv/bin/python bench/speed/snap_position.py
    .venv/bin/python bench/speed/snap_position.py --presets small --batches 1 2 4 8

`plain` runs module by module: upsample, concatenate, convolve the whole volume, crop the features, correlate with the
padded features of the part as one grouped convolution. `ours` has the same weights. bfloat16 is faster where the CPU
multiplies in it (amx_bf16 or avx512_bf16); elsewhere it is measured only with --bf16.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import torch
import torch.nn.functional as F
import tyro
from torch import Tensor

from baselines.snapnet.config import POSITION, PositionConfig
from baselines.snapnet.convolutions import correlate, cropped
from baselines.snapnet.position import Encoder, PositionNet, position_loss
from kit1000.errors import Kit1000Error

BF16_FLAGS = {"amx_bf16", "avx512_bf16"}


def main(
    presets: tuple[str, ...] = ("small", "paper"),
    batches: tuple[int, ...] = (1, 2, 4, 8),
    repeats: int = 3,
    threads: int = 2,
    bf16: bool | None = None,
    device: str = "cpu",
) -> None:
    """Time predictions (batch 1) of each preset, and training steps of the small one.

    Args:
        presets: which.
        batches: of the training steps.
        repeats: how often each is timed; the fastest counts.
        threads: of torch.
        bf16: also predict in bfloat16; by default where the CPU supports it.
        device: cpu or cuda.
    """
    torch.set_num_threads(threads)
    torch.manual_seed(1)
    supported = device != "cpu" or bool(BF16_FLAGS & processor_flags())
    print(f"{threads} threads; bfloat16 of the CPU: {'yes' if supported else 'no'}")
    for preset in presets:
        print_predictions(preset, repeats, device, supported if bf16 is None else bf16)
    if "small" in presets:
        print_steps(batches, repeats, device)


def print_predictions(preset: str, repeats: int, device: str, bf16: bool) -> None:
    """Print a line each for plain, ours, and ours in bfloat16; differences are to sums in float64."""
    config = POSITION[preset]
    net = PositionNet(config).to(device).eval()
    part, kit, _ = example(config, 1, device)
    print(f"{'prediction':32}{'wall s':>10}{'ratio':>8}{'work s':>10}{'ratio':>8}{'diff':>10}{'of std':>10}")
    with torch.inference_mode():
        features = plain_features(net.part, part), cropped(plain_features(net.kit, kit), net.region)
        exact = correlate(features[0].double(), features[1].double(), config.window)
        took = (1.0, 1.0)
        for name, scores_by in (("plain", plain_scores), ("ours", scores_of), ("ours, bfloat16", bf16_scores))[
            : 2 + bf16
        ]:
            least, scores = timed(lambda run=scores_by: run(net, part, kit), repeats)
            took = least if scores_by is plain_scores else took
            difference = (scores - scores.mean() - exact + exact.mean()).abs().max()
            columns = "".join(f"{now:10.3f}{then / now:8.1f}" for now, then in zip(least, took, strict=True))
            print(f"{preset + ', ' + name:32}{columns}{difference:10.1e}{exact.std():10.1e}", flush=True)


def scores_of(net: PositionNet, part: Tensor, kit: Tensor) -> Tensor:
    return net(part, kit)


def bf16_scores(net: PositionNet, part: Tensor, kit: Tensor) -> Tensor:
    with torch.autocast(part.device.type, torch.bfloat16):
        return net(part, kit)


def print_steps(batches: tuple[int, ...], repeats: int, device: str) -> None:
    """Print seconds of a training step of the small preset, and steps in two hours."""
    config = POSITION["small"]
    net = PositionNet(config).to(device)
    adam = torch.optim.Adam(net.parameters(), 1e-4)
    for batch in batches:
        part, kit, offset = example(config, batch, device)

        def step() -> Tensor:
            loss = position_loss(net(part, kit), offset, config).mean()  # noqa: B023
            adam.zero_grad()
            loss.backward()
            adam.step()
            return loss

        (wall, work), _ = timed(step, repeats)
        title = f"small, step of {batch}"
        print(f"{title:32}{wall:10.3f}{'':8}{work:10.3f}{7200 / wall:12.0f} steps in two hours", flush=True)


def plain_scores(net: PositionNet, part: Tensor, kit: Tensor) -> Tensor:
    """The scores of `net`, by the release's scheme: (B, px, py, pz), (B, kx, ky, kz) -> (B, wx, wy, wz)."""
    batch, window = len(part), net.config.window
    key = F.pad(plain_features(net.kit, kit), (0, 1) * 3)  # the padded query may reach one behind the end
    query = F.pad(plain_features(net.part, part), (0, 1) * 3)  # (B, F, p/2 + 1, ...)
    for axis, (first, _) in enumerate(net.region, start=2):
        key = key.narrow(axis, first, query.shape[axis] + window[axis - 2] - 1)
    sums = F.conv3d(key.flatten(0, 1)[None], query.flatten(0, 1)[:, None], groups=key.shape[:2].numel())
    return sums.unflatten(1, (batch, -1))[0].sum(dim=1)  # (B, wx, wy, wz)


def plain_features(net: Encoder, volume: Tensor) -> Tensor:
    """The features of the encoder, module by module: (B, x, y, z) -> (B, F, x/2, y/2, z/2)."""
    d1 = F.relu(net.d1(volume[:, None]))
    d2 = F.relu(net.d2(d1))
    d3 = F.relu(net.d3(d2))
    d4 = F.relu(net.d4(d3))
    features = F.relu(net.b(d4))
    for layer, fine in ((net.u1, d4), (net.u2, d3), (net.u3, d2)):
        concatenated = torch.cat([fine, F.interpolate(features, scale_factor=2.0)], dim=1)
        features = F.relu(F.conv3d(concatenated, layer.weight, layer.bias, padding=1))
    return net.f(features)


def example(config: PositionConfig, batch: int, device: str) -> tuple[Tensor, Tensor, Tensor]:
    """Volumes of noise and offsets inside the window."""
    part = torch.rand(batch, *config.part_cells, device=device) * 2 - 1
    kit = torch.rand(batch, *config.kit_cells, device=device) * 2 - 1
    reach = torch.tensor([count // 2 - 1 for count in config.window], device=device) * 2 * config.voxel
    return part, kit, (torch.rand(batch, 3, device=device) * 2 - 1) * reach


def timed(make: Callable[[], Tensor], repeats: int) -> tuple[tuple[float, float], Tensor]:
    """Fewest wall seconds, fewest CPU seconds (which other programs do not lengthen), and the result."""
    made = make()
    walls, works = [], []
    for _ in range(repeats):
        wall, work = time.perf_counter(), time.process_time()
        made = make()
        if made.is_cuda:
            torch.cuda.synchronize()
        walls.append(time.perf_counter() - wall)
        works.append(time.process_time() - work)
    return (min(walls), min(works)), made


def processor_flags() -> set[str]:
    """The features of the CPU, on Linux; empty elsewhere."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text(encoding="utf-8").splitlines() if cpuinfo.is_file() else []
    return {flag for line in lines if line.startswith("flags") for flag in line.split()}


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except Kit1000Error as error:
        raise SystemExit(f"snap_position: {error}") from error
