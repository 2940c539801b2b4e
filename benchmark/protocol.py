"""The protocol: tracks, thresholds, bins and the bootstrap of a score, read from a dated JSON file in `protocols/`.

Bins and thresholds are in that file and nowhere in code. Thresholds of the metrics are in both, and compared, so that
the file and the code cannot differ unnoticed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any

from kit1000 import metrics
from kit1000.errors import InputError
from kit1000.files import read_json
from kit1000.kits import seating
from kit1000.metrics.seating import EXACT_BANDS

FOLDER = Path(__file__).parent / "protocols"
CURRENT = "kit1000-2026-12"
MM = 1e3  # millimetres in a metre
FOUND, ABLATION, NO_MASKS = "found", "given, an ablation", "none"  # the masks of a method where depth is noisy


@dataclass(frozen=True)
class Protocol:
    """A protocol, field by field as in its JSON file."""

    name: str
    status: str
    """draft, or frozen: then no number of the file may change."""
    dataset: Mapping[str, str]
    """{"preset", "id"}: the dataset of the leaderboard."""
    metric_versions: Mapping[str, int]
    """Versions by name of a metric; must be those of `kit1000.metrics.METRIC_VERSIONS`."""
    tracks: Mapping[str, Mapping[str, str | None]]
    """{"split", "sensor", "guess"} of each track of the leaderboard; since kit1000-2026-12 also "masks": predicted if
    figures by given masks are an ablation there, else given."""
    splits: tuple[str, ...]
    """Splits that can be scored; the first one is that of the leaderboard."""
    thresholds: Mapping[str, float]
    """seated_mm, strict_mm, near_limit_mm of the seating test; a pose beyond beyond_mm or beyond_deg is another one."""
    bootstrap: Mapping[str, float]
    """draws, seed and level of the intervals."""
    breakdown: Mapping[str, tuple[float, ...]]
    """Lower ends of the bins of tilt_deg, visible and, since data 2.0.0, noise_px; the last bin is open."""
    histograms: Mapping[str, tuple[float, ...]]
    """Lower ends of the bins of position_mm and rotation_deg; the last bin is open."""
    curves: Mapping[str, Any]
    """The split and track of the robustness curves, their levels and the percentiles of their band. They hold the
    `first_scenes` alone if no other is predicted."""
    risk_points: int
    """Number of points of a risk-coverage curve."""
    listed: int
    """Number of queries listed with the worst predictions, and with those nearest to the median."""

    @property
    def draws(self) -> int:
        """Bootstrap draws of an interval."""
        return int(self.bootstrap["draws"])

    @property
    def seed(self) -> int:
        """Seed of the bootstrap."""
        return int(self.bootstrap["seed"])


@cache
def read_protocol(name: str = CURRENT) -> Protocol:
    """The protocol of a name. Raises InputError if there is none, or if the code differs from it."""
    known = sorted(path.stem for path in FOLDER.glob("*.json"))
    if name not in known:
        raise InputError(f"no protocol {name!r}; there are {', '.join(known)}")
    return protocol_of(read_json(FOLDER / f"{name}.json"), name)


def masks_of(scores: Mapping[str, Any], track: str) -> str:
    """Whose masks the figures of a track rest on: FOUND, ABLATION or NO_MASKS; empty if the protocol does not ask.

    scores: the content of scores.json.
    """
    manifest = scores["manifest"]
    if read_protocol(scores["protocol"]).tracks.get(track, {}).get("masks") != "predicted":
        return ""
    if manifest["masks"] == "predicted":
        return FOUND
    return NO_MASKS if manifest["control"] or manifest["uses_true_geometry"] else ABLATION


def protocol_of(row: Mapping[str, Any], name: str) -> Protocol:
    """The protocol in the JSON value of a file of this name."""
    wanted = {field.name for field in fields(Protocol)}
    if set(row) != wanted:
        odd = ", ".join(sorted(wanted ^ set(row)))
        raise InputError(f"protocol {name}: fields missing or too many: {odd}")
    lists = {key: {bin_: tuple(edges) for bin_, edges in row[key].items()} for key in ("breakdown", "histograms")}
    protocol = Protocol(**{**row, **lists, "splits": tuple(row["splits"])})
    _check_metrics(protocol)
    if protocol.name != name:
        raise InputError(f"protocol {name}: its file calls it {protocol.name!r}")
    if protocol.status not in ("draft", "frozen"):
        raise InputError(f"protocol {name}: status {protocol.status!r}, expected draft or frozen")
    return protocol


def _check_metrics(protocol: Protocol) -> None:
    """Refuse a protocol whose metric versions and limits differ from the code."""
    versions = metrics.METRIC_VERSIONS
    for metric, version in protocol.metric_versions.items():
        if versions.get(metric) != version:
            has = f"version {versions[metric]}" if metric in versions else "no such metric"
            raise InputError(f"protocol {protocol.name} wants {metric} version {version}; this code has {has}")
    limits = {
        "seated_mm": seating.SEATED_LIMIT,
        "strict_mm": seating.STRICT_LIMIT,
        "near_limit_mm": EXACT_BANDS["near"],
    }
    for key, limit in limits.items():
        threshold = protocol.thresholds[key]
        if abs(threshold - limit * MM) > 1e-9:
            raise InputError(f"protocol {protocol.name}: {key} {threshold:g}; the code has {limit * MM:g}")
