"""Recordings of ground truth: exact numbers, and for viewers models, their poses and the goals of the target."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from kit1000.dataset.json_rows import Row, pose_of
from kit1000.dataset.mcap_io.content_hash import truth_hash, truth_row
from kit1000.dataset.mcap_io.messages import (
    Message,
    frames_message,
    image_message,
    image_of,
    json_schema,
    models_message,
    models_of,
    poses_message,
    poses_of,
    preview_message,
    preview_of,
    row_message,
    row_of,
)
from kit1000.dataset.mcap_io.observations import POSE_SCHEMA
from kit1000.dataset.mcap_io.reading import ShardFile
from kit1000.dataset.mcap_io.writing import ShardWriter
from kit1000.dataset.scene_data import SceneTruth
from kit1000.errors import InputError, checked
from kit1000.pose import Pose

PREVIEW = "/preview/goals"  # beside the preview of the observations, when a viewer opens both files
_TRUTH = json_schema(
    "kit1000.SceneTruth",
    {
        "type": "object",
        "description": "What is so in a scene. Lengths in m, angles in rad, quaternions scalar first.",
        "required": ["assembly_id", "crowded", "parts", "queries", "scene_id", "world_from_assembly"],
        "properties": {
            "scene_id": {"type": "string"},
            "assembly_id": {"type": "string"},
            "world_from_assembly": POSE_SCHEMA,
            "crowded": {"type": "boolean", "description": "whether the parts are pushed together"},
            "noise_px": {
                "type": "object",
                "additionalProperties": {"type": "number"},
                "description": "RMS noise of the images of noisy sensors, in px of disparity",
            },
            "parts": {"type": "array", "items": {"type": "object"}, "description": "p0, p1, ..."},
            "queries": {"type": "object", "additionalProperties": {"type": "object"}, "description": "by query id"},
        },
    },
)


class TruthWriter(ShardWriter):
    """Writes a file of truths when its `with` block ends without an exception."""

    CONTENTS = "truth"

    def add(self, truth: SceneTruth) -> None:
        """Append the truth of a scene. Raises InputError when a value does not fit the format."""
        self.record(truth.scene_id, truth_hash(truth), _messages(truth, self.stamp))


class TruthFile(ShardFile):
    """A file of truths. Arrays come read-only."""

    CONTENTS = "truth"

    def truth(self, scene_id: str) -> SceneTruth:
        """The whole ground truth of a scene."""
        row = self.row(scene_id)
        goals, previews = self._all(scene_id, "/goals"), self._all(scene_id, PREVIEW)
        return SceneTruth(
            scene_id=row["scene_id"],
            assembly_id=row["assembly_id"],
            world_from_assembly=pose_of(row["world_from_assembly"]),
            parts=tuple(row["parts"]),
            queries=row["queries"],
            seg=image_of(self._one(scene_id, "/seg")),
            models=self.models(scene_id),
            goals=poses_of(goals[0]) if goals else None,
            crowded=row["crowded"],
            noise_px=row.get("noise_px", {}),
            preview=preview_of(previews[0]) if previews else None,
        )

    def row(self, scene_id: str) -> Row:
        """The row of a truth as written by `truth_row`; no image and no model is read."""
        return row_of(self._one(scene_id, "/truth"))

    def models(self, scene_id: str) -> dict[str, bytes]:
        """The GLB models of a scene by body, y up and in m."""
        return models_of(self._one(scene_id, "/scene"))

    def recomputed_hash(self, scene_id: str) -> str:
        """The content hash, computed from the data read."""
        return truth_hash(self.truth(scene_id))


def _messages(truth: SceneTruth, stamp: int) -> Iterator[Message]:
    """The messages of a scene, small ones first."""
    bodies = _bodies(truth)
    unknown = sorted(set(truth.models) - set(bodies))
    if unknown:
        raise InputError(f"{truth.scene_id}: models {', '.join(unknown)}, expected some of {', '.join(bodies)}")
    yield row_message("/truth", _TRUTH, truth_row(truth))
    yield frames_message("/tf", bodies, stamp)
    if truth.goals is not None:
        yield poses_message("/goals", truth.goals, stamp)
    if truth.preview is not None:
        yield preview_message(PREVIEW, truth.preview, stamp)
    seg = checked(f"{truth.scene_id}: seg", truth.seg, ("h", "w"), np.uint16)
    yield models_message("/scene", truth.models, bodies, stamp)
    yield image_message("/seg", seg, "mono16", "camera", stamp)


def _bodies(truth: SceneTruth) -> dict[str, Pose]:
    """The poses `world_from_body` of the assembly and the parts, named as in `SceneTruth.models`."""
    parts = {f"parts/{row['part_id']}": pose_of(row["world_from_part"]) for row in truth.parts}
    return {f"assemblies/{truth.assembly_id}": truth.world_from_assembly} | parts
