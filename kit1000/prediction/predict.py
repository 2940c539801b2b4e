"""Running a method on the queries of a dataset, in one process or many, into a submission folder.

Each prediction is written to a journal beside the folder at once, so that a killed run resumes where it stopped. The
predictions do not depend on the number of processes.
"""

from __future__ import annotations

import platform
import re
import shlex
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import date
from functools import lru_cache, partial
from pathlib import Path
from time import perf_counter
from typing import Literal

from tqdm import tqdm

from kit1000.dataset.own_scenes import is_own
from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.errors import InputError, InternalError, Kit1000Error, did_you_mean, failure_text
from kit1000.files import check_output
from kit1000.parallel import local_engine, usable_cores
from kit1000.prediction.catalog import TABLES, Method
from kit1000.prediction.journal import Journal
from kit1000.prediction.making import PREDICTED_MASKS, make_predictor, method_of, source_hash, with_weights
from kit1000.predictor import FILE_TARGET, PredictedMotion, Predictor, resolved, to_prediction
from kit1000.queries.tracks import ALL_TRACKS, CURVES, SPLITS
from kit1000.submission import Manifest, Submission, read_submission, write_submission
from kit1000.values import Prediction, Query, SceneShapes, TrueGeometry

AUTHORS = ("The KIT1000 authors",)  # in a new manifest; what someone else writes there stays
MICROSECOND = 6  # decimals of a time
READ_SHAPES = "kit1000.known_shapes.known_kits:kits_of_folder"  # by name: methods lie above the catalog of methods


@dataclass(frozen=True)
class RunConfig:
    """What a run predicts. With the dataset and the method's own files it determines every prediction."""

    name: str
    """Method of the catalog, or module:Object; with PREDICTED_MASKS behind it, it reads predicted masks."""
    splits: tuple[str, ...] = ("test",)
    tracks: tuple[str, ...] | None = None
    """None: all tracks of the method."""
    seed: int = 0
    """Seed of all draws of the method."""
    limit: int | None = None
    """Only the first so many queries."""
    tables: tuple[str, ...] = TABLES
    """Packages that list the methods, see `kit1000.prediction.catalog`."""
    weights: tuple[str, ...] = ()
    """Runs of training whose weights replace the published ones, see `kit1000.prediction.making.with_weights`."""
    shapes: str | None = None
    """Folder with the shapes of all scenes, for a method that reads them; None: those of the dataset."""
    assembly: str | None = None
    """Id of the assembly in that folder; None: its only one."""

    @property
    def display_name(self) -> str:
        """The name in a manifest: without the folder of a file."""
        match = FILE_TARGET.match(self.name)
        return self.name if match is None else f"{Path(match['path']).name}:{match['object']}"

    @property
    def method(self) -> Method:
        """The method, with its weights."""
        return with_weights(method_of(self.name, self.tables), self.weights)

    @classmethod
    def of(
        cls,
        name: str,
        masks: Literal["given", "predicted"],
        splits: tuple[str, ...],
        tracks: tuple[str, ...] | None,
        seed: int = 0,
        limit: int | None = None,
        tables: tuple[str, ...] = TABLES,
        weights: Sequence[Path] = (),
        shapes: Path | None = None,
        assembly: str | None = None,
    ) -> RunConfig:
        """The run of a method with given or predicted masks."""
        full = name + (PREDICTED_MASKS if masks == "predicted" else "")
        runs, folder = tuple(str(run.absolute()) for run in weights), None if shapes is None else str(shapes.absolute())
        return cls(full, splits, tracks, seed, limit, tables, runs, folder, assembly)


@dataclass(frozen=True)
class Job:
    """A query to predict for, by its place in the dataset."""

    split: str
    scene_id: str
    query_id: str
    track: str

    def __str__(self) -> str:
        return self.query_id


def predict(config: RunConfig, data: Path, out: Path, workers: int | None = None) -> Submission:
    """Run a method and write the submission; the predictions are added to a submission that is there already.

    Args:
        config: method, queries, seed.
        data: dataset folder.
        out: submission folder; an earlier submission must be of the same method and dataset.
        workers: processes; None = one per core.
    """
    method, dataset, out = config.method, Dataset(data), out.absolute()
    jobs = jobs_of(dataset, method, config)
    check_output(out, "manifest.toml")
    manifest = _manifest(config, method, dataset, {job.track for job in jobs})
    earlier = _earlier_submission(out, manifest)
    settings = {"method": config.name, "dataset_id": dataset.id, "splits": config.splits, "tracks": config.tracks}
    settings |= {"seed": config.seed, "limit": config.limit, "source": manifest.source}
    with Journal(out.with_name(f"{out.name}.journal"), settings) as journal:
        left = [job for job in jobs if job.query_id not in journal.done]
        _made.cache_clear()  # the folder may hold another dataset than in an earlier run of this process
        with local_engine(workers) as spread:
            predictions = spread(partial(predict_job, dataset.root, config), left)
            bar = tqdm(predictions, None, len(jobs), initial=len(jobs) - len(left), unit="query", disable=None)
            for prediction in bar:
                journal.add(prediction)
        used = f"{hardware()}, {workers or usable_cores()} queries at a time"
        manifest = replace(manifest, hardware=used, reproduce=_command(config, dataset, out))
        if earlier is not None:
            manifest = _merged_manifest(earlier.manifest, manifest)
        submission = write_submission(out, manifest, _sorted(dataset, [*_each(earlier), *journal.done.values()]))
        journal.delete()
    return submission


