"""The position network beside a plain form of the release's scheme, timed in one run: seconds, ratios, agreement.

    .venv/bin/python bench/bench_snap_position.py
    .venv/bin/python bench/bench_snap_position.py --presets small --batches 1 2 4 8

`plain` goes module by module: upsample, join, convolve the whole volume, cut out the middle of the features, slide the
padded features of the part over it as one grouped convolution. `ours` has the same weights. bfloat16 pays where the
processor multiplies in it (amx_bf16 or avx512_bf16); elsewhere it is left out unless asked for.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import torch
import torch.nn.functional as F
import tyro
from torch import Tensor

from baselines.layers import correlate, cut
from baselines.snapnet.config import POSITION, PositionConfig
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
    """Time answers (batch 1) of each preset, and training steps of the small one.

    Args:
        presets: which.
        batches: of the training steps.
        repeats: how often each is timed; the fastest counts.
        threads: of torch.
        bf16: also answer in bfloat16; by default where the processor can.
        device: cpu or cuda.
    """
    torch.set_num_threads(threads)
    torch.manual_seed(1)
    able = device != "cpu" or bool(BF16_FLAGS & processor_flags())
    print(f"{threads} threads; bfloat16 in the processor: {'yes' if able else 'no'}")
    for preset in presets:
        print_answers(preset, repeats, device, able if bf16 is None else bf16)
    if "small" in presets:
        print_steps(batches, repeats, device)


def print_answers(preset: str, repeats: int, device: str, bf16: bool) -> None:
    """Print a line each for plain, ours, and ours in bfloat16; the gap is to sums in float64, all less their mean."""
    config = POSITION[preset]
    net = PositionNet(config).to(device).eval()
    part, kit, _ = example(config, 1, device)
    print(f"{'answer':32}{'wall s':>10}{'ratio':>8}{'work s':>10}{'ratio':>8}{'gap':>10}{'of std':>10}")
    with torch.inference_mode():
        features = plain_features(net.part, part), cut(plain_features(net.kit, kit), net.region)
        exact = correlate(features[0].double(), features[1].double(), config.window)
        took = (1.0, 1.0)
        for name, answer in (("plain", plain_scores), ("ours", scores_of), ("ours, bfloat16", bf16_scores))[: 2 + bf16]:
            least, scores = timed(lambda ask=answer: ask(net, part, kit), repeats)
            took = least if answer is plain_scores else took
            gap = (scores - scores.mean() - exact + exact.mean()).abs().max()
            columns = "".join(f"{now:10.3f}{then / now:8.1f}" for now, then in zip(least, took, strict=True))
            print(f"{preset + ', ' + name:32}{columns}{gap:10.1e}{exact.std():10.1e}", flush=True)


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
    """What `net` answers, by the release's scheme: (B, px, py, pz), (B, kx, ky, kz) -> (B, wx, wy, wz)."""
    batch, window = len(part), net.config.window
    key = F.pad(plain_features(net.kit, kit), (0, 1) * 3)  # the padded query may reach one behind the end
    query = F.pad(plain_features(net.part, part), (0, 1) * 3)  # (B, F, p/2 + 1, ...)
    for axis, (first, _) in enumerate(net.region, start=2):
        key = key.narrow(axis, first, query.shape[axis] + window[axis - 2] - 1)
    sums = F.conv3d(key.flatten(0, 1)[None], query.flatten(0, 1)[:, None], groups=key.shape[:2].numel())
    return sums.unflatten(1, (batch, -1))[0].sum(dim=1)  # (B, wx, wy, wz)


def plain_features(net: Encoder, volume: Tensor) -> Tensor:
    """What the encoder answers, module by module: (B, x, y, z) -> (B, F, x/2, y/2, z/2)."""
    d1 = F.relu(net.d1(volume[:, None]))
    d2 = F.relu(net.d2(d1))
    d3 = F.relu(net.d3(d2))
    d4 = F.relu(net.d4(d3))
    features = F.relu(net.b(d4))
    for layer, fine in ((net.u1, d4), (net.u2, d3), (net.u3, d2)):
        joined = torch.cat([fine, F.interpolate(features, scale_factor=2.0)], dim=1)
        features = F.relu(F.conv3d(joined, layer.weight, layer.bias, padding=1))
    return net.f(features)


def example(config: PositionConfig, batch: int, device: str) -> tuple[Tensor, Tensor, Tensor]:
    """Volumes of noise and offsets within the window."""
    part = torch.rand(batch, *config.part_cells, device=device) * 2 - 1
    kit = torch.rand(batch, *config.kit_cells, device=device) * 2 - 1
    reach = torch.tensor([count // 2 - 1 for count in config.window], device=device) * 2 * config.voxel
    return part, kit, (torch.rand(batch, 3, device=device) * 2 - 1) * reach


def timed(make: Callable[[], Tensor], repeats: int) -> tuple[tuple[float, float], Tensor]:
    """Least wall seconds, least processor seconds (the machine may be busy with other things), and what was made."""
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
    """What the processor can do, as Linux tells; nothing elsewhere."""
    told = Path("/proc/cpuinfo")
    lines = told.read_text(encoding="utf-8").splitlines() if told.is_file() else []
    return {flag for line in lines if line.startswith("flags") for flag in line.split()}


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except Kit1000Error as error:
        raise SystemExit(f"bench_snap_position: {error}") from error
