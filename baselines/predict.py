"""Running a method on the queries of a dataset, in one process or many, into a submission folder.

Each answer stands in a journal beside the folder as soon as it is there, so that a killed run goes on where it
stopped. The answers do not depend on the number of processes.
"""

from __future__ import annotations

import platform
import re
import shlex
import traceback
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from datetime import date
from functools import lru_cache, partial
from pathlib import Path
from time import perf_counter

from tqdm import tqdm

from baselines.journal import Journal
from baselines.methods import EVERY, Method, made, method_of, source_hash
from kit1000.dataset.reader import Dataset
from kit1000.engines import local
from kit1000.engines.cores import cores
from kit1000.errors import Fault, InputError, Kit1000Error, near
from kit1000.files import check_writable
from kit1000.predictor import PredictedMotion, Predictor, to_prediction
from kit1000.submission import Manifest, Submission, read_submission, write_submission
from kit1000.tracks import CURVES, SPLITS
from kit1000.values import Prediction, Query, Truth

AUTHORS = ("The KIT1000 authors",)  # in a new manifest; what someone else writes there stays
MICROSECOND = 6  # decimals of a time


@dataclass(frozen=True)
class Asked:
    """What a run is to answer. With the dataset and the method's own files it determines every answer."""

    name: str
    """Of METHODS, or module:Object."""
    splits: tuple[str, ...] = ("test",)
    tracks: tuple[str, ...] | None = None
    """None: all that the method answers."""
    seed: int = 0
    """Of all draws of the method."""
    limit: int | None = None
    """The first so many queries alone."""


@dataclass(frozen=True)
class Job:
    """A query to answer, by where it is found."""

    split: str
    scene_id: str
    query_id: str
    track: str

    def __str__(self) -> str:
        return self.query_id


def predict(asked: Asked, data: Path, out: Path, workers: int | None = None) -> Submission:
    """Answer what is asked and write the submission; to one that is there the answers are added.

    Args:
        asked: method, queries, seed.
        data: dataset folder.
        out: submission folder; an earlier one must be of the same method and dataset.
        workers: processes; None = one per core.
    """
    method, dataset, out = method_of(asked.name), Dataset(data), out.absolute()
    jobs = jobs_of(dataset, method, asked)
    check_writable(out)
    earlier = _earlier(out, asked.name, dataset)
    run = {"method": asked.name, "dataset_id": dataset.id, "splits": asked.splits, "tracks": asked.tracks}
    run |= {"seed": asked.seed, "limit": asked.limit, "source": source_hash(method)}
    with Journal(out.with_name(f"{out.name}.journal"), run) as journal:
        left = [job for job in jobs if job.query_id not in journal.done]
        _ready.cache_clear()  # the folder may hold another dataset than in an earlier run of this process
        with local(workers) as spread:
            answers = spread(partial(answer_of, dataset.root, asked.name, asked.seed), left)
            for prediction in tqdm(answers, None, len(jobs), initial=len(jobs) - len(left), unit="query", disable=None):
                journal.add(prediction)
        manifest = _manifest(asked, method, dataset, {job.track for job in jobs})
        manifest = replace(manifest, hardware=_hardware(workers), reproduce=_command(asked, dataset, out))
        if earlier is not None:
            manifest = _joined(earlier.manifest, manifest)
        submission = write_submission(out, manifest, _in_order(dataset, [*_singly(earlier), *journal.done.values()]))
        journal.delete()
    return submission


def jobs_of(dataset: Dataset, method: Method, asked: Asked) -> list[Job]:
    """The queries to answer, in the order of the splits; raises InputError when there is nothing to do."""
    for track in asked.tracks or ():
        if track not in method.tracks:
            hint = near(track, method.tracks)
            raise InputError(f"--tracks {track}: {hint}{asked.name} answers {', '.join(method.tracks)}")
    wanted = asked.tracks or method.tracks
    jobs: dict[str, Job] = {}  # the queries of test are among those of test-all
    for name in asked.splits:
        queries = [query for query in dataset.split(name).queries() if query.track in wanted]
        if not queries:
            raise InputError(f"{dataset.root}: split {name} asks nothing in {', '.join(wanted)}")
        jobs |= {query.id: Job(name, query.scene_id, query.id, query.track) for query in queries}
    if not jobs:
        raise InputError("--split: expected at least one")
    return list(jobs.values())[: asked.limit]


def answer_of(root: Path, name: str, seed: int, job: Job) -> Prediction:
    """A method's answer to a query, and how long it took from the images in memory to the answer."""
    method, dataset, predictor = _ready(root, name, seed)
    scene = dataset.split(job.split, method.uses_true_geometry).scene(job.scene_id)
    query = next(query for query in scene.queries if query.id == job.query_id)
    truth = scene.truth_of(query.id) if method.uses_true_geometry else None
    query.image  # noqa: B018 (reads the images: reading is no part of the method)
    start = perf_counter()
    answer = _called(predictor, query, truth)
    return to_prediction(query, answer, round(perf_counter() - start, MICROSECOND))