def predict_and_describe(config: RunConfig, data: Path, out: Path, workers: int | None = None) -> str:
    """`predict`, and what it wrote, in one line."""
    submission = predict(config, data, out, workers)
    seconds = submission.predictions.seconds.mean()
    tracks = ", ".join(submission.manifest.tracks)
    return f"{out}: {len(submission.predictions)} predictions of {config.name} ({tracks}), {seconds:.3g} s each"


def jobs_of(dataset: Dataset, method: Method, config: RunConfig) -> list[Job]:
    """The queries to predict for, in the order of the splits; raises InputError if there are none."""
    for track in config.tracks or ():
        if track not in method.tracks:
            hint = did_you_mean(track, method.tracks)
            raise InputError(f"--tracks {track}: {hint}the tracks of {config.name} are {', '.join(method.tracks)}")
    tracks = config.tracks or method.tracks
    jobs: dict[str, Job] = {}  # the queries of test are among those of test-all
    for name in config.splits:
        queries = [query for query in dataset.split(name).queries() if query.track in tracks]
        if not queries:
            raise InputError(f"{dataset.root}: split {name} has no query in {', '.join(tracks)}")
        jobs |= {query.id: Job(name, query.scene_id, query.id, query.track) for query in queries}
    if not jobs:
        raise InputError("--split: expected at least one")
    return list(jobs.values())[: config.limit]


def predict_job(root: Path, config: RunConfig, job: Job) -> Prediction:
    """A method's prediction for a query, and its time from the images in memory to the prediction.

    root: the dataset folder.
    """
    try:
        method, dataset, predictor = _made(root, config)
    except InternalError as error:
        raise InternalError(f"{job}: {error}") from error
    knows = method.uses_true_geometry or (method.reads == "shapes" and config.shapes is None)
    scene = dataset.split(job.split, knows).scene(job.scene_id)
    query = next(query for query in scene.queries if query.id == job.query_id)
    geometry = _geometry(dataset, method, config, scene, query)
    query.image  # noqa: B018 (reads the images before the clock starts)
    start = perf_counter()
    predicted = _predicted(predictor, query, geometry)
    return to_prediction(query, predicted, round(perf_counter() - start, MICROSECOND))


def _geometry(
    dataset: Dataset, method: Method, config: RunConfig, scene: RecordedScene, query: Query
) -> TrueGeometry | SceneShapes | None:
    """What a method gets beside the query."""
    if method.uses_true_geometry:
        return dataset.geometry.true_geometry(scene.truth_of(query.id))
    if method.reads == "shapes":
        return scene.shapes if config.shapes is None else _given_shapes(dataset, config.shapes, config.assembly)
    return None


@lru_cache(maxsize=1)
def _given_shapes(dataset: Dataset, folder: str, assembly: str | None) -> SceneShapes:
    """The shapes of a folder."""
    return resolved(READ_SHAPES)(Path(folder), assembly).shapes_for(dataset.summary)


@lru_cache(maxsize=1)
def _made(root: Path, config: RunConfig) -> tuple[Method, Dataset, Predictor]:
    """A method, the dataset and the predictor, made once in each process."""
    method, dataset = config.method, Dataset(root)
    return method, dataset, make_predictor(method, dataset, config.seed)


def _predicted(predictor: Predictor, query: Query, geometry: TrueGeometry | SceneShapes | None) -> PredictedMotion:
    """What the method returns; its errors become one line that names the query."""
    try:
        return predictor(query, geometry)
    except Kit1000Error as error:
        if isinstance(error, InternalError) or query.id in str(error):
            raise
        raise InputError(f"{query.id}: {error}") from error
    except (Exception, SystemExit) as error:
        raise InternalError(f"{query.id}: {failure_text(error)}") from error


