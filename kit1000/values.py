"""The values of kit assembly as frozen dataclasses: part, slot, kit, assembly, scene, view, query, prediction.

SI units (m, rad, kg, s); arrays are float64, read-only and checked at construction; quaternions are wxyz; `a_from_b`
maps coordinates in b to coordinates in a.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType

import numpy as np

from kit1000.camera import Camera
from kit1000.errors import ShapeError, checked
from kit1000.mesh import Mesh
from kit1000.pose import Pose
from kit1000.symmetry import Symmetry

ASSEMBLY_LABEL = 1
FIRST_PART_LABEL = 2


@dataclass(frozen=True, eq=False)
class Part:
    """A rigid machine part. The origin of its frame is the volume centroid, fixed by every symmetry; axes as made."""

    id: str
    family: str
    mesh: Mesh
    symmetry: Symmetry
    dimensions: Mapping[str, float]
    """The parameters of its family, in the unit that the family states; empty for a part from a file."""
    mass: float
    """[kg]"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "dimensions", MappingProxyType(dict(self.dimensions)))
        _positive("mass", self.mass)


@dataclass(frozen=True, eq=False)
class FreeAxis:
    """A line about which a seated part may be rotated by any angle."""

    point: np.ndarray
    """(3,) [m] in the kit frame."""
    direction: np.ndarray
    """(3,) unit vector in the kit frame."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", checked("point", self.point, (3,)))
        direction = checked("direction", self.direction, (3,))
        if abs(np.linalg.norm(direction) - 1) > 1e-9:
            raise ShapeError(f"direction: expected a unit vector, got length {np.linalg.norm(direction):.6g}")
        object.__setattr__(self, "direction", direction)


@dataclass(frozen=True, eq=False)
class Slot:
    """The place of a part in a kit: its cavity and its goals."""

    part_id: str
    kit_from_part: Pose
    """The design pose: seated on the cavity's floor."""
    clearance: float
    """[m] horizontal, between the part's swept shadow and the walls."""
    depth: float
    """[m] from the rim to the cavity's floor."""
    goals: Pose
    """(n,) equivalent goal poses kit_from_part; the design pose is the first."""
    free_axis: FreeAxis | None = None
    """Each goal rotated about this line by any angle is also a goal."""

    def __post_init__(self) -> None:
        _positive("clearance", self.clearance)
        _positive("depth", self.depth)
        if len(self.goals.batch_shape) != 1 or len(self.goals) < 1:
            raise ShapeError(f"goals: expected a batch of shape (n,), n >= 1, got {self.goals.batch_shape}")


@dataclass(frozen=True, eq=False)
class Kit:
    """A plate with one cavity. Frame: centre of the top face, +z out of the cavity."""

    id: str
    mesh: Mesh
    slot: Slot
    extent: np.ndarray
    """(3,) [m]: width along x, width along y, thickness."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "extent", checked("extent", self.extent, (3,)))


@dataclass(frozen=True, eq=False)
class Mount:
    """A kit on its bracket, with its pose in the assembly."""

    kit: Kit
    assembly_from_kit: Pose


@dataclass(frozen=True, eq=False)
class Assembly:
    """Kits joined by angle brackets on feet: one watertight, printable mesh, z up, standing on z = 0."""

    id: str
    mesh: Mesh
    mounts: tuple[Mount, ...]


@dataclass(frozen=True, eq=False)
class Body:
    """A body of a scene: a part or an assembly, by its id."""

    id: str
    world_from_body: Pose


@dataclass(frozen=True, eq=False)
class Scene:
    """The bodies of a scene with their poses, without any observation."""

    id: str
    bodies: tuple[Body, ...]
    """The assembly first, then the parts p0, p1, ..."""


@dataclass(frozen=True, eq=False)
class View:
    """A depth image with its camera and camera pose."""

    camera: Camera
    world_from_camera: Pose
    depth: np.ndarray
    """(H, W) float32 [m] along the optical axis; 0 = no return."""

    def __post_init__(self) -> None:
        size = (self.camera.height, self.camera.width)
        object.__setattr__(self, "depth", checked("depth", self.depth, size, np.float32))

    @classmethod
    def adopt(cls, camera: Camera, world_from_camera: Pose, depth: np.ndarray) -> View:
        """A view with a read-only array (H, W) float32 [m] of this package, neither copied nor checked."""
        view = object.__new__(cls)
        for name, value in (("camera", camera), ("world_from_camera", world_from_camera), ("depth", depth)):
            object.__setattr__(view, name, value)
        return view


@dataclass(frozen=True, eq=False)
class LabelledDepth:
    """A depth image with its masks."""

    view: View
    labels: np.ndarray
    """(H, W) uint8: 0 background or table, ASSEMBLY_LABEL the kits, FIRST_PART_LABEL + i part i."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "labels", checked("labels", self.labels, self.view.depth.shape, np.uint8))


