"""Table II: its rows add up, and the masks of the robot are those of the manifest."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark import table2
from benchmark.__main__ import main
from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.errors import InputError
from kit1000.perception.sensor_facts import SensorFacts
from kit1000.planner.execute import NO_SEAL, OUTCOMES, PartRun, SceneRun
from kit1000.pose import Pose
from kit1000.submission import write_submission
from kit1000.submission.predictions import write_predictions
from kit1000.values import LabelledDepth, Prediction, Query
from tests.samples.submissions import manifest

SPLIT = "train"
FAR = Pose.from_translation([0.0, 0.0, 0.02])


@pytest.fixture
def robot(monkeypatch: pytest.MonkeyPatch) -> None:
    """In place of the robot: it seats what is moved truly, never finds a seal in the first scene, and else jams."""

    def run_scene(scene: RecordedScene, motions: Mapping[int, Pose], sensor: str, images: object) -> SceneRun:
        true = {query.part: scene.truth_of(query.id).goal_drawn for query in scene.queries if query.track == "snap"}
        runs = []
        for part, motion in motions.items():
            if scene.id.endswith("0000"):
                runs.append(PartRun(part, NO_SEAL, ""))
            else:
                outcome = "seated" if np.allclose(motion.xyz, true[part].xyz) else "jammed"
                runs.append(PartRun(part, outcome, "", 20.0, 1, {"height_mm": 0.0}))
        return SceneRun(scene.id, tuple(runs), (), (), Pose.identity())

    monkeypatch.setattr(table2, "run_scene", run_scene)


@pytest.fixture
def shifted(mini: Path, tmp_path: Path) -> Path:
    """Predictions that raise every part of the track snap by 20 mm."""
    dataset = Dataset(mini)
    rows = [
        Prediction(query.id, FAR @ dataset.truth_of(query).goal_drawn, 0.5, 1.0)
        for query in dataset.split(SPLIT).queries("snap")
    ]
    write_predictions(tmp_path / "raised.csv", rows)
    return tmp_path / "raised.csv"


def test_the_rows_share_what_is_possible_and_their_counts_add_up(mini: Path, shifted: Path, robot: None) -> None:
    truth, raised = table2.chain(mini, {"raised": shifted}, "snap", SPLIT)
    queries = list(Dataset(mini).split(SPLIT).queries("snap"))
    possible = [query for query in queries if not query.scene_id.endswith("0000")]
    assert 0 < len(possible) < len(queries)
    for row in (truth, raised):
        assert (row.n, row.possible) == (len(queries), len(possible))
        assert sum(row.outcomes.values()) == row.n
        assert list(row.outcomes) == list(OUTCOMES)
        assert row.interval[0] <= row.seated <= row.interval[1]
    assert (truth.seated, truth.tested) == (1.0, 1.0)
    assert (raised.seated, raised.tested) == (0.0, 0.0)
    assert truth.position_mm == pytest.approx(0, abs=1e-6)
    assert raised.position_mm == pytest.approx(20.0)
    assert raised.rotation_deg == pytest.approx(0, abs=1e-6)


def test_fewer_scenes_are_the_first_ones(mini: Path, shifted: Path, robot: None) -> None:
    row = table2.chain(mini, {}, "snap", SPLIT, scenes=1)[0]
    first = next(iter(Dataset(mini).split(SPLIT))).id
    assert row.n == sum(query.scene_id == first for query in Dataset(mini).split(SPLIT).queries("snap"))
    assert row.possible == 0


def test_the_robot_finds_parts_by_predicted_masks_and_the_facts_of_the_sensor_where_the_manifest_states_them(
    mini: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """As `predict --masks predicted` finds them."""
    facts = SensorFacts(device="D435", noise_px=0.2, stream="aligned")
    root = tmp_path / "stated"
    root.mkdir()
    for path in mini.iterdir():
        if path.name != "dataset.json":
            (root / path.name).symlink_to(path)
    summary = json.loads((mini / "dataset.json").read_text("utf-8"))
    (root / "dataset.json").write_text(json.dumps(summary | {"sensors": {"d415": facts.as_row()}}))
    seen: list[tuple[str, Mapping[int, LabelledDepth] | None]] = []

    def run_scene(scene: RecordedScene, motions: Mapping[int, Pose], sensor: str, images: Any) -> SceneRun:
        seen.append((scene.id, images))
        return SceneRun(scene.id, tuple(PartRun(part, NO_SEAL, "") for part in motions), (), (), Pose.identity())

    monkeypatch.setattr(table2, "run_scene", run_scene)
    dataset, track = Dataset(root), "snap-d415"
    queries = list(dataset.split(SPLIT).queries(track))
    rows = [Prediction(query.id, dataset.truth_of(query).goal_drawn, 0.5, 1.0) for query in queries]
    folders = {masks: tmp_path / masks for masks in ("given", "predicted")}
    for masks, folder in folders.items():
        write_submission(folder, manifest(dataset.id, tracks=(track,), uses_true_geometry=False, masks=masks), rows)
    found = []

    def find(query: Query, scale: float, sensor: SensorFacts) -> Query:
        found.append((scale, sensor))
        return query

    table2.chain(root, folders, track, SPLIT, 1, find_masks=find)
    assert [images is None for _, images in seen] == [True, True, False]
    own = [query for query in queries if query.scene_id == seen[-1][0]]
    assert set(seen[-1][1] or ()) == {query.part for query in own}
    assert found == [(dataset.summary["config"]["scale"], facts)] * len(own) != []


def test_predictions_of_other_queries_and_unknown_tracks_are_refused(mini: Path, tmp_path: Path, robot: None) -> None:
    write_predictions(tmp_path / "other.csv", [Prediction("test-s9999-p0-snap", Pose.identity(), 0.5, 1.0)])
    with pytest.raises(InputError, match="no prediction for any of"):
        table2.chain(mini, {"other": tmp_path / "other.csv"}, "snap", SPLIT)
    with pytest.raises(InputError, match="--track grab: there are snap"):
        table2.chain(mini, {}, "grab")


def test_the_command_prints_chain_components_and_paper(
    mini: Path, tmp_path: Path, robot: None, capsys: pytest.CaptureFixture[str]
) -> None:
    dataset = Dataset(mini)
    rows = [Prediction(q.id, dataset.truth_of(q).goal_drawn, 1.0, 1.0) for q in dataset.split("test").queries("snap")]
    write_predictions(tmp_path / "mine.csv", rows)
    part = {"component": "segmentation", "label": "masks", "measure": "mIoU", "value": 0.9, "interval": [0.8, 0.95]}
    (tmp_path / "parts.json").write_text(json.dumps([part | {"n": 7}]))
    options = ["--data", str(mini), "--track", "snap", "--components", str(tmp_path / "parts.json")]
    assert main(["table2", str(tmp_path / "mine.csv"), *options, "--out", str(tmp_path / "table2.json")]) == 0
    text = capsys.readouterr().out
    assert "| mine | " in text
    assert "| segmentation | masks | mIoU | 7 | 0.900 [0.800, 0.950] |" in text
    assert "| snapping, position | 7.2 mm |" in text
    assert [row["label"] for row in json.loads((tmp_path / "table2.json").read_text())["chain"]] == ["truth", "mine"]
    assert main(["table2", str(tmp_path / "mine.csv"), str(tmp_path / "mine.csv"), "--data", str(mini)]) == 2


@pytest.mark.parametrize("content", ["{}", '[{"component": "x"}]', "[3]"])
def test_what_is_no_list_of_components_is_refused(tmp_path: Path, content: str) -> None:
    (tmp_path / "parts.json").write_text(content)
    with pytest.raises(InputError, match=r"JSON list.*component, interval"):
        table2.read_components(tmp_path / "parts.json")
