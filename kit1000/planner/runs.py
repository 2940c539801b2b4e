"""Running the robot on a file of predictions: scene by scene, with outcomes and traces as files."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tqdm import tqdm

from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.errors import InputError, did_you_mean
from kit1000.files import json_bytes, write_own
from kit1000.planner.execute import OUTCOMES, SEATED, PartRun, SceneRun, run_scene
from kit1000.planner.trace import trace_bytes
from kit1000.pose import Pose
from kit1000.queries.tracks import TRACKS
from kit1000.submission.predictions import FILE, Predictions, read_predictions

OUTCOMES_FILE = "outcomes.json"


def run_predictions(
    root: str | Path,
    predictions: str | Path,
    scene_id: str | None = None,
    track: str | None = None,
    out: str | Path | None = None,
    seed: int = 0,
) -> list[SceneRun]:
    """Let the robot carry out predictions; writes `outcomes.json` and traces to a folder `out` if given.

    Args:
        root: dataset folder with ground truth.
        predictions: submission folder or predictions file.
        scene_id: one scene; all with a prediction when None.
        track: track whose predictions are carried out; needed if the file has several.
        out: folder.
        seed: of the path planner.
    """
    path = Path(predictions)
    rows = read_predictions(path / FILE if path.is_dir() else path)
    track = _only_track(rows, track)
    dataset = Dataset(root)
    scene_ids = sorted({query_id.partition("-p")[0] for query_id in rows.query_ids})
    if scene_id is not None:
        if scene_id not in scene_ids:
            hint = did_you_mean(scene_id, scene_ids)
            raise InputError(f"{path}: no prediction for scene {scene_id!r}; {hint}".rstrip("; "))
        scene_ids = [scene_id]
    runs = []
    for each in tqdm(scene_ids, desc="scenes", unit="", disable=None):
        scene = dataset.recorded_scene(each, truth=True)
        motions = dict(_motions(scene, rows, track))
        if motions:
            runs.append(run_scene(scene, motions, TRACKS[track].sensor, seed))
            if out is not None:
                write_own(Path(out) / f"{each}.jsonl", trace_bytes(runs[-1]))
    if out is not None:
        write_own(Path(out) / OUTCOMES_FILE, json_bytes(report(runs, dataset.id, track, seed)))
    return runs


def _only_track(rows: Predictions, track: str | None) -> str:
    found = {name for name in TRACKS for query_id in rows.query_ids if query_id.endswith(f"-{name}")}
    found = {name for name in found if not any(other != name and other.endswith(f"-{name}") for other in found)}
    if track is None:
        if len(found) != 1:
            raise InputError(f"--track: the predictions are of {', '.join(sorted(found)) or 'no track'}; name one")
        return found.pop()
    if track not in TRACKS:
        raise InputError(f"--track {track}: {did_you_mean(track, TRACKS)}there are {', '.join(TRACKS)}")
    return track


def _motions(scene: RecordedScene, rows: Predictions, track: str) -> Iterator[tuple[int, Pose]]:
    """The part and the predicted motion of each query of a track about a scene."""
    for query in scene.queries:
        row = rows.row(query.id)
        if query.track == track and row is not None:
            yield query.part, rows.motions[row]


def report(runs: Sequence[SceneRun], dataset_id: str, track: str, seed: int) -> dict[str, Any]:
    """The contents of `outcomes.json`."""
    return {
        "dataset_id": dataset_id,
        "track": track,
        "seed": seed,
        "counts": outcome_counts(part for run in runs for part in run.parts),
        "scenes": {run.scene_id: {"order": list(run.order), "parts": list(map(asdict, run.parts))} for run in runs},
    }


def outcome_counts(parts: Iterable[PartRun]) -> dict[str, int]:
    """Number of parts by outcome, in the order of OUTCOMES."""
    found = Counter(part.outcome for part in parts)
    return {outcome: found[outcome] for outcome in OUTCOMES}


def format_runs(runs: Sequence[SceneRun]) -> str:
    """Runs as text: a line for each part, then the counts."""
    lines = [
        f"{run.scene_id} part {part.part}: {part.outcome}{f' ({part.detail})' if part.detail else ''}"
        + (f", {part.seconds:.0f} s" if part.seconds else "")
        for run in runs
        for part in run.parts
    ]
    found = outcome_counts(part for run in runs for part in run.parts)
    total = sum(found.values())
    lines.append(f"{found[SEATED]} of {total} seated; " + ", ".join(f"{n} {name}" for name, n in found.items() if n))
    return "\n".join(lines)