def _earlier_submission(out: Path, new: Manifest) -> Submission | None:
    """The submission that is there already.

    Raises InputError if it is of another method or dataset, or if other code or weights made its rows.
    """
    if not (out / "manifest.toml").is_file():
        return None
    earlier = read_submission(out)
    old = earlier.manifest
    for what, theirs, ours in (("method", old.method, new.method), ("dataset", old.dataset_id, new.dataset_id)):
        if theirs != ours:
            raise InputError(f"{out}: holds predictions of {what} {theirs}, not {ours}; choose another --out")
    if old.source and old.source != new.source:
        names = f"source {old.source[:12]}, now {new.source[:12]}"
        raise InputError(f"{out}: holds rows of other code or other weights ({names}); choose another --out")
    if old.training_data != new.training_data and not old.source:
        raise InputError(
            f"{out}: holds rows of weights trained on {old.training_data or 'nothing'!r}, not on "
            f"{new.training_data or 'nothing'!r}; choose another --out"
        )
    return earlier


def _each(submission: Submission | None) -> Iterator[Prediction]:
    """The predictions of a submission one by one."""
    if submission is None:
        return
    table = submission.predictions
    rows = zip(table.query_ids, table.motions, table.confidence.tolist(), table.seconds.tolist(), strict=True)
    yield from (Prediction(*row) for row in rows)


def _sorted(dataset: Dataset, predictions: Iterable[Prediction]) -> list[Prediction]:
    """The last prediction for each query, in the order of the dataset's queries."""
    last = {prediction.query_id: prediction for prediction in predictions}
    query_ids = (query.id for split in splits_of(last) for query in dataset.split(split).queries())
    rank = {query_id: i for i, query_id in enumerate(query_ids)}
    return sorted(last.values(), key=lambda prediction: rank.get(prediction.query_id, len(rank)))


def splits_of(query_ids: Iterable[str]) -> tuple[str, ...]:
    """The splits that hold queries, in their order; test-all for those of the test split."""
    kinds = {query_id.partition("-")[0] for query_id in query_ids}
    return tuple("test-all" if kind == "test" else kind for kind in (*SPLITS, CURVES) if kind in kinds)


def _manifest(config: RunConfig, method: Method, dataset: Dataset, tracks: set[str]) -> Manifest:
    return Manifest(
        method=config.display_name,
        label=method.label,
        authors=AUTHORS,
        description=method.description,
        date=date.today().isoformat(),
        dataset_id=dataset.id,
        dataset_checksum=dataset.summary.get("checksum", ""),
        tracks=_in_order(tracks),
        predicts=method.predicts,
        learned=method.learned,
        uses_true_geometry=method.uses_true_geometry,
        reads=method.reads,
        control=method.control,
        masks="predicted" if is_own(dataset.summary) else method.masks,  # the import finds those of own scenes
        paper_row=method.paper_row,
        training_data=method.training_data,
        camera_set=method.camera_set,
        source=source_hash(method),
    )


def _merged_manifest(earlier: Manifest, new: Manifest) -> Manifest:
    """The manifest of a submission with added predictions: what people write into one by hand stays."""
    commands = dict.fromkeys([*earlier.reproduce.split(" && "), new.reproduce])
    reproduce = " && ".join(filter(None, commands))
    by_hand = {name: getattr(earlier, name) for name in ("label", "authors", "description", "url", "paper_row")}
    return replace(new, tracks=_in_order({*earlier.tracks, *new.tracks}), reproduce=reproduce, **by_hand)


def _in_order(tracks: set[str]) -> tuple[str, ...]:
    return tuple(track for track in ALL_TRACKS if track in tracks)


def _command(config: RunConfig, dataset: Dataset, out: Path) -> str:
    """The command that repeats a run, with the folders of a checkout."""
    name = config.name.removesuffix(PREDICTED_MASKS)
    program = ["kit1000"] if config.tables == TABLES else ["python", "-m", "baselines"]
    words = [*program, "predict", name, "--split", *config.splits]
    words += ["--weights", *config.weights] if config.weights else []
    words += ["--masks", "predicted"] if name != config.name else []
    words += ["--shapes", config.shapes] if config.shapes else []
    words += ["--assembly", config.assembly] if config.assembly else []
    words += ["--tracks", *config.tracks] if config.tracks else []
    words += ["--seed", str(config.seed)] if config.seed else []
    words += ["--limit", str(config.limit)] if config.limit is not None else []
    words += ["--data", f"data/{dataset.summary.get('preset', dataset.root.name)}", "--out", f"submissions/{out.name}"]
    return shlex.join(words)


def hardware() -> str:
    """The processor of this machine, and the number of its cores that this process may use."""
    file = Path("/proc/cpuinfo")
    named = re.search(r"^model name\s*: (.*)$", file.read_text(), re.M) if file.is_file() else None
    model = named[1].strip() if named else platform.processor() or platform.machine()
    return f"{model}, {usable_cores()} cores"
