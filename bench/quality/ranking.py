"""Fit the weights that rank the fits of registration, and measure what each feature of a fit gains.

    python bench/quality/ranking.py data/kit1000 --workers 8 --out results/ranking.json

The weights of each kind of image maximise the likelihood of the outcomes of queries of split train, see
`kit1000.registration.rank`. They replace kit1000/registration/rank.json. Without a feature, the other weights are
fitted again and choose among the same fits of split val. A feature wins a query that is seated only with it, and loses
one that is seated only without it; p is that of McNemar's exact test.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from scipy.optimize import minimize
from scipy.special import logsumexp

from bench.measured import run, spread
from benchmark.compare import mcnemar_p
from benchmark.measurements import Column, Measurement
from kit1000.dataset.reader import Dataset, Split
from kit1000.files import write_json
from kit1000.metrics import seatings
from kit1000.pose import Pose
from kit1000.prediction.making import make_predictor, method_of
from kit1000.queries.tracks import TRACKS
from kit1000.registration.rank import WEIGHTS, Features, Fit, same_place
from kit1000.values import Query

NETWORKS, RULES = "registration-completed", "registration"
SOURCES = {
    "ideal": ((NETWORKS, "snap"), (NETWORKS, "place"), (RULES, "snap"), (RULES, "place")),
    "restored": ((NETWORKS, "snap-d415"), (NETWORKS, "place-d415")),
    "d415": ((RULES, "snap-d415"), (RULES, "place-d415")),
}
"""The methods and tracks whose fits are of each kind of image."""
NOISE_SEED = 7  # of images of sensors for which split train has no queries
STIFFNESS = 1.0  # weight of the squares of the weights of standardised features, against overfitting
DECIMALS = 4  # of the weights
IN_VOLUME = 4  # first features, which every fit has


@dataclass(frozen=True)
class RankingOptions:
    """Fit the weights of the ranking, and measure its features."""

    data: tyro.conf.Positional[Path]
    """Dataset folder."""
    limit: int = 150
    """Most queries of each split, method and track."""
    workers: int = 1
    """Processes."""
    weights: Path = WEIGHTS
    """JSON file of the weights, which is replaced."""
    out: Path | None = None
    """JSON file of the table, such as results/ranking.json."""


@dataclass(frozen=True)
class KnownFits:
    """The fits of a query in different places, with their outcomes."""

    features: np.ndarray
    """(n, features), nan where one is unknown."""
    seated: np.ndarray
    """(n,) bool"""

    @property
    def shown(self) -> np.ndarray:
        """(n,) bool: which fits were refined in the image."""
        return ~np.isnan(self.features[:, -1])


@dataclass(frozen=True)
class Weights:
    """The weights of a kind of image; each holds the bias and the weights of the first features."""

    volume: np.ndarray
    image: np.ndarray | None

    def seats(self, queries: Sequence[KnownFits]) -> np.ndarray:
        """(queries,) bool: whether the best fit of each query is seated."""
        return np.array([len(fits.seated) > 0 and bool(fits.seated[self._scores(fits).argmax()]) for fits in queries])

    def named(self) -> dict[str, dict[str, float]]:
        """As in the file of weights."""
        stages = {"volume": self.volume, "image": self.image}
        return {
            stage: dict(zip(("bias", *Features._fields), weights.round(DECIMALS).tolist(), strict=False))
            for stage, weights in stages.items()
            if weights is not None
        }

    def _scores(self, fits: KnownFits) -> np.ndarray:
        volume = self.volume[0] + fits.features[:, : len(self.volume) - 1] @ self.volume[1:]
        if self.image is None:
            return volume
        return np.where(fits.shown, self.image[0] + np.nan_to_num(fits.features) @ self.image[1:], volume)


def main(options: RankingOptions) -> None:
    """Write the weights and print what each feature gains."""
    measurement = Measurement.begin(Dataset(options.data))
    columns = (*(Column(key, key) for key in ("kind", "feature", "n", "wins", "losses")), Column("p", "p", 3))
    table = measurement.table("features", "Queries of split val seated only with or only without a feature", *columns)
    rows: dict[str, Any] = {}
    with ProcessPoolExecutor(options.workers) as pool:
        for kind in SOURCES:
            train, val = (_known_fits(options, kind, split, pool) for split in ("train", "val"))
            weights = fitted(train)
            rows[kind] = weights.named()
            for name in Features._fields[: len(weights.volume if weights.image is None else weights.image) - 1]:
                with_it, without = weights.seats(val), fitted(train, without=name).seats(val)
                wins, losses = int((with_it & ~without).sum()), int((without & ~with_it).sum())
                row = {"n": len(val), "wins": wins, "losses": losses, "p": mcnemar_p(wins, losses)}
                table.add(kind=kind, feature=name, **row)
                print(kind, name, row, flush=True)
    write_json(options.weights, rows)
    measurement.report(options.out)


def fitted(queries: Sequence[KnownFits], without: str = "") -> Weights:
    """The likeliest weights of all fits and of those refined in the image, with the weight 0 for one feature."""
    used = np.array([name != without for name in Features._fields])
    shown = [KnownFits(fits.features[fits.shown], fits.seated[fits.shown]) for fits in queries]
    volume = [KnownFits(fits.features[:, :IN_VOLUME], fits.seated) for fits in queries]
    image = likeliest(shown, used) if any(len(fits.seated) for fits in shown) else None
    return Weights(likeliest(volume, used[:IN_VOLUME]), image)


def likeliest(queries: Sequence[KnownFits], used: np.ndarray) -> np.ndarray:
    """(1 + features,) the bias and the weights that maximise the likelihood of the outcomes; no weight is above 0.

    used: (features,) bool: the others have the weight 0.
    """
    features = np.concatenate([fits.features for fits in queries])
    usual, deviation = features.mean(0), features.std(0)
    scale = np.divide(used, deviation, out=np.zeros(len(used)), where=deviation > 0)
    cases = []
    for fits in queries:
        rows = np.column_stack([np.ones(len(fits.seated)), (fits.features - usual) * scale])
        none = np.zeros((1, rows.shape[1]))  # the last row stands for none of the fits
        cases.append((np.concatenate([rows, none]), np.append(fits.seated, not fits.seated.any())))

    def loss(unknowns: np.ndarray) -> tuple[float, np.ndarray]:
        total, slope = STIFFNESS / 2 * (unknowns[1:] ** 2).sum(), STIFFNESS * np.append(0.0, unknowns[1:])
        for rows, right in cases:
            scores = rows @ unknowns
            of_all, of_right = float(np.asarray(logsumexp(scores))), float(np.asarray(logsumexp(scores[right])))
            total += of_all - of_right
            slope = slope + np.exp(scores - of_all) @ rows - np.exp(scores[right] - of_right) @ rows[right]
        return float(total), slope

    bounds = [(None, None), *[(None, 0.0)] * len(used)]
    found = minimize(loss, np.zeros(1 + len(used)), jac=True, method="L-BFGS-B", bounds=bounds).x
    weights = found[1:] * scale
    return np.append(found[0] - weights @ usual, weights)


def _known_fits(options: RankingOptions, kind: str, split: str, pool: ProcessPoolExecutor) -> list[KnownFits]:
    """The fits of some queries of a split in images of a kind."""
    found: list[KnownFits] = []
    for method, track in SOURCES[kind]:
        queries = spread(list(_queries(Dataset(options.data).split(split, truth=True), track)), options.limit)
        ids = [query.id for query in queries]
        found += pool.map(_fits_of, repeat(options.data), repeat(split), repeat(method), repeat(track), ids)
    return found


def _queries(split: Split, track: str) -> Iterator[Query]:
    """The queries of a track; if the split has none, those in ideal depth, with images rendered by its sensor."""
    if split.name in TRACKS[track].splits:
        yield from split.queries(track)
        return
    sensor = TRACKS[track].sensor
    for query in split.queries(track.partition("-")[0]):

        def read_image(query: Query = query) -> Any:
            view = split.scene(query.scene_id).render("primary", sensor, NOISE_SEED)["primary"]
            return replace(query.image, view=view)

        yield replace(query, sensor=sensor, read_image=read_image)


def _fits_of(data: Path, split_name: str, method: str, track: str, query_id: str) -> KnownFits:
    """The fits of a query in different places."""
    dataset, queries = _opened(data, split_name, track)
    query = queries[query_id]
    distinct: list[Fit] = []
    for fit in _predictor(data, method).fits(replace(query)):  # a copy: its image, once read, is kept with it
        if not any(same_place(fit, known) for known in distinct):
            distinct.append(fit)
    if not distinct:
        return KnownFits(np.zeros((0, len(Features._fields))), np.zeros(0, bool))
    truth = dataset.truth_of(query)
    motions = Pose.stack([fit.goal_from_now for fit in distinct])
    seated = seatings(motions, [truth] * len(distinct), dataset.geometry).seated
    return KnownFits(np.array([fit.features for fit in distinct], float), seated)


@cache
def _opened(data: Path, split: str, track: str) -> tuple[Dataset, dict[str, Query]]:
    """A dataset, and the queries of a track of a split by id."""
    dataset = Dataset(data)
    return dataset, {query.id: query for query in _queries(dataset.split(split, truth=True), track)}


@cache
def _predictor(data: Path, method: str) -> Any:
    return make_predictor(method_of(method), Dataset(data), 0)


if __name__ == "__main__":
    run(main, RankingOptions, __doc__)