@dataclass(frozen=True, eq=False)
class Query:
    """One task for a method: a part, the kit region, and perhaps an initial guess. Images are read on first use."""

    id: str
    scene_id: str
    track: str
    sensor: str
    """The sensor of its depth image: ideal, d415 or photoneo."""
    part: int
    """Index of the part among those of its scene."""
    drawn: bool
    """Whether its part is the one randomly drawn target of the scene."""
    pivot: np.ndarray
    """(3,) [m] world: centre of the part's masked depth points (see `kit1000.queries.pivots`), rounded to 0.1 mm."""
    guess: Pose | None
    """The user's initial guess of goal_from_now, its rotation error about the pivot; None on tracks without guess."""
    read_image: Callable[[], LabelledDepth]
    """Reads the depth image and its masks."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "pivot", checked("pivot", self.pivot, (3,)))

    @cached_property
    def image(self) -> LabelledDepth:
        """The depth image and its masks, read once."""
        return self.read_image()

    @property
    def view(self) -> View:
        """The depth image."""
        return self.image.view

    @property
    def part_mask(self) -> np.ndarray:
        """(H, W) bool: the pixels of the part."""
        return self.image.labels == FIRST_PART_LABEL + self.part

    @property
    def kit_region(self) -> np.ndarray:
        """(H, W) bool: the pixels of the kits."""
        return self.image.labels == ASSEMBLY_LABEL


@dataclass(frozen=True, eq=False)
class Prediction:
    """The predicted motion of the part to its goal, in the world."""

    query_id: str
    goal_from_now: Pose
    confidence: float
    seconds: float

    def __post_init__(self) -> None:
        if not 0 <= self.confidence <= 1:
            raise ShapeError(f"confidence of {self.query_id}: expected 0 to 1, got {self.confidence}")


@dataclass(frozen=True, eq=False)
class Truth:
    """The ground truth of a query."""

    query_id: str
    assembly_id: str
    part_id: str
    family: str
    rest_mode: str
    """upright or tumbled"""
    kits: int
    """Number of kits of the assembly."""
    visible: float
    """Visible share of the part's silhouette."""
    anchor: np.ndarray
    """(3,) [m] world: the part's centroid at its current pose."""
    world_from_part: Pose
    world_from_kit: Pose
    slot: Slot
    goal_drawn: Pose
    """goal_from_now of the goal from which the guess was drawn; of the design pose on tracks without guess."""
    crowded: bool = False
    """Whether the parts of the scene are pushed together."""
    noise_px: float = 0.0
    """[px] of disparity: RMS noise of the query's image; 0 of ideal depth, NaN where it is not known."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "anchor", checked("anchor", self.anchor, (3,)))


@dataclass(frozen=True, eq=False)
class TrueGeometry:
    """The shapes of a scene and where they stand, never a goal."""

    part: Mesh
    """In the part's own frame."""
    world_from_part: Pose
    assembly: Mesh
    world_from_assembly: Pose


@dataclass(frozen=True, eq=False)
class SceneShapes:
    """The shapes of a scene, each in its own frame: no pose, and not which part lies where."""

    assembly: Mesh
    """All kits as one mesh, z up as they stand."""
    parts: Mapping[str, Mesh]
    """The parts of the scene by id, in the order of their ids."""
    clearances: Mapping[str, float] = field(default_factory=dict)
    """[m] between a part and the walls of its cavity, by id, as the files of a kit state it."""
    goals: Mapping[str, Pose] = field(default_factory=dict)
    """(n,) equivalent assembly_from_part of the seated part, by id, as the files of a kit state them; none in a scene
    with ground truth."""


def _positive(name: str, value: float) -> None:
    if not (np.isfinite(value) and value > 0):
        raise ShapeError(f"{name}: expected a finite number above 0, got {value}")
