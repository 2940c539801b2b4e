"""Made-up entries of the leaderboard: manifests and scores of methods with random errors."""

from __future__ import annotations

import hashlib
from dataclasses import asdict, replace
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np

from benchmark import quantities
from benchmark.evaluate import PerQuery
from benchmark.protocol import Protocol, read_protocol
from benchmark.report import json_text
from benchmark.summary import summarise
from kit1000.queries.guesses import FIXED_LEVELS, LEVELS
from kit1000.queries.tracks import CURVES, TRACKS, curve_id
from kit1000.rng import stream
from kit1000.submission.manifest import Manifest, write_manifest

SCENES = 20
DATASET = "0123456789abcdef"
PREDICTIONS = b"query_id,qw,qx,qy,qz,x,y,z,confidence,seconds\ntest-s0000-p0-snap,1,0,0,0,0,0,0,0.5,-1\n"

SNAPS = Manifest(
    method="Snaps <b>well</b> & often",
    authors=("A. Name", 'B. "Quote" Name'),
    description="Fits the part's surface into the cavity <script>alert(1)</script>.",
    url="https://example.org/snaps?a=1&b=2",
    date="2026-03-01",
    dataset_id=DATASET,
    tracks=(*TRACKS, CURVES),
    learned=False,
    uses_true_geometry=False,
    hardware="one core",
    reproduce="python -m baselines predict registration --data DIR --split test --out FOLDER",
)
LEARNED = replace(SNAPS, method="Learned", url="", learned=True, training_data="train", date="2026-02-01", reproduce="")
ORACLE = replace(
    SNAPS, method="With true volumes", uses_true_geometry=True, date="2026-01-15", tracks=("snap", "place")
)
ROTATIONS = replace(
    SNAPS, method="Rotations only", predicts="rotation", learned=True, tracks=("snap", "snap-tilt", CURVES)
)
GUESS = replace(SNAPS, method="Unchanged guess", control=True, tracks=("snap", "snap-tilt", CURVES))
METHODS = {  # by folder: the manifest, about its errors [mm, degrees], and seconds a query
    "snaps": (SNAPS, 1.2, 1.5, 0.4),
    "learned": (LEARNED, 3.9, 4.9, 20.0),
    "oracle": (ORACLE, 0.8, 0.9, 3.0),
    "rotations": (ROTATIONS, 3.0, 6.0, 0.1),
    "guess": (GUESS, 27.0, 13.8, None),
}


def write_board(folder: Path, names: tuple[str, ...] = tuple(METHODS)) -> Path:
    """A folder of submissions, all scored."""
    for name in names:
        manifest, position_mm, rotation_deg, seconds = METHODS[name]
        write_scored(folder / name, manifest, position_mm, rotation_deg, seconds)
    return folder


def write_scored(
    folder: Path, manifest: Manifest, position_mm: float, rotation_deg: float, seconds: float | None
) -> None:
    """The manifest, the scores and a predictions file of one method."""
    write_manifest(folder / "manifest.toml", manifest)
    (folder / "predictions.csv").write_bytes(PREDICTIONS)
    (folder / "scores.json").write_text(scores(manifest, position_mm, rotation_deg, seconds), encoding="utf-8")


@cache
def scores(manifest: Manifest, position_mm: float, rotation_deg: float, seconds: float | None) -> str:
    """The text of scores.json for random errors."""
    protocol = replace(read_protocol(), bootstrap={"draws": 50, "seed": 2026, "level": 0.95})
    tracks = [track for track in TRACKS if track in manifest.tracks]
    ids = [(f"test-s{k:04}-p0-{track}", track) for track in tracks for k in range(SCENES)]
    if CURVES in manifest.tracks:
        ids += [(query_id, CURVES) for query_id in curve_ids(4)]
    rows = _rows(manifest, ids, position_mm, rotation_deg, seconds)
    return json_text(provenance(manifest, protocol) | summarise(rows, protocol, manifest.predicts == "rotation"))


def curve_ids(scenes: int) -> list[str]:
    """All queries of the curves about some scenes."""
    levels = product(range(scenes), ("pos", "rot"), range(LEVELS), FIXED_LEVELS)
    return [curve_id(f"test-s{k:04}", 0, varied, level, fixed) for k, varied, level, fixed in levels]


def provenance(manifest: Manifest, protocol: Protocol) -> dict[str, object]:
    """The setting of a score, with the predictions of the board."""
    return {
        "protocol": protocol.name,
        "status": protocol.status,
        "metric_versions": dict(protocol.metric_versions),
        "dataset_id": DATASET,
        "split": "test",
        "exact": "near",
        "commit": "0123456789abcdef0123456789abcdef01234567",
        "evaluator": "fedcba9876543210",
        "method": manifest.method,
        "manifest": asdict(manifest),
        "predictions_sha256": hashlib.sha256(PREDICTIONS).hexdigest(),
    }


def _rows(
    manifest: Manifest, ids: list[tuple[str, str]], position_mm: float, rotation_deg: float, seconds: float | None
) -> PerQuery:
    """A row for each query: errors about some means, and properties in turn."""
    n, k = len(ids), np.arange(len(ids))
    rng = stream(1, manifest.method)
    position, rotation = position_mm * rng.gamma(2, 0.5, n), rotation_deg * rng.gamma(2, 0.5, n)
    rotation_only = manifest.predicts == "rotation"
    mssd = position + 0.4 * rotation
    if not rotation_only:
        for i, (query_id, track) in enumerate(ids):
            if track == CURVES:  # worse as the guess gets worse
                position[i] += 0.02 * position_mm * int(query_id[-6]) ** 1.3
    measured = {
        quantities.POSITION.key: position,
        quantities.ROTATION.key: rotation,
        quantities.MSSD.key: mssd,
        quantities.SEATED.key: mssd < 3,
        quantities.STRICT.key: mssd < 1,
        quantities.PENETRATION.key: mssd / 5,
        quantities.POSITION_PLAIN.key: position * 1.1,
        quantities.ROTATION_PLAIN.key: rotation * 2,
        quantities.SECONDS.key: np.full(n, np.nan if seconds is None else seconds),
    }
    for quantity in quantities.per_query() if rotation_only else ():
        if quantity.needs_position:
            measured[quantity.key] = np.zeros(n, bool) if quantity.rate else np.full(n, np.nan)
    return PerQuery(
        query_id=np.array([query_id for query_id, _ in ids]),
        track=np.array([track for _, track in ids]),
        scene_id=np.array([f"test-s{i % SCENES:04}" for i in k]),
        assembly_id=np.array([f"test-{i % SCENES:04}" for i in k]),
        part_id=np.array([f"test-{i % SCENES:04}-p{i % 3}" for i in k]),
        covered=k % 17 > 0,
        quantities=measured,
        exact_test=np.zeros(n, bool),
        exact_disagreement=np.zeros(n, bool),
        confidence=1 / (1 + mssd * rng.uniform(0.5, 1.5, n)),
        rest_mode=np.where(k % 5 < 3, "upright", "tumbled"),
        tilt_deg=(k * 7.0) % 44,
        kits=2 + k % 4,
        crowded=k % 3 == 0,
        held_out=k % 4 == 0,
        visible=0.5 + (k % 10) / 20,
        noise_px=0.1 + (k % 5) / 25,
        symmetry=np.array(["one goal", "several goals", "free axis"])[k % 3],
    )
