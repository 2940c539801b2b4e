"""The clearance: stated, stated wrongly, or unknown."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.metrics import Targets, pose_errors
from kit1000.pose import Pose
from kit1000.registration.predictor import USUAL_CLEARANCES, Registration, stated_clearances


def dataset_with(config: dict[str, Any] | None) -> Dataset:
    summary = {} if config is None else {"config": config}
    return cast(Dataset, SimpleNamespace(summary=summary, root=Path("own")))


def test_what_is_tried_is_what_is_stated_or_all_that_kits_usually_have() -> None:
    assert stated_clearances(dataset_with({"clearance": 0.01})) == (0.01,)
    for config in ({}, {"clearance": None}, None):
        assert stated_clearances(dataset_with(config)) == USUAL_CLEARANCES
    assert list(USUAL_CLEARANCES) == sorted(USUAL_CLEARANCES)


@pytest.mark.parametrize("value", ["2.5", 2.5, 0, -1e-3, True, [2.5e-3], float("nan")])
def test_what_is_no_length_in_metres_is_one_line(value: Any) -> None:
    with pytest.raises(InputError, match=r"own: dataset\.json: config: clearance: expected metres, such as 0\.0025"):
        stated_clearances(dataset_with({"clearance": value}))


def unknown(mini: Path) -> Dataset:
    """A dataset whose clearance nobody states."""
    data = Dataset(mini)
    del data.summary["config"]["clearance"]
    return data


@pytest.mark.parametrize("track", ["snap", pytest.param("place", marks=pytest.mark.slow)])
def test_without_the_clearance_parts_reach_their_goals_as_with_it(mini: Path, track: str) -> None:
    split = Dataset(mini).split("train", truth=True)
    query = next(split.queries(track))
    truth = split.scene(query.scene_id).truth_of(query.id)
    geometry = Dataset(mini).geometry
    targets = Targets.of([truth] * 2, lambda part: geometry.part(part).mesh.vertices)
    motions = [Registration(data)(query).goal_from_now for data in (Dataset(mini), unknown(mini))]
    errors = pose_errors(Pose.stack(motions), targets)
    assert (errors.position < errors.position[0] + 3e-3).all()
    assert np.degrees(errors.rotation[1]) < np.degrees(errors.rotation[0]) + 3


def test_where_nothing_is_seen_no_clearance_fits(mini: Path) -> None:
    data = unknown(mini)
    query = next(data.split("train").queries("snap"))
    empty = replace(query.image, view=replace(query.view, depth=np.zeros_like(query.view.depth)))
    assert Registration(data).fits(replace(query, read_image=lambda: empty)) == []
