"""The position network against a plain implementation of the release's scheme: seconds, ratios, differences.

    python bench/speed/snap_position.py
    python bench/speed/snap_position.py --presets small paper --batches 1 2 4 8

`plain` runs module by module: upsample, concatenate, convolve the whole volume, crop the features, correlate with the
padded features of the part as one grouped convolution. `ours` has the same weights. bfloat16 is faster where the CPU
multiplies in it (amx_bf16 or avx512_bf16); elsewhere it is measured only with --bf16.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
import torch.nn.functional as F
import tyro
from torch import Tensor

from baselines.snapnet.config import POSITION, PositionConfig
from baselines.snapnet.convolutions import correlate, cropped
from baselines.snapnet.position import Encoder, PositionNet, position_loss
from benchmark.measurements import Column, Measurement, Table
from kit1000.errors import Kit1000Error

BF16_FLAGS = {"amx_bf16", "avx512_bf16"}


SECONDS = (Column("wall", "s", 3), Column("wall_ratio", "times ours", 2))
PREDICTION_COLUMNS = (
    Column("preset", "preset"),
    Column("way", "network"),
    Column("n", "repeats"),
    *SECONDS,
    Column("cpu", "CPU s", 3),
    Column("cpu_ratio", "times ours", 2),
    Column("error", "largest difference, 1e-6", 2),
    Column("spread", "std of scores", 4),
)
STEP_COLUMNS = (
    Column("batch", "examples a step", 0),
    Column("n", "repeats"),
    Column("wall", "s a step", 3),
    Column("cpu", "CPU s", 3),
    Column("each", "s an example", 3),
    Column("ratio", "times the first", 2),
)


@dataclass(frozen=True)
class SnapPosition:
    """Time predictions (batch 1) of each preset, and training steps of the small one."""

    presets: tuple[str, ...] = ("small",)
    """small or paper."""
    batches: tuple[int, ...] = (1, 2, 4)
    """Examples of a training step."""
    repeats: int = 3
    """Number of timings of each; the fastest counts."""
    threads: int = 2
    """Number of PyTorch threads."""
    bf16: bool | None = None
    """Whether to predict in bfloat16 too; by default where the processor supports it."""
    device: str = "cpu"
    """cpu or cuda."""
    out: Path | None = None
    """JSON file of the tables, such as results/speed-snap-position.json."""


def main(options: SnapPosition) -> None:
    """Print the tables."""
    torch.set_num_threads(options.threads)
    torch.manual_seed(1)
    supported = options.device != "cpu" or bool(BF16_FLAGS & processor_flags())
    measurement = Measurement.begin()
    setting = f"{options.threads} threads on {options.device}"
    title = f"Seconds to predict by the position network, {setting}, fastest"
    table = measurement.table("prediction", title, *PREDICTION_COLUMNS)
    for preset in options.presets:
        _add_predictions(table, preset, options, supported if options.bf16 is None else options.bf16)
    if "small" in options.presets:
        title = f"Seconds of a training step, preset `small`, {setting}, fastest"
        _add_steps(measurement.table("training", title, *STEP_COLUMNS), options)
    measurement.report(options.out)
    print(f"bfloat16 of the processor: {'yes' if supported else 'no'}")


def _add_predictions(table: Table, preset: str, options: SnapPosition, bf16: bool) -> None:
    """Add a line each for plain, ours, and ours in bfloat16; differences are to sums in float64."""
    config = POSITION[preset]
    net = PositionNet(config).to(options.device).eval()
    part, kit, _ = example(config, 1, options.device)
    ways = (("plain", plain_scores), ("ours", scores_of), ("ours, bfloat16", bf16_scores))
    with torch.inference_mode():
        features = plain_features(net.part, part), cropped(plain_features(net.kit, kit), net.region)
        exact = correlate(features[0].double(), features[1].double(), config.window)
        found = {way: timed(lambda run=run: run(net, part, kit), options.repeats) for way, run in ways[: 2 + bf16]}
    ours = found["ours"][0]
    for way, (least, scores) in found.items():
        difference = (scores - scores.mean() - exact + exact.mean()).abs().max()
        ratios = {"wall_ratio": least[0] / ours[0], "cpu_ratio": least[1] / ours[1]}
        errors = {"error": 1e6 * float(difference), "spread": float(exact.std())}
        table.add(preset=f"`{preset}`", way=way, n=options.repeats, wall=least[0], cpu=least[1], **ratios, **errors)


def scores_of(net: PositionNet, part: Tensor, kit: Tensor) -> Tensor:
    return net(part, kit)


def bf16_scores(net: PositionNet, part: Tensor, kit: Tensor) -> Tensor:
    with torch.autocast(part.device.type, torch.bfloat16):
        return net(part, kit)


def _add_steps(table: Table, options: SnapPosition) -> None:
    """Add a line for each batch size with the seconds of a training step of the small preset."""
    config = POSITION["small"]
    net = PositionNet(config).to(options.device)
    adam = torch.optim.Adam(net.parameters(), 1e-4)
    first = None
    for batch in options.batches:
        part, kit, offset = example(config, batch, options.device)

        def step() -> Tensor:
            loss = position_loss(net(part, kit), offset, config).mean()  # noqa: B023
            adam.zero_grad()
            loss.backward()
            adam.step()
            return loss

        (wall, cpu), _ = timed(step, options.repeats)
        first = first or wall / batch
        table.add(batch=batch, n=options.repeats, wall=wall, cpu=cpu, each=wall / batch, ratio=wall / batch / first)


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
        main(tyro.cli(SnapPosition))
    except Kit1000Error as error:
        raise SystemExit(f"snap_position: {error}") from error
