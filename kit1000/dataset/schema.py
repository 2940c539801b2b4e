"""What a recording holds: one scene as observed, and the truth about it, as plain values and rows.

The two never share a file. Rows are JSON values: numbers in SI, poses as {"wxyz": [...], "xyz": [...]}.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from kit1000.dataset.tables import Row
from kit1000.pose import Pose
from kit1000.values import View

LICENCE = "CC-BY-4.0"
SCENES_PER_SHARD = 25  # a shard is the unit of work and of download: some 20 MB, some ten seconds


@dataclass(frozen=True, eq=False)
class Observation:
    """What was seen of a scene."""

    scene_id: str
    views: Mapping[str, View]
    """By key: "ideal" and "d415" of the primary camera, "three/0/ideal" ... of a further set."""
    labels: np.ndarray | None = None
    """(H, W) uint8 masks of the primary camera, see `kit1000.values.LabelledDepth`."""
    queries: tuple[Row, ...] = ()
    """Rows {"id", "track", "sensor", "part", "drawn", "pivot": [3], "guess": pose or null}."""


@dataclass(frozen=True, eq=False)
class SceneTruth:
    """What is so in a scene."""

    scene_id: str
    assembly_id: str
    world_from_assembly: Pose
    parts: tuple[Row, ...]
    """In the order p0, p1, ...: {"part_id", "family", "mount", "rest_mode", "world_from_part", "world_from_kit",
    "pixels", "visible", "slot_angle", "slot_visible", "unseen": reason or null}; the mount is an index into the
    assembly's."""
    queries: Mapping[str, Row]
    """By query id: {"part", "goal_drawn": pose, "draw": {"goal", "turn", "offset": [3], "rotvec": [3]} or null}."""
    seg: np.ndarray
    """(H, W) uint16: 0 nothing, 1 table, 2 assembly, 3 + i part i, 100 + k the cavity of mount k."""
    models: Mapping[str, bytes] = field(default_factory=dict)
    """GLB files by body, for viewers: "assemblies/<id>", "parts/<id>"."""
    goals: Pose | None = None
    """(n,) world_from_part of every goal of the drawn target, for viewers."""
