"""Comparison of our parts with real ones: through holes, fill, aspect, and whether a classifier can separate them.

    make bench-parts PARTS=DIR
    python bench/quality/parts.py DIR --count 1000
    python bench/quality/parts.py DIR --ours OTHER_DIR

Targets: through holes 65 to 85 %, median fill 0.30 to 0.46, median aspect 2.2 to 3.2, D2 distance at most 1.5 times
that between two halves of the real set, balanced accuracy at most 75 %, no near-duplicates.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from sklearn.ensemble import RandomForestClassifier
from sklearn.linear_model import LogisticRegression
from sklearn.model_selection import StratifiedKFold, cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from bench.quality.descriptors import Shape, d2_distance, d2_noise, describe, near_duplicates
from kit1000.errors import Redraw
from kit1000.mesh import Mesh
from kit1000.parts.catalog import FAMILIES
from kit1000.parts.family import make_part
from kit1000.parts.files.sources import mesh_files, read_all
from kit1000.parts.mixtures import MIXTURES, choose_family
from kit1000.rng import stream

MIXTURE = "2026"
LONGEST = 45e-3  # [m] no shape measure depends on it
REDRAWS = 20  # tries before a family counts as broken
DRAWS = 10  # balanced draws of our parts that a classifier's accuracy is averaged over
FOLDS = 5


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    name: str
    real: str
    ours: str
    target: str
    met: bool


def main(
    parts: Annotated[Path, tyro.conf.Positional], ours: Path | None = None, count: int = 1000, seed: int = 0
) -> int:
    """Print the comparison; the exit status is 1 when a target is missed.

    Args:
        parts: folder of real meshes; what is not closed or cannot be mended is left out.
        ours: folder of meshes to compare instead of drawing them.
        count: how many parts to draw from the mixture 2026.
        seed: of the draws.
    """
    real = shapes_of(parts, seed)
    drawn = shapes_of(ours, seed) if ours else draw_shapes(count, seed)
    print(f"{len(real)} real parts, {len(drawn)} of ours")
    rows = table(real, drawn, seed)
    print_table(rows)
    return 0 if all(row.met for row in rows) else 1


def shapes_of(folder: Path, seed: int) -> list[Shape]:
    """Descriptors of every mesh of a folder that can be a part."""
    readings, refusals = read_all(mesh_files(folder))
    for reason, times in Counter(refusal.reason.split(":")[0] for refusal in refusals).items():
        print(f"left out {times}: {reason}")
    return [describe(one.mesh, stream(seed, "describe", index)) for index, one in enumerate(readings)]


def draw_shapes(count: int, seed: int) -> list[Shape]:
    """Descriptors of parts drawn from the mixture 2026."""
    return [describe(_drawn(seed, index), stream(seed, "describe", index)) for index in range(count)]


def _drawn(seed: int, index: int) -> Mesh:
    name = choose_family(seed, index, weights=MIXTURES[MIXTURE])
    for attempt in range(REDRAWS):
        dims = FAMILIES[name].draw(stream(seed, index, attempt))
        try:
            return make_part(f"p{index}", name, dims, LONGEST).mesh
        except Redraw:
            continue
    raise SystemExit(f"{name}: {REDRAWS} drawings in a row are no part")


def table(real: Sequence[Shape], ours: Sequence[Shape], seed: int) -> list[Row]:
    """All properties of both sets, with the targets."""
    noise = d2_noise(real, stream(seed, "halves"))
    gap, accuracy, pairs = d2_distance(ours, real), classifier_accuracy(real, ours, seed), len(near_duplicates(ours))
    return [
        _median("triangles", real, ours, lambda shape: shape.triangles, (200, 1500), "{:.0f}"),
        _share("through holes", real, ours, (0.65, 0.85)),
        _median("fill of the box", real, ours, lambda shape: shape.fill, (0.30, 0.46)),
        _median("aspect", real, ours, lambda shape: shape.aspect, (2.2, 3.2)),
        _median("volume / hull", real, ours, lambda shape: shape.convexity),
        _median("middle / longest side", real, ours, lambda shape: shape.middle),
        _median("area / volume^(2/3)", real, ours, lambda shape: shape.roughness),
        Row("D2 distance", f"{noise:.3f} (halves)", f"{gap:.3f}", f"<= {1.5 * noise:.3f}", gap <= 1.5 * noise),
        *[Row(f"classifier, {name}", "", f"{rate:.1%}", "<= 75 %", rate <= 0.75) for name, rate in accuracy.items()],
        Row("near-duplicates", str(len(near_duplicates(real))), str(pairs), "0", pairs == 0),
    ]


def _median(
    name: str,
    real: Sequence[Shape],
    ours: Sequence[Shape],
    read: Callable[[Shape], float],
    target: tuple[float, float] | None = None,
    form: str = "{:.2f}",
) -> Row:
    """Median with quartiles of one measure."""
    cells, middle = [], 0.0
    for shapes in (real, ours):
        low, middle, high = np.percentile([read(shape) for shape in shapes], [25, 50, 75])
        cells.append(f"{form} ({form} .. {form})".format(middle, low, high))
    if target is None:
        return Row(name, cells[0], cells[1], "", True)
    return Row(name, cells[0], cells[1], f"{target[0]:g} .. {target[1]:g}", target[0] <= float(middle) <= target[1])


def _share(name: str, real: Sequence[Shape], ours: Sequence[Shape], target: tuple[float, float]) -> Row:
    shares = [float(np.mean([shape.genus > 0 for shape in shapes])) for shapes in (real, ours)]
    met = target[0] <= shares[1] <= target[1]
    return Row(name, f"{shares[0]:.0%}", f"{shares[1]:.0%}", f"{target[0]:.0%} .. {target[1]:.0%}", met)


def classifier_accuracy(real: Sequence[Shape], ours: Sequence[Shape], seed: int) -> dict[str, float]:
    """Cross-validated accuracy of two simple classifiers on as many of ours as there are real ones."""
    models = {
        "logistic": make_pipeline(StandardScaler(), LogisticRegression(C=0.3, max_iter=2000)),
        "forest": RandomForestClassifier(200, min_samples_leaf=2, random_state=seed),
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


def print_table(rows: Sequence[Row]) -> None:
    """The rows in columns, misses marked."""
    print(f"{'':26}{'real':>24}{'ours':>24}{'target':>18}")
    for row in rows:
        print(f"{row.name:26}{row.real:>24}{row.ours:>24}{row.target:>18}{'' if row.met else '   missed'}")


if __name__ == "__main__":
    raise SystemExit(tyro.cli(main))
