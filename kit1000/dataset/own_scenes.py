"""What dataset.json says about scenes of the user's own camera, as `kit1000 import` and `kit1000 label` write it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from kit1000.errors import InputError, checked

OWN = "own"
"""Key of dataset.json: what the scenes were imported from; generated datasets have none."""
JOINED = "joined"
"""Key of the entry OWN: for each scene of joined folders, its former ids, its licence, and who confirmed its labels."""
LABELS = "labels"
"""Folder of the labels of own scenes and their pictures, which a person goes on changing."""
TABLES = "tables"
"""Key of dataset.json: the outline (k, 2) [m] of the table that was seen, by scene."""
PLACES = "places"
"""Key of dataset.json: groups of own scenes that are images of the same bodies, from several places of the camera."""


def is_own(summary: Mapping[str, Any]) -> bool:
    """Whether a dataset.json is about own scenes."""
    return OWN in summary


def is_labelled(summary: Mapping[str, Any]) -> bool:
    """Whether a dataset.json lists ground truth."""
    return any(name.endswith(".truth.mcap") for name in summary.get("files", {}))


def seen_table(summary: Mapping[str, Any], scene_id: str) -> np.ndarray | None:
    """(k, 2) [m] world: the convex outline of the table that an own scene shows; None for a generated scene."""
    outline = summary.get(TABLES, {}).get(scene_id)
    return None if outline is None else checked(f"dataset.json: table of {scene_id}", outline, ("k", 2))


def groups_of_places(summary: Mapping[str, Any]) -> list[list[str]]:
    """The groups of PLACES, none in generated datasets; raises InputError for anything else."""
    groups = summary.get(PLACES, [])
    if not (isinstance(groups, list) and all(isinstance(group, list) for group in groups)):
        raise InputError(f"dataset.json: {PLACES}: expected lists of scenes; import again")
    return groups


def scenes_from_elsewhere(summary: Mapping[str, Any], scene_id: str) -> tuple[str, ...]:
    """The other scenes that show the bodies of one, as their images were taken from several places."""
    return tuple(
        other for group in groups_of_places(summary) if scene_id in group for other in group if other != scene_id
    )
