"""The sources of the method's volumes: the true meshes, or one depth image with its masks."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np

from kit1000.perception.calibration import CameraEstimate
from kit1000.perception.observed.fusion import MaskedView, observed_distance
from kit1000.perception.observed.parts import AROUND, HALF_WIDTH, ObservedPart, PartEvidence
from kit1000.perception.observed.pixels import Noise, noise_of, oriented_points, pixel_points
from kit1000.pose import Pose
from kit1000.registration.geometry.observed_cavity import Cavity
from kit1000.registration.inputs.hidden_outline import hidden_outline
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, LabelledDepth, Query, TrueGeometry
from kit1000.voxels import Grid, Volume, signed_distance, surface_points

if TYPE_CHECKING:
    from kit1000.perception.completion.parts.completed import CompletedPart, PartCompleter
    from kit1000.perception.placement.placer import Placer

VOXEL = 1e-3  # [m] of the part's volume
COARSE = 2e-3  # [m] voxels of the volume in which planes are searched
EXACT = Noise(0.5e-3, float(np.radians(1.5)), 1)
SEEN_POINTS = 1500
SLIMMER, WIDER = 1.0, -1.5  # logits above which the part is solid, for cavities of a slimmer and of a wider part


class Source(Protocol):
    """What the method reads of a scene."""

    @property
    def noise(self) -> Noise:
        """Noise of points and normals."""
        ...

    @property
    def middle(self) -> np.ndarray:
        """(3,) [m] world: about the middle of the part."""
        ...

    @property
    def height(self) -> float | None:
        """[m] of the part as it lies, where that is known better than by its volume."""
        ...

    @property
    def cavities(self) -> dict[float, list[Cavity]]:
        """Cavities found so far in the kits, by the side [m] of their reliefs; a search adds to them."""
        ...

    def part(self) -> Volume:
        """The part as it lies now."""
        ...

    def oriented_points(self, box: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, float]:
        """Points (n, 3) [m] on the kits within a box (2, 3) or everywhere, their normals, the area [m^2] of a point."""
        ...

    def plate(self, grid: Grid) -> Volume:
        """The kits on a grid."""
        ...


@dataclass(frozen=True, eq=False)
class TrueSource:
    """Exact volumes from the true geometry."""

    geometry: TrueGeometry
    noise: Noise = EXACT
    cavities: dict[float, list[Cavity]] = field(default_factory=dict, kw_only=True)

    @property
    def middle(self) -> np.ndarray:
        """(3,) [m] world: of the part's extents; the pivot of a noisy image may be centimetres off."""
        low, high = self._corners.min(0), self._corners.max(0)
        return (low + high) / 2

    @property
    def height(self) -> float | None:
        """None: the volume is exact."""
        return None

    def part(self) -> Volume:
        """The part, exact."""
        radius = np.sqrt(np.square(self._corners - self.middle).sum(-1).max())
        side = 2 * round(max(HALF_WIDTH, float(radius) + AROUND) / VOXEL)
        grid = Grid.centred(Pose.from_translation(self.middle), (side, side, side), VOXEL)
        return signed_distance(grid, [(self.geometry.part, self.geometry.world_from_part)], threads=1)

    @cached_property
    def _corners(self) -> np.ndarray:
        """(n, 3) [m] world: of the part."""
        return self.geometry.world_from_part.apply(self.geometry.part.vertices)

    def oriented_points(self, box: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, float]:
        """Zero crossings of a coarse volume, with its gradients."""
        if box is None:
            corners = self.geometry.world_from_assembly.apply(self.geometry.assembly.vertices)
            box = np.stack([corners.min(0), corners.max(0)])
        shape = np.ceil((box[1] - box[0]) / COARSE).astype(int) + 4
        grid = Grid.centred(Pose.from_translation(box.mean(0)), tuple(shape.tolist()), COARSE)
        volume = self.plate(grid)
        points = surface_points(volume)
        return points, _gradients(volume, points), COARSE**2 * 2 / 3  # 1.5 crossings a cell on average

    def plate(self, grid: Grid) -> Volume:
        """The kits, exact."""
        true = self.geometry
        return signed_distance(grid, [(true.assembly, true.world_from_assembly)], threads=1)


