"""The rotation network against a plain PointNet++ with the same weights: seconds, and differences of the logits.

    python bench/speed/snap_rotation.py

The plain one processes the candidates in chunks, as the release does: in each it samples centres, finds neighbours by
sorting all distances, gathers groups and maps them by convolutions, for the kits as for the part.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import tyro
from scipy.ndimage import distance_transform_edt, map_coordinates
from torch import Tensor, nn

from baselines.snapnet.candidate_rotations import candidates
from baselines.snapnet.config import ROTATION, RotationConfig
from baselines.snapnet.points import rotated
from baselines.snapnet.rotation import COUNTS, RADII, RotationNet, rotation_loss
from baselines.snapnet.set_abstraction import MLP, Dense, SetAbstraction, squared_distances
from bench.speed.timing import Clock, fastest
from benchmark.measurements import Column, Measurement, rate
from kit1000.errors import Kit1000Error
from kit1000.perception.networks.weight_files import load_into, load_weights
from kit1000.rng import stream

Scene = tuple[Tensor, Tensor, Tensor]  # points of part and kits, and the volume of the kits

CHUNK = 20  # candidates that the release scores together


SCORE_COLUMNS = (
    Column("preset", "preset"),
    Column("way", "network"),
    Column("n", "candidates"),
    Column("timed", "of these timed", 0),
    Column("seconds", "s a scene", 2),
    Column("ratio", "times ours", 1),
    Column("error", "largest difference of a logit, 1e-6", 1),
    Column("largest", "largest logit", 1),
)
STEP_COLUMNS = (
    Column("preset", "preset"),
    Column("n", "candidates"),
    Column("seconds", "s a step", 2),
    Column("ratio", "times a scene", 2),
)
BF16_COLUMNS = (Column("n", "scenes"), Column("candidates", "candidates", 0), Column("same", "same choice, %", 1, True))


@dataclass(frozen=True)
class SnapRotation:
    """Time one scene of random points."""

    preset: str = "small"
    """small or paper."""
    weights: Path | None = None
    """Trained weights without suffix; with random ones the choices of bfloat16 mean nothing."""
    seconds: float = 20
    """About how long the plain network may run; the time of its remaining candidates is extrapolated."""
    threads: int = 1
    """Number of PyTorch threads. With one, seconds are CPU time, which other programs do not lengthen."""
    scenes: int = 30
    """Number of scenes in which the choices of bfloat16 are compared, where there are weights."""
    seed: int = 0
    """Seed of points and weights."""
    out: Path | None = None
    """JSON file of the tables, such as results/speed-snap-rotation.json."""


def main(options: SnapRotation) -> None:
    """Print the tables."""
    torch.set_num_threads(options.threads)
    config = ROTATION[options.preset]
    net = random_net(config, options.seed)
    if options.weights:
        load_into(net, load_weights(options.weights)[0], options.weights)
    scene = random_scene(config, options.seed)
    rotations = torch.from_numpy(np.array(candidates("ball").wxyz))[None]
    clock = time.process_time if options.threads == 1 else time.perf_counter
    with torch.inference_mode():
        ours, logits = fastest(lambda: net(*scene[:2], rotations, scene[2]), 3, clock)
        plain, chunks = plain_run(clock, net, scene, rotations, options.seconds)
    number, done = rotations.shape[1], plain.shape[1]
    whole = chunks * number / done
    difference = {"error": 1e6 * float((logits[:, :done] - plain).abs().max()), "largest": float(logits.abs().max())}
    measurement = Measurement.begin()
    unit = "CPU seconds" if options.threads == 1 else "Seconds"
    title = f"{unit} of the rotation network, {config.part_points} + {config.kit_points} points"
    table = measurement.table("scores", title, *SCORE_COLUMNS)
    line = {"preset": f"`{options.preset}`", "n": number}
    table.add(**line, way="plain", timed=done, seconds=whole, ratio=whole / ours, **difference)
    table.add(**line, way="ours", timed=number, seconds=ours, ratio=1.0, largest=difference["largest"])
    step = training_step(clock, net, scene, rotations)
    table = measurement.table("training", f"{unit} of a training step", *STEP_COLUMNS)
    table.add(preset=line["preset"], n=config.training_candidates, seconds=step, ratio=step / ours)
    if options.weights:
        few = rotations[:, ::16]
        same = rate(same_best(net, config, few, options.scenes))
        table = measurement.table("bfloat16", "Scenes in which bfloat16 chooses as float32", *BF16_COLUMNS)
        table.add(n=options.scenes, candidates=few.shape[1], same=same)
    measurement.report(options.out)


def plain_run(clock: Clock, net: RotationNet, scene: Scene, rotations: Tensor, seconds: float) -> tuple[Tensor, float]:
    """Logits of as many chunks as fit into the time, at least one, and the seconds they took."""
    start, found = clock(), []
    for chunk in rotations.split(CHUNK, 1):
        found.append(plain_scores(net, *scene[:2], chunk, scene[2]))
        if clock() - start > seconds:
            break
    return torch.cat(found, 1), clock() - start


def plain_scores(net: RotationNet, part: Tensor, kit: Tensor, rotations: Tensor, volume: Tensor) -> Tensor:
    """The same function of the same weights, computed anew for each candidate. Rotations (1, n, 4) -> (1, n)."""
    number, config = rotations.shape[1], net.config
    scale = torch.cat([part, kit], 1).norm(dim=-1).max()
    part_points, kit_points = (cloud.expand(number, -1, -1) / scale for cloud in (part, kit))
    moved = rotated(part / scale, rotations)[0]  # (n, P, 3)
    features = plain_distances(part, kit, rotations, volume, config) if config.kit_distance else None
    for stage, level in enumerate(net.levels):
        assert isinstance(level, SetAbstraction)
        half = config.centres[stage] // 2
        chosen = [plain_farthest(part_points, half), plain_farthest(kit_points, config.centres[stage] - half)]
        places = with_flag(moved, kit_points, config)
        points = part_points.shape[1]
        centres = torch.cat([chosen[0], chosen[1] + points], 1)
        found = []
        for layers, radius, count in zip(level.scales, RADII[stage], COUNTS[stage], strict=True):
            k = max(2, round(count * config.neighbours[stage]))
            index = plain_groups(part_points, moved, kit_points, chosen, radius, k)
            rows = gather(places, index.flatten(1)).unflatten(1, index.shape[1:]) - gather(places, centres)[:, :, None]
            if features is not None:
                rows = torch.cat([rows, gather(features, index.flatten(1)).unflatten(1, index.shape[1:])], -1)
            assert isinstance(layers, MLP)
            found.append(convolved(layers, rows.permute(0, 3, 1, 2)).amax(3).transpose(1, 2))
        features = torch.cat(found, -1)
        part_points, moved, kit_points = (
            gather(part_points, chosen[0]),
            gather(moved, chosen[0]),
            gather(kit_points, chosen[1]),
        )
    assert features is not None
    rows = torch.cat([with_flag(moved, kit_points, config), features], -1).transpose(1, 2)[..., None]
    return net.head(convolved(net.last, rows).amax((2, 3))).T


def plain_distances(part: Tensor, kit: Tensor, rotations: Tensor, volume: Tensor, config: RotationConfig) -> Tensor:
    """The kits' distance at the rotated part's points, 0 for the kits' points. (n, P + K, 1)."""
    middle = np.array(volume.shape[1:]) // 2
    places = np.moveaxis(rotated(part, rotations)[0].numpy() / config.voxel + middle, -1, 0)
    found = map_coordinates(volume[0].numpy(), places, order=1, mode="nearest")
    return nn.functional.pad(torch.from_numpy(found.astype(np.float32))[..., None], (0, 0, 0, kit.shape[1]))


