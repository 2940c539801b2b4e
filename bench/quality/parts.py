"""Comparison of our parts with real ones: through holes, fill, aspect, and whether a classifier can separate them.

    make bench-parts PARTS=DIR
    python bench/quality/parts.py DIR --count 1000
    python bench/quality/parts.py DIR --ours OTHER_DIR

Targets: through holes 65 to 85 %, median fill 0.30 to 0.46, median aspect 2.2 to 3.2, D2 distance at most 1.5 times
that between two halves of the real set, balanced accuracy of classifiers at most 75 %, no near-duplicates.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from sklearn.ensemble import RandomForestClassifier
from sklearn.linear_model import LogisticRegression
from sklearn.model_selection import StratifiedKFold, cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from bench.quality.descriptors import Shape, d2_distance, d2_noise, describe, near_duplicates
from benchmark.measurements import Column, Measurement, rate
from kit1000.errors import MeshRefused, Redraw
from kit1000.mesh import Mesh
from kit1000.parts.family import make_part
from kit1000.parts.family_catalog import FAMILIES
from kit1000.parts.files.read import mesh_files, read_mesh
from kit1000.parts.mixtures import MIXTURES, choose_family
from kit1000.rng import stream

MIXTURE = "2026"
LONGEST = 45e-3  # [m] no shape measure depends on it
REDRAWS = 20  # attempts before a family counts as broken
DRAWS = 10  # balanced samples of our parts that a classifier's accuracy is averaged over
FOLDS = 5


TARGET_COLUMNS = Column("target", "target"), Column("met", "met")
MEASURES: dict[str, tuple[Callable[[Shape], float], tuple[float, float] | None]] = {
    "fill of the box": (lambda shape: shape.fill, (0.30, 0.46)),
    "aspect": (lambda shape: shape.aspect, (2.2, 3.2)),
    "volume / hull": (lambda shape: shape.convexity, None),
    "middle / longest side": (lambda shape: shape.middle, None),
    "area / volume^(2/3)": (lambda shape: shape.roughness, None),
}
"""Continuous measures by name, with the range in which the median of ours shall be."""
HOLED = (0.65, 0.85)  # share of ours with through holes
TRIANGLES = (200, 1500)  # median of ours
MOST_ACCURATE = 0.75  # classifier
MOST_DISTANT = 1.5  # D2 distance, times that of two halves of the real set


@dataclass(frozen=True)
class Parts:
    """Compare our parts with real ones."""

    parts: tyro.conf.Positional[Path]
    """Folder of real meshes; what is not closed or cannot be mended is left out."""
    ours: Path | None = None
    """Folder of meshes to compare instead of sampling them."""
    count: int = 1000
    """Number of parts to sample from the mixture 2026."""
    seed: int = 0
    """Seed of the samples."""
    out: Path | None = None
    """JSON file of the tables, such as results/parts.json."""


def main(options: Parts) -> int:
    """Print the comparison; the exit status is 1 when a target is missed."""
    real = shapes_of(options.parts, options.seed)
    ours = shapes_of(options.ours, options.seed) if options.ours else sampled_shapes(options.count, options.seed)
    measurement = Measurement.begin()
    measurement.setting["command"] = measurement.setting["command"].replace(str(options.parts), "PARTS")
    add_tables(measurement, real, ours, options.seed)
    measurement.report(options.out)
    return int(any(row.get("met") == "no" for each in measurement.tables.values() for row in each.rows))


def shapes_of(folder: Path, seed: int) -> list[Shape]:
    """Descriptors of every mesh of a folder that can be a part."""
    meshes, reasons = [], Counter()
    for path in mesh_files(folder):
        try:
            meshes.append(read_mesh(path).mesh)
        except MeshRefused as refused:
            reasons[refused.reason.split(":")[0]] += 1
    for reason, times in reasons.items():
        print(f"left out {times}: {reason}")
    return [describe(mesh, stream(seed, "describe", index)) for index, mesh in enumerate(meshes)]


def sampled_shapes(count: int, seed: int) -> list[Shape]:
    """Descriptors of parts sampled from the mixture 2026."""
    return [describe(_sampled(seed, index), stream(seed, "describe", index)) for index in range(count)]


def _sampled(seed: int, index: int) -> Mesh:
    name = choose_family(seed, index, weights=MIXTURES[MIXTURE])
    for attempt in range(REDRAWS):
        dims = FAMILIES[name].draw(stream(seed, index, attempt))
        try:
            return make_part(f"p{index}", name, dims, LONGEST).mesh
        except Redraw:
            continue
    raise SystemExit(f"{name}: {REDRAWS} samples in a row are no part")


def add_tables(measurement: Measurement, real: Sequence[Shape], ours: Sequence[Shape], seed: int) -> None:
    """Add what both sets measure, with the targets."""
    title = f"Shapes of {len(real)} real parts and {len(ours)} of ours: median and quartiles"
    both = [
        Column(f"{which}{key}", f"{which}{end}", 2)
        for which in ("real", "ours")
        for key, end in (("", ""), ("_low", ", 25 %"), ("_high", ", 75 %"))
    ]
    shapes = measurement.table("shapes", title, Column("measure", "measure"), *both, *TARGET_COLUMNS)
    for name, (read, target) in MEASURES.items():
        row: dict[str, Any] = {"measure": name}
        for which, parts in (("real", real), ("ours", ours)):
            quartiles = np.percentile([read(shape) for shape in parts], [25, 50, 75])
            row |= dict(zip((f"{which}_low", which, f"{which}_high"), quartiles, strict=True))
        shapes.add(**row, **(_target(row["ours"], *target) if target else {}))
    _add_shares(measurement, real, ours, seed)
    _add_distance(measurement, real, ours, seed)
    pairs = [len(near_duplicates(parts)) for parts in (real, ours)]
    triangles = [round(np.median([shape.triangles for shape in parts])) for parts in (real, ours)]
    columns = Column("count", "count"), Column("real", "real", 0), Column("ours", "ours", 0)
    counts = measurement.table("counts", "Counts", *columns, *TARGET_COLUMNS)
    counts.add(count="triangles, median", real=triangles[0], ours=triangles[1], **_target(triangles[1], *TRIANGLES))
    counts.add(count="near-duplicates", real=pairs[0], ours=pairs[1], **_target(pairs[1], 0, 0))


def _add_shares(measurement: Measurement, real: Sequence[Shape], ours: Sequence[Shape], seed: int) -> None:
    """Add the parts with through holes, and how often classifiers are right about which set a part is of."""
    columns = Column("share", "share"), Column("real", "real, %", 1, True), Column("ours", "ours, %", 1, True)
    table = measurement.table("shares", "Shares of parts", *columns, *TARGET_COLUMNS)
    holed = [rate([shape.genus > 0 for shape in parts]) for parts in (real, ours)]
    met = _target(holed[1]["rate"], *HOLED, percent=True)
    table.add(share="with through holes", real=holed[0], ours=holed[1], **met)
    for name, accuracy in classifier_accuracy(real, ours, seed).items():
        met = _target(accuracy, 0, MOST_ACCURATE, percent=True)
        table.add(share=f"told from real ones by {name}", ours=accuracy, **met)


def _add_distance(measurement: Measurement, real: Sequence[Shape], ours: Sequence[Shape], seed: int) -> None:
    """Add the distance of the sets, and its ratio to that of two halves of the real one."""
    noise, gap = d2_noise(real, stream(seed, "halves")), d2_distance(ours, real)
    columns = Column("sets", "sets"), Column("distance", "D2 distance", 3), Column("ratio", "times that of halves", 2)
    table = measurement.table("distance", "Distance of the distributions of distances", *columns, *TARGET_COLUMNS)
    table.add(sets="two halves of the real parts", distance=noise, ratio=1.0)
    table.add(sets="ours and real parts", distance=gap, ratio=gap / noise, **_target(gap / noise, 0, MOST_DISTANT))


def _target(value: float, low: float, high: float, percent: bool = False) -> dict[str, str]:
    """The cells of a target: its range, and whether a value is in it."""
    low_text, high_text = (f"{100 * end:g} %" if percent else f"{end:g}" for end in (low, high))
    target = f"{high_text} at most" if not low and high else low_text if low == high else f"{low_text} to {high_text}"
    return {"target": target, "met": "yes" if low <= value <= high else "no"}


def classifier_accuracy(real: Sequence[Shape], ours: Sequence[Shape], seed: int) -> dict[str, float]:
    """Cross-validated accuracy of two simple classifiers on as many of ours as there are real ones."""
    models = {
        "a logistic regression": make_pipeline(StandardScaler(), LogisticRegression(C=0.3, max_iter=2000)),
        "a random forest": RandomForestClassifier(200, min_samples_leaf=2, random_state=seed),
    }
    rng = stream(seed, "classifier")
    rates: dict[str, list[float]] = {name: [] for name in models}
    for _ in range(DRAWS):
        picked = rng.choice(len(ours), size=min(len(real), len(ours)), replace=False)
        x = np.array([shape.vector() for shape in [*real, *(ours[i] for i in picked)]])
        y = np.repeat([0, 1], [len(real), len(picked)])
        folds = StratifiedKFold(FOLDS, shuffle=True, random_state=int(rng.integers(2**31)))
        for name, model in models.items():
            scores = cross_val_score(model, x, y, cv=folds, scoring="balanced_accuracy")
            rates[name].append(float(scores.mean()))
    return {name: float(np.mean(all_draws)) for name, all_draws in rates.items()}


if __name__ == "__main__":
    raise SystemExit(main(tyro.cli(Parts)))