@dataclass(frozen=True, eq=False)
class DepthSource:
    """Volumes from one depth image, or several, and the masks of the part and of the kits."""

    query: Query
    completer: PartCompleter | None = None
    """The network that completes the part; None fills columns."""
    measured: LabelledDepth | None = None
    """The calibrated image of a sensor whose edges were restored, as it was before, which the network reads."""
    others: tuple[LabelledDepth, ...] = ()
    """Images of further cameras, with the labels of the query's."""
    restored: bool = False
    """Whether a network restored the image of a noisy sensor."""
    gain: float = 0.0
    """[px m] disparity times depth, of a noisy image."""
    placer: Placer | None = None
    """The network that places fits in the image; None: it is not asked."""
    camera: CameraEstimate | None = None
    """The camera's uncertainty; None where it is exact, or not known."""
    cavities: dict[float, list[Cavity]] = field(default_factory=dict, kw_only=True)
    """See `Source.cavities`; shared by the parts of an image."""

    @property
    def noise(self) -> Noise:
        """Noise of the image."""
        return noise_of(self.query.sensor, self.restored)

    def part(self) -> Volume:
        """The part from its observed points down to the table, except for free space."""
        return self._part.volume(VOXEL)

    @cached_property
    def evidence(self) -> PartEvidence:
        """What is certain about the part."""
        return self._part.evidence(VOXEL)

    @cached_property
    def slimmer(self) -> Volume:
        """The part where a network finds it likely, for all fits."""
        return self._solid_above(SLIMMER)

    @cached_property
    def wider(self) -> Volume:
        """The part also where a network finds it less likely."""
        return self._solid_above(WIDER)

    def _solid_above(self, logit: float) -> Volume:
        """The part where a network finds it likelier than a logit; the filled one where none completes it."""
        if isinstance(self._part, ObservedPart):
            return self.evidence.filled
        return self._part.solid_above(logit, VOXEL)

    @cached_property
    def part_points(self) -> np.ndarray:
        """(n, 3) [m] world: about SEEN_POINTS points of the part, one a pixel."""
        images = self._images_of(FIRST_PART_LABEL + self.query.part)
        points = np.concatenate([pixel_points(view, mask) for view, mask in images])
        return points[:: max(1, len(points) // SEEN_POINTS)]

    @cached_property
    def hidden_outline(self) -> float:
        """See `hidden_outline`, of the part in the query's image as it was measured."""
        return hidden_outline(self.measured or self.query.image, FIRST_PART_LABEL + self.query.part)

    @property
    def height(self) -> float | None:
        """[m] of a part that a network completed, as it lies in an exact image, for its highest point is seen.

        None where the filled part has that height too, and where the image is noisy.
        """
        if self.completer is None or self.measured is not None:
            return None
        heights = self.part_points[:, 2]
        return float(heights.max()) if len(heights) else None

    def oriented_points(self, box: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, float]:
        """Points of the image on the kits, with normals from their neighbours."""
        found = [oriented_points(view, mask, self.noise.window) for view, mask in self._kits]
        points, normals = (np.concatenate([each[k] for each in found]) for k in (0, 1))
        inside = np.ones(len(points), bool) if box is None else ((points >= box[0]) & (points <= box[1])).all(1)
        return points[inside], normals[inside], float(np.mean([area for *_, area in found])) / len(found)

    def plate(self, grid: Grid) -> Volume:
        """The observed kits."""
        return observed_distance(grid, self._kits)

    @property
    def middle(self) -> np.ndarray:
        """(3,) [m] world: of the observed part."""
        return self._part.middle

    @property
    def half_width(self) -> float:
        """[m] from the middle of the part to its sides, at least HALF_WIDTH."""
        return self._observed.half_width

    @cached_property
    def _observed(self) -> ObservedPart:
        label = FIRST_PART_LABEL + self.query.part
        return ObservedPart(self.query.image, label, self.query.pivot, self.others)

    @cached_property
    def _part(self) -> ObservedPart | CompletedPart:
        if self.completer is None:
            return self._observed
        from kit1000.perception.completion.parts.completed import CompletedPart

        return CompletedPart(self._observed, self.completer, self.measured)

    @cached_property
    def _kits(self) -> list[MaskedView]:
        """The kits, of which a volume is asked for every plate."""
        return self._images_of(ASSEMBLY_LABEL)

    def _images_of(self, label: int) -> list[MaskedView]:
        return [MaskedView.of(image, label) for image in (self.query.image, *self.others)]


def _gradients(volume: Volume, points: np.ndarray) -> np.ndarray:
    """(n, 3) unit gradients of the distance at the voxels nearest to points (n, 3) [m]."""
    limit = np.array(volume.grid.shape) - 2
    i, j, k = np.clip(np.rint(volume.grid.indices(points)).astype(int), 1, limit).T
    v = volume.values
    gradients = np.stack(
        [
            v[i + 1, j, k] - v[i - 1, j, k],
            v[i, j + 1, k] - v[i, j - 1, k],
            v[i, j, k + 1] - v[i, j, k - 1],
        ],
        axis=-1,
    )
    return gradients / np.maximum(np.linalg.norm(gradients, axis=1, keepdims=True), 1e-12)
