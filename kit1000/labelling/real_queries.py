"""The queries of a labelled scene and their ground truth, by the rules of generated datasets.

A track asks about the parts that it asks about there, if they and their slots are seen well enough. Guesses are drawn
as for generated scenes: a real image does not come with the hand that moved its part.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kit1000.dataset.json_rows import Row
from kit1000.dataset.scene_queries import PartInScene, asked_query, eligible
from kit1000.queries.pivots import part_pivots
from kit1000.queries.tracks import TRACKS, query_id
from kit1000.rng import stream
from kit1000.values import View

SEED = 0  # of all draws: equal labels give equal queries


def real_queries(
    scene_id: str, tracks: Sequence[str], sensor: str, view: View, labels: np.ndarray, parts: Sequence[PartInScene]
) -> tuple[list[Row], dict[str, Row]]:
    """The query rows of a scene and, by query id, their truth; both as in `kit1000.dataset.scene_data`.

    Args:
        scene_id: such as test-s0007.
        tracks: the tracks of the folder.
        sensor: key of the view.
        view: the depth image.
        labels: (H, W) uint8 masks, see `kit1000.values.LabelledDepth`.
        parts: those of the scene, in their order.
    """
    pivots = part_pivots(view, labels)
    visible = [part for part in parts if part.invisibility is None and part.index in pivots]
    rows: list[Row] = []
    truths: dict[str, Row] = {}
    for name in tracks:
        asked = [part for part in visible if eligible(TRACKS[name], part)]
        drawn = int(stream(SEED, "labelled", scene_id, name, "drawn").integers(len(asked))) if asked else None
        for number, part in enumerate(asked):
            identity, rng = query_id(scene_id, part.index, name), stream(SEED, "labelled", scene_id, part.index, name)
            query = asked_query(identity, TRACKS[name], sensor, part, pivots[part.index], rng)
            rows.append(query.row(number == drawn))
            truths[identity] = query.truth
    return rows, truths