def convolved(layers: Iterable[Dense], image: Tensor) -> Tensor:
    """(n, F, G, k) through 1 x 1 convolutions, norms and ReLUs."""
    for layer in layers:
        mapped = nn.functional.conv2d(image, layer.linear.weight[:, :, None, None])
        norm = layer.norm
        mean, var = norm.running_mean, norm.running_var
        image = torch.relu(nn.functional.batch_norm(mapped, mean, var, norm.weight, norm.bias, False, 0.0, norm.eps))
    return image


def plain_groups(
    part_points: Tensor, moved: Tensor, kit_points: Tensor, chosen: list[Tensor], radius: float, k: int
) -> Tensor:
    """Members (n, G, k) in the bank of part and kits."""
    points = part_points.shape[1]
    same = plain_ball_query(gather(part_points, chosen[0]), part_points, radius, k - k // 2)
    across = plain_ball_query(gather(moved, chosen[0]), kit_points, radius, k // 2)
    across = torch.where(across < 0, same[..., :1], across + points)
    kits = padded(plain_ball_query(gather(kit_points, chosen[1]), kit_points, radius, k)) + points
    return torch.cat([torch.cat([padded(same), across], -1), kits], 1)


def padded(index: Tensor) -> Tensor:
    """The first index in place of missing ones (-1)."""
    return torch.where(index < 0, index[..., :1], index)


def plain_ball_query(centres: Tensor, points: Tensor, radius: float, k: int) -> Tensor:
    """First k indices within the radius, by sorting all; -1 where there are no more."""
    distance = squared_distances(centres[:, :, None], points[:, None])
    order = torch.arange(points.shape[1]).expand(distance.shape).clone()
    order[distance > np.float32(radius) ** 2] = points.shape[1]
    first = order.sort(-1).values[..., :k]
    first = torch.where(first == points.shape[1], -1, first)
    return nn.functional.pad(first, (0, k - first.shape[-1]), value=-1)


def plain_farthest(points: Tensor, count: int) -> Tensor:
    """Farthest points, one after another."""
    chosen = torch.zeros(len(points), count, dtype=torch.long)
    nearest, last = torch.full(points.shape[:2], torch.inf), torch.zeros(len(points), dtype=torch.long)
    for step in range(count):
        chosen[:, step] = last
        nearest = torch.minimum(nearest, squared_distances(points, gather(points, last[:, None])))
        last = nearest.max(-1).indices
    return chosen


def gather(points: Tensor, index: Tensor) -> Tensor:
    """(n, N, F) at (n, S) -> (n, S, F)."""
    return points[torch.arange(len(points))[:, None], index]


def with_flag(moved: Tensor, kit_points: Tensor, config: RotationConfig) -> Tensor:
    sign = 1.0 if config.flag == "paper" else -1.0
    clouds = ((moved, sign), (kit_points, -sign))
    return torch.cat([nn.functional.pad(cloud, (0, 1), value=value) for cloud, value in clouds], 1)


def random_net(config: RotationConfig, seed: int) -> RotationNet:
    """Random weights, norms fitted to a scene, and logits of up to about 10, as trained ones have."""
    torch.manual_seed(seed)
    net = RotationNet(config)
    part, kit, volume = random_scene(config, seed + 1)
    rotations = torch.from_numpy(np.array(candidates("ball").wxyz[::40]))[None]
    with torch.no_grad():
        for _ in range(20):
            net.train()(part, kit, rotations, volume)
        last = net.eval().head[-1]
        assert isinstance(last, nn.Linear)
        last.weight *= 10 / net(part, kit, rotations, volume).abs().max()
    return net


def random_scene(config: RotationConfig, seed: int) -> Scene:
    """A box of 50 x 40 x 25 mm in a block with room for it: (1, n, 3) float32 [m], and (1, nx, ny, nz) float32."""
    rng = stream(seed, "bench", "rotation")
    part = rng.uniform(-1, 1, (config.part_points, 3)) * (25e-3, 20e-3, 12.5e-3)
    reach = np.array(config.kit_cells) * config.voxel / 2
    kit = rng.uniform(-1, 1, (20 * config.kit_points, 3)) * reach
    kit = kit[solid(kit)][: config.kit_points]
    middles = np.moveaxis(np.indices(config.kit_cells), 0, -1) - np.array(config.kit_cells) // 2
    inside = solid(middles * config.voxel)
    out, deep = (np.asarray(distance_transform_edt(cells)) for cells in (~inside, inside))
    arrays = part, kit, np.clip((out - deep) / 5, -1, 1)
    part, kit, volume = (torch.from_numpy(array.astype(np.float32))[None] for array in arrays)
    return part, kit, volume


def solid(places: np.ndarray) -> np.ndarray:
    """Whether points (..., 3) [m] are inside the block."""
    hole = np.all(np.abs(places[..., :2]) < (27.5e-3, 22.5e-3), axis=-1) & (places[..., 2] > -12.5e-3)
    return ~hole & (places[..., 2] < 6e-3)


def training_step(clock: Clock, net: RotationNet, scene: Scene, rotations: Tensor) -> float:
    """Seconds forward and backward, the best of five."""
    net = copy.deepcopy(net).train()
    some = rotations[:, : net.config.training_candidates]

    def step() -> None:
        logits = net(*scene[:2], some, scene[2])
        rotation_loss(logits, torch.zeros(1, dtype=torch.long), torch.ones_like(logits), net.config).sum().backward()

    return fastest(step, 5, clock)[0]


def same_best(net: RotationNet, config: RotationConfig, rotations: Tensor, scenes: int) -> list[bool]:
    """Whether bfloat16 chooses as float32, in random scenes."""
    half = copy.deepcopy(net)
    half.levels.to(torch.bfloat16)
    same = []
    with torch.inference_mode():
        for scene in range(scenes):
            part, kit, volume = random_scene(config, 100 + scene)
            chosen = [each(part, kit, rotations, volume).argmax().item() for each in (net, half)]
            same.append(chosen[0] == chosen[1])
    return same


if __name__ == "__main__":
    try:
        main(tyro.cli(SnapRotation))
    except Kit1000Error as error:
        raise SystemExit(f"snap_rotation: {error}") from error
