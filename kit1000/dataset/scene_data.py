"""The contents of a recording: the observation of one scene, and its ground truth.

The two are never in the same file. Rows are JSON values: SI units, poses as {"wxyz": [...], "xyz": [...]}.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from kit1000.dataset.json_rows import Row
from kit1000.pose import Pose
from kit1000.values import View

LICENCE = "CC-BY-4.0"
SCENES_PER_SHARD = 25  # a shard is the unit of work and of download: about 20 MB, about ten seconds
PREVIEW_STEP = 2  # a preview has a pixel for as many columns and rows of the depth image


@dataclass(frozen=True, eq=False)
class Observation:
    """The observation of a scene: depth images, masks and queries."""

    scene_id: str
    views: Mapping[str, View]
    """Views by key: "ideal", "d415", "photoneo" of the primary camera, "three/0/ideal" ... of an extra camera set."""
    labels: np.ndarray | None = None
    """(H, W) uint8 masks of the primary camera, see `kit1000.values.LabelledDepth`."""
    queries: tuple[Row, ...] = ()
    """Rows {"id", "track", "sensor", "part", "drawn", "pivot": [3], "guess": pose or null}."""
    preview: np.ndarray | None = None
    """(h, w, 3) uint8 sRGB, a small picture for viewers, which `kit1000.pictures.scene_preview` draws from the rest."""


@dataclass(frozen=True, eq=False)
class SceneTruth:
    """The ground truth of a scene."""

    scene_id: str
    assembly_id: str
    world_from_assembly: Pose
    parts: tuple[Row, ...]
    """In the order p0, p1, ...: {"part_id", "family", "mount", "rest_mode", "world_from_part", "world_from_kit",
    "pixels", "visible", "slot_angle", "slot_visible", "unseen": reason or null}; `mount` is an index into the mounts of
    the assembly, `unseen` is why the part or its slot is not visible enough for a query."""
    queries: Mapping[str, Row]
    """Rows by query id: {"part", "goal_drawn": pose, "draw": {"goal", "turn", "offset": [3], "rotvec": [3]} or null}.
    The draw is that of the guess: index of the goal, its angle [rad] about the free axis, offset [m], rotvec [rad]."""
    seg: np.ndarray
    """(H, W) uint16 segmentation: 0 nothing, 1 table, 2 assembly, 3 + i part i, 100 + k the cavity of mount k."""
    models: Mapping[str, bytes] = field(default_factory=dict)
    """GLB files by body, for viewers: "assemblies/<id>", "parts/<id>"."""
    goals: Pose | None = None
    """(n,) world_from_part of every goal of the scene's target, for viewers."""
    crowded: bool = False
    """Whether the parts are pushed together."""
    preview: np.ndarray | None = None
    """(h, w, 3) uint8 sRGB, a small picture for viewers: that of the observation, with the target at its goals."""
    noise_px: Mapping[str, float] = field(default_factory=dict)
    """[px] of disparity: RMS of the noise of the images of the primary camera, by sensor; of those that have noise."""
