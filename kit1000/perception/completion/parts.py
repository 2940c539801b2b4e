"""The network that completes parts, its frame (a grid on the table that looks away from the camera), and its use.

The x axis of the grid points away from the camera along the table, its z axis up from the table; its middle lies below
the middle of what is seen of the part. So the scene may stand anywhere, at any yaw, and the input is the same. A part
larger than those that the network learned from is shown to it at their size, with its scene. Height layers are
channels, so that 2-D convolutions complete a 3-D shape: 2 x 2 cells of all layers are the channels of a pixel
(`packed`). B batch, C channels; features are (B, C, x, y), channels last in memory.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from kit1000.camera import Camera
from kit1000.numerics.compiled import compiled
from kit1000.perception.calibration import flattened
from kit1000.perception.networks.inference import on_cpu, on_grid
from kit1000.perception.networks.unet import UNet, UNetConfig
from kit1000.perception.observed.columns import ObservedColumns
from kit1000.perception.observed.parts import ObservedPart, PartBounds
from kit1000.perception.observed.pixels import cropped, pixel_points
from kit1000.pose import Pose
from kit1000.values import LabelledDepth, View
from kit1000.voxels import Grid, Volume, tsdf

CELL = 1e-3  # [m]
SHAPE = (80, 80, 52)
"""Cells: they hold a part of 50 mm in any resting pose, and what its outline leaves open of its middle."""
TRUNCATION = 5e-3  # [m]
CODE = 127  # of a distance of one truncation; unknown cells have the code -CODE
PACK = 2  # cells along x and along y that are channels of one pixel of the network
OUTLIERS = 0.02  # share of the seen points that is cut off at either end of each axis
LARGEST = np.array([64e-3, 64e-3, 52e-3])  # [m] seen extents of parts of 50 mm, of which the network learns
TYPICAL = 43e-3  # [m] the median of the longest of these extents
YAW_DECIMALS = 12  # of the frame: the last digit of an arctangent depends on the processor
EXTRA = 4  # channels of place and camera
JACCARD = 0.5  # weight of the Jaccard distance in the loss
MIDDLE_POLAR, MIDDLE_DISTANCE = 0.8, 0.8  # [rad], [m] of the cameras, which are the origin of their channels
TEMPERATURE = 1.35  # by which logits are divided, so that probabilities are shares; fitted to the split val
LIKELY, LIKELY_NOISY = 0.2, -0.4  # logits above which a cell is taken as solid: there the IoU is largest (split val)
LOGIT_STEP = 1 / 64  # to which logits are rounded: sums of float32 depend on the processor
SEEN_FREE = -12.0  # logit of cells that are seen free


@dataclass(frozen=True, eq=False)
class FramedPart:
    """What one image shows of a part, in the frame of the network."""

    grid: Grid
    codes: np.ndarray
    """SHAPE int8: CODE times the projective distance in truncations, positive is free; unknown cells -CODE."""
    camera: np.ndarray
    """(2,) float32: polar angle [rad] and distance [m] of the camera from the foot of the middle."""


def framed(
    image: LabelledDepth, label: int, table_height: float = 0.0, flat: bool = True, scale: float = 1.0
) -> FramedPart | None:
    """What an image shows of a part; None if no pixel of it has a return, or if it is larger than the grid.

    Args:
        image: the depth image with its masks.
        label: of the part.
        table_height: [m] of the table in this image.
        flat: put the pixels of the table on its plane, see `perception.calibration.flattened`; ideal depth needs none.
        scale: by which the scene is shrunk, so that a larger part looks as if it were of the size of those learned.
    """
    lowered = _shrunk(image.view, table_height, scale)
    grid = _grid(lowered, image.labels == label)
    if grid is None:
        return None
    crop = cropped(LabelledDepth(lowered, image.labels), pixel_box(grid, lowered.camera, lowered.world_from_camera))
    view = flattened(crop.view, crop.labels) if flat else crop.view
    values = tsdf(grid, view, crop.labels == label, TRUNCATION, threads=1).values
    codes = np.rint(CODE * np.where(np.isnan(values), np.float32(-1), values)).astype(np.int8)
    return FramedPart(_enlarged(grid, table_height, scale), codes, _camera(lowered, grid))


def scale_of(image: LabelledDepth, label: int, table_height: float = 0.0) -> float:
    """Factor that shrinks the scene of a part: 1 unless it is seen to be LARGEST or more, then to a TYPICAL part.

    The arguments are those of `framed`.
    """
    extents = _extents(_shrunk(image.view, table_height, 1.0), image.labels == label)
    if extents is None or (extents.sizes <= LARGEST).all():
        return 1.0
    return float(extents.sizes.max()) / TYPICAL


def grid_at(x: float, y: float, yaw: float) -> Grid:
    """The grid on the table, its middle above a point [m], its x axis at a yaw [rad]."""
    return Grid.centred(Pose.from_rotvec((0.0, 0.0, yaw), (x, y, CELL * SHAPE[2] / 2)), SHAPE, CELL)


def _shrunk(view: View, table_height: float, scale: float) -> View:
    """A view of the scene on a table at height 0, all lengths divided by a scale."""
    pose = view.world_from_camera
    foot = (pose.xyz - (0.0, 0.0, table_height)) / scale
    return View(view.camera, Pose(pose.wxyz, foot), view.depth / np.float32(scale))


def _enlarged(grid: Grid, table_height: float, scale: float) -> Grid:
    """A grid in the scene of a `_shrunk` view, in the scene as it is."""
    pose = grid.world_from_grid
    foot = scale * pose.xyz + (0.0, 0.0, table_height)
    return replace(grid, world_from_grid=Pose(pose.wxyz, foot), voxel_size=scale * grid.voxel_size)


class _Extents(NamedTuple):
    """Extents of what is seen of a part, without the OUTLIERS, in a world whose table is at height 0."""

    yaw: float
    """[rad] of the direction away from the camera."""
    middle: np.ndarray
    """(3,) [m] of the box in that direction."""
    sizes: np.ndarray
    """(3,) [m] away, across, and up from the table."""


def _extents(view: View, mask: np.ndarray) -> _Extents | None:
    """Extents of the pixels (H, W) of a part; None if there is none."""
    points = pixel_points(view, mask)
    if len(points) == 0:
        return None
    away = points.mean(0)[:2] - view.world_from_camera.xyz[:2]
    yaw = round(float(np.arctan2(away[1], away[0])), YAW_DECIMALS)
    rotated = Pose.from_rotvec((0.0, 0.0, -yaw)).apply(points)
    low, high = np.percentile(rotated, [100 * OUTLIERS, 100 * (1 - OUTLIERS)], axis=0)
    return _Extents(yaw, (low + high) / 2, high - (*low[:2], 0.0))


def _grid(view: View, mask: np.ndarray) -> Grid | None:
    """The grid of the pixels (H, W) of a part, in a world whose table is at height 0; None if it holds no part."""
    extents = _extents(view, mask)
    if extents is None or (extents.sizes > CELL * np.array(SHAPE)).any():
        return None
    x, y, _ = Pose.from_rotvec((0.0, 0.0, extents.yaw)).apply((*extents.middle[:2], 0.0))
    return grid_at(float(x), float(y), extents.yaw)


def packed(volume: np.ndarray) -> np.ndarray:
    """(nx, ny, nz) -> (nx / 2, ny / 2, 4 nz): the layers of PACK x PACK cells side by side."""
    nx, ny, nz = volume.shape
    cells = volume.reshape(nx // PACK, PACK, ny // PACK, PACK, nz)
    return np.ascontiguousarray(cells.transpose(0, 2, 1, 3, 4)).reshape(nx // PACK, ny // PACK, PACK * PACK * nz)


def unpacked(image: np.ndarray) -> np.ndarray:
    """(x, y, 4 nz) -> (2 x, 2 y, nz), the inverse of `packed`."""
    x, y, layers = image.shape
    nz = layers // (PACK * PACK)
    cells = image.reshape(x, y, PACK, PACK, nz).transpose(0, 2, 1, 3, 4)
    return np.ascontiguousarray(cells).reshape(PACK * x, PACK * y, nz)


def pixel_box(grid: Grid, camera: Camera, world_from_camera: Pose, border: int = 1) -> tuple[slice, slice]:
    """The rows and the columns of an image that a grid projects to, and a border [px] around them; at least one each.

    All of the image where a corner of the grid is behind the camera.
    """
    corners = grid.world(np.stack(np.meshgrid(*([-0.5, n - 0.5] for n in grid.shape), indexing="ij"), -1))
    uv = camera.project(world_from_camera.inverse().apply(corners.reshape(-1, 3)))
    size = np.array([camera.width, camera.height])
    low, high = (uv.min(0) - border, uv.max(0) + border + 1) if not np.isnan(uv).any() else (0 * size, size)
    (u0, v0), (u1, v1) = np.clip(np.floor(low), 0, size - 1).astype(int), np.clip(np.ceil(high), 1, size).astype(int)
    return slice(v0, v1), slice(u0, u1)


def _camera(view: View, grid: Grid) -> np.ndarray:
    foot = grid.world((np.array(SHAPE) - 1) / 2) * (1, 1, 0)
    towards = view.world_from_camera.xyz - foot
    distance = np.sqrt((towards**2).sum())
    return np.array([np.arccos(towards[2] / distance), distance], np.float32)


class CompletionNet(UNet):
    """Evidence about a part to the logit of each cell being filled."""

    def __init__(self, config: UNetConfig) -> None:
        layers = PACK * PACK * SHAPE[2]
        super().__init__(layers + EXTRA, layers, config)

    def forward(self, codes: Tensor, camera: Tensor) -> Tensor:
        """Logits of the cells.

        Args:
            codes: (B, nx / 2, ny / 2, 4 nz) int8, see `FramedPart`, packed.
            camera: (B, 2) float32, see `FramedPart`.

        Returns:
            (B, nx / 2, ny / 2, 4 nz), packed.
        """
        half = torch.is_autocast_enabled(codes.device.type)
        read = network_input(codes, camera, torch.bfloat16 if half else torch.float32)
        return self.image(read).permute(0, 2, 3, 1)


def network_input(codes: Tensor, camera: Tensor, dtype: torch.dtype = torch.float32) -> Tensor:
    """(B, C, x, y) input of the network, channels last: the layers, x, |y|, and polar angle and distance of the camera.

    Only the magnitude of y is a channel: mirrored input is then simply a mirrored image.
    """
    layers = codes.to(dtype).permute(0, 3, 1, 2) * (1 / CODE)
    batch, _, nx, ny = layers.shape
    x = torch.linspace(-1, 1, nx, device=layers.device).view(1, 1, nx, 1).expand(batch, 1, nx, ny)
    y = torch.linspace(-1, 1, ny, device=layers.device).abs().view(1, 1, 1, ny).expand(batch, 1, nx, ny)
    middle = torch.tensor([MIDDLE_POLAR, MIDDLE_DISTANCE], device=layers.device)
    place = (4 * (camera - middle)).view(batch, 2, 1, 1).expand(batch, 2, nx, ny)
    return torch.cat([layers, torch.cat([x, y, place], 1).to(dtype)], 1)


def completion_loss(logits: Tensor, codes: Tensor, solid: Tensor) -> Tensor:
    """() cross-entropy plus JACCARD times the soft Jaccard distance, both over the cells that are not seen free.

    Args:
        logits: (B, x, y, C) of the network.
        codes: (B, x, y, C) int8, packed; cells of code CODE do not count.
        solid: (B, x, y, C) uint8, packed: 255 times the filled shares.
    """
    logits, counts = logits.float().flatten(1), (codes < CODE).flatten(1)
    share = solid.flatten(1).float() / 255 * counts
    entropy = (F.softplus(logits) * counts).sum(1) - (logits * share).sum(1)
    filled = torch.sigmoid(logits) * counts
    both = (filled * share).sum(1)
    union = (filled.sum(1) + share.sum(1) - both).clamp(min=1e-3)
    return (entropy / counts.sum(1).clamp(min=1) + JACCARD * (1 - both / union)).mean()


@dataclass(frozen=True, eq=False)
class FillLogits:
    """Logits of the cells of a grid being filled."""

    grid: Grid
    values: np.ndarray
    """(nx, ny, nz) float32"""

    @property
    def probability(self) -> np.ndarray:
        """(nx, ny, nz) float32, 0 to 1."""
        return 1 / (1 + np.exp(-self.values))

    def at(self, grid: Grid, step: tuple[int, int, int]) -> np.ndarray:
        """(nx, ny, nz) float32: the logits at every so many voxels of another grid, interpolated; SEEN_FREE outside."""
        shape = tuple(n // s for n, s in zip(grid.shape, step, strict=True))
        here_from_there = self.grid.world_from_grid.inverse() @ grid.world_from_grid
        scale = grid.voxel_size / self.grid.voxel_size * np.array(step, float)
        values = np.full(shape, np.float32(SEEN_FREE))
        shift = here_from_there.xyz / self.grid.voxel_size
        _interpolate(self.values, here_from_there.rotation_matrix() * scale, shift, values)
        return values


class PartCompleter:
    """The network with its weights."""

    def __init__(self, weights: Path | CompletionNet) -> None:
        """weights: stem of the files, or the network itself."""
        self.net = on_cpu(weights, UNetConfig, CompletionNet, fold=False)

    def __call__(self, part: FramedPart) -> FillLogits:
        """The mean of the logits of the input and of its mirror image; cells that are seen free are not filled."""
        pair = np.stack([packed(part.codes), packed(part.codes[:, ::-1])])
        camera = np.stack([part.camera, part.camera])
        with torch.inference_mode():
            logits = self.net(torch.from_numpy(pair), torch.from_numpy(camera)).float().numpy()
        mean = (unpacked(logits[0]) + unpacked(logits[1])[:, ::-1]) / (2 * TEMPERATURE)
        mean = on_grid(mean, LOGIT_STEP).astype(np.float32)
        return FillLogits(part.grid, np.where(part.codes == CODE, np.float32(SEEN_FREE), mean))


@dataclass(frozen=True, eq=False)
class CompletedPart:
    """A part in a depth image, completed by the network; on the grids of `ObservedPart`."""

    observed: ObservedPart
    completer: PartCompleter
    raw: LabelledDepth | None = None
    """The calibrated image of a noisy sensor as it was measured; None: that of `observed`, which is exact."""

    @property
    def middle(self) -> np.ndarray:
        """(3,) [m] world: of the grids, see `ObservedPart.middle`."""
        return self.observed.middle

    @cached_property
    def framed(self) -> FramedPart | None:
        """What the network reads; None if no pixel has a return."""
        image, label, height = self.raw or self.observed.image, self.observed.label, self.observed.table_height()
        return framed(image, label, height, scale=scale_of(image, label, height))

    @cached_property
    def logits(self) -> FillLogits | None:
        """On the grid of the network; None if no pixel has a return."""
        return None if self.framed is None else self.completer(self.framed)

    def probability(self, voxel: float) -> Volume:
        """1 - 2 p at each voxel of `ObservedPart.volume`, p the probability of it being filled: negative where likely.

        voxel: [m] edge.
        """
        grid = self.observed.columns(voxel).grid
        if self.logits is None:
            return Volume.adopt(grid, np.ones(grid.shape, np.float32))
        return Volume.adopt(grid, -np.tanh(self.logits.at(grid, (1, 1, 1)) / 2))

    def solid_above(self, logit: float, voxel: float) -> Volume:
        """Negative where the logit is above another one, else positive, -1 to 1; on the grid of `probability`."""
        odds = self.probability(voxel)
        return Volume.adopt(odds.grid, np.clip(odds.values + np.float32(np.tanh(logit / 2)), -1, 1))

    def volume(self, voxel: float) -> Volume:
        """Signed distances to the part, on the grid of `ObservedPart`.

        Solid where the logit is above LIKELY, in noisy images above LIKELY_NOISY.
        """
        return self._filled(self.observed.columns(voxel))

    def bounds(self, voxel: float) -> PartBounds:
        """The bounds of the part, as `ObservedPart` has them, and the likely solid between."""
        columns = self.observed.columns(voxel)
        return PartBounds(self._filled(columns), columns.sure(), columns.possible())

    def _filled(self, columns: ObservedColumns) -> Volume:
        if self.logits is None:
            return columns.filled(largest_only=True)
        likely = self.logits.at(columns.fine, (1, 1, 2)) > (LIKELY if self.raw is None else LIKELY_NOISY)
        return columns.completed(likely, exact=self.raw is None)


@compiled
def _interpolate(source, linear, shift, values):
    """Fill `values` with the trilinear interpolation of `source` at linear @ (i, j, k) + shift, where that is inside.

    The third axes of both are parallel.
    """
    nx, ny, nz = source.shape
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            x = linear[0, 0] * i + linear[0, 1] * j + shift[0]
            y = linear[1, 0] * i + linear[1, 1] * j + shift[1]
            if not (0 <= x <= nx - 1 and 0 <= y <= ny - 1):
                continue
            a, b = min(int(x), nx - 2), min(int(y), ny - 2)
            u, v = x - a, y - b
            near = source[a, b], source[a + 1, b], source[a, b + 1], source[a + 1, b + 1]
            share = (1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v
            for k in range(values.shape[2]):
                z = min(max(linear[2, 2] * k + shift[2], 0.0), nz - 1.0)
                if abs(z - (linear[2, 2] * k + shift[2])) > 0.5:
                    continue
                c = min(int(z), nz - 2)
                w, total = z - c, 0.0
                for n in range(4):
                    total += share[n] * ((1 - w) * near[n][c] + w * near[n][c + 1])
                values[i, j, k] = total