@lru_cache(maxsize=1)
def _ready(root: Path, name: str, seed: int) -> tuple[Method, Dataset, Predictor]:
    """A method made and ready, once in each process."""
    method, dataset = method_of(name), Dataset(root)
    return method, dataset, made(method, dataset, seed)


def _called(predictor: Predictor, query: Query, truth: Truth | None) -> PredictedMotion:
    """The answer; whatever goes wrong is said in one line that names the query."""
    try:
        return predictor(query, truth)
    except Kit1000Error as error:
        if isinstance(error, Fault) or query.id in str(error):
            raise
        raise InputError(f"{query.id}: {error}") from error
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        where = [frame for frame in frames if "site-packages" not in frame.filename][-1]
        said = " ".join(str(error).split()) or "no message"
        place = f"{Path(where.filename).name}:{where.lineno}"
        raise Fault(f"{query.id}: {type(error).__name__}: {said} ({place})") from error


def _earlier(out: Path, name: str, dataset: Dataset) -> Submission | None:
    """The submission that is there already; raises InputError when it is another one."""
    if not out.exists() or not any(out.iterdir()):
        return None
    earlier = read_submission(out)
    for what, theirs, ours in (
        ("method", earlier.manifest.method, name),
        ("dataset", earlier.manifest.dataset_id, dataset.id),
    ):
        if theirs != ours:
            raise InputError(f"{out}: holds answers of {what} {theirs}, not {ours}; choose another --out")
    return earlier


def _singly(submission: Submission | None) -> Iterator[Prediction]:
    if submission is None:
        return
    all_of = submission.predictions
    rows = zip(all_of.query_ids, all_of.motions, all_of.confidence.tolist(), all_of.seconds.tolist(), strict=True)
    yield from (Prediction(*row) for row in rows)


def _in_order(dataset: Dataset, predictions: Iterable[Prediction]) -> list[Prediction]:
    """The last prediction for each query, in the order in which the dataset asks."""
    last = {prediction.query_id: prediction for prediction in predictions}
    asked = (query.id for split in splits_of(last) for query in dataset.split(split).queries())
    place = {query_id: i for i, query_id in enumerate(asked)}
    return sorted(last.values(), key=lambda prediction: place.get(prediction.query_id, len(place)))


def splits_of(query_ids: Iterable[str]) -> tuple[str, ...]:
    """The splits that ask queries, in their order; of the test split all that it asks."""
    kinds = {query_id.partition("-")[0] for query_id in query_ids}
    return tuple("test-all" if kind == "test" else kind for kind in (*SPLITS, CURVES) if kind in kinds)


def _manifest(asked: Asked, method: Method, dataset: Dataset, tracks: set[str]) -> Manifest:
    return Manifest(
        method=asked.name,
        authors=AUTHORS,
        description=method.description,
        date=date.today().isoformat(),
        dataset_id=dataset.id,
        dataset_checksum=dataset.summary["checksum"],
        tracks=_in_their_order(tracks),
        predicts=method.predicts,
        learned=method.learned,
        uses_true_geometry=method.uses_true_geometry,
        control=method.control,
        training_data=method.training_data,
    )


def _joined(earlier: Manifest, new: Manifest) -> Manifest:
    """The manifest of answers that were added: what people write into one by hand stays."""
    commands = dict.fromkeys([*earlier.reproduce.split(" && "), new.reproduce])
    reproduce = " && ".join(filter(None, commands))
    by_hand = {name: getattr(earlier, name) for name in ("authors", "description", "url")}
    return replace(new, tracks=_in_their_order({*earlier.tracks, *new.tracks}), reproduce=reproduce, **by_hand)


def _in_their_order(tracks: set[str]) -> tuple[str, ...]:
    return tuple(track for track in EVERY if track in tracks)


def _command(asked: Asked, dataset: Dataset, out: Path) -> str:
    """What to type for these answers, the folders as they are in a checkout."""
    words = ["python", "-m", "baselines", "predict", asked.name, "--split", *asked.splits]
    words += ["--tracks", *asked.tracks] if asked.tracks else []
    words += ["--seed", str(asked.seed)] if asked.seed else []
    words += ["--limit", str(asked.limit)] if asked.limit is not None else []
    words += ["--data", f"data/{dataset.summary['preset']}", "--out", f"submissions/{out.name}"]
    return shlex.join(words)


def _hardware(workers: int | None) -> str:
    """Processor, how many of them, and how many answers were worked out at once."""
    file = Path("/proc/cpuinfo")
    named = re.search(r"^model name\s*: (.*)$", file.read_text(), re.M) if file.is_file() else None
    model = named[1].strip() if named else platform.processor() or platform.machine()
    return f"{model}, {cores()} cores, {workers or cores()} answers at a time"
