"""Pictures of single queries: the part at its predicted pose over the depth image, the goal outlined."""

from __future__ import annotations

from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmark.entries import read_entries
from benchmark.pages import build
from benchmark.pages.cases import MAX_BYTES, SIZE, Case, case_picture, jpeg, pictures
from benchmark.report import json_text
from benchmark.score import score
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.submission import write_submission
from kit1000.values import Prediction
from tests.samples.board import GUESS
from tests.samples.mini import file_hashes

TRACK = "snap"


@pytest.fixture(scope="module")
def scored(mini: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Submissions on the small dataset: one, the unchanged guess."""
    dataset, folder = Dataset(mini), tmp_path_factory.mktemp("submissions")
    queries = dataset.split("test").queries(TRACK)
    guesses = [Prediction(query.id, query.guess, 0.5, 0.1) for query in queries if query.guess is not None]
    manifest = replace(GUESS, dataset_id=dataset.id, tracks=(TRACK,))
    submission = write_submission(folder / "guess", manifest, guesses)
    text = json_text(score(submission, dataset, exact="never").summary)
    (folder / "guess/scores.json").write_text(text, encoding="utf-8")
    return folder


def case_at_goal(mini: Path) -> Case:
    """A query with a prediction at its goal."""
    split = Dataset(mini).split("test", truth=True)
    recorded = next(iter(split))
    query = next(query for query in recorded.queries if query.track == TRACK)
    truth = recorded.truth_of(query.id)
    return Case(recorded, query, truth, truth.goal_drawn, truth.goal_drawn)


def whites(picture: Image.Image) -> np.ndarray:
    """(H, W) bool: the outline of the goal."""
    return np.asarray(picture).min(axis=-1) > 225


def oranges(picture: Image.Image) -> np.ndarray:
    """(H, W) bool: the part as predicted."""
    red, green, blue = np.moveaxis(np.asarray(picture).astype(int), -1, 0)
    return (red > 1.35 * green) & (green > 1.2 * blue)


def test_a_part_at_its_goal_fills_the_outline_and_one_elsewhere_leaves_it(mini: Path) -> None:
    right = case_at_goal(mini)
    aside = right._replace(predicted=Pose.from_translation((0.0, 0.0, 0.06)) @ right.goal)
    at_goal, away = case_picture(right), case_picture(aside)
    assert at_goal.size == away.size == SIZE
    v, u = np.nonzero(whites(at_goal))
    inside = np.zeros(SIZE[::-1], bool)
    inside[v.min() : v.max() + 1, u.min() : u.max() + 1] = True
    assert oranges(at_goal).sum() > 200
    assert not (oranges(at_goal) & ~inside).any()
    middle = [np.nonzero(found)[0].mean() for found in (oranges(away), whites(away))]
    assert middle[0] < middle[1]  # lifted: higher up in the picture


def test_the_pages_show_every_listed_case_small_and_the_same_each_time(
    mini: Path, scored: Path, tmp_path: Path
) -> None:
    for name in ("once", "again"):
        build(scored, tmp_path / name, mini)
    assert file_hashes(tmp_path / "once") == file_hashes(tmp_path / "again")
    text = (tmp_path / "once/methods/guess.html").read_text("utf-8")
    (entry,) = read_entries(scored)
    listed = {case["query_id"] for case in entry.scores["tracks"][TRACK]["worst"]}
    assert listed
    for query_id in listed:
        data = (tmp_path / f"once/methods/guess/{query_id}.jpg").read_bytes()
        assert len(data) <= MAX_BYTES
        assert Image.open(BytesIO(data)).size == SIZE
        assert f'src="guess/{query_id}.jpg"' in text


def test_even_noise_becomes_a_small_picture() -> None:
    noise = stream(1, "noise").integers(0, 255, (*SIZE[::-1], 3)).astype(np.uint8)
    small = Image.fromarray(noise).resize((200, 150)).resize(SIZE)
    assert len(jpeg(small)) <= MAX_BYTES


def test_another_dataset_and_unknown_queries_are_refused_in_one_line(mini: Path, scored: Path) -> None:
    (entry,) = read_entries(scored)
    other = replace(entry, scores={**entry.scores, "dataset_id": "another"})
    with pytest.raises(InputError, match="scores of guess are on another"):
        pictures(Dataset(mini), other, [])
    known = entry.scores["tracks"][TRACK]["worst"][0]["query_id"]
    with pytest.raises(InputError, match="which is no query of"):
        pictures(Dataset(mini), entry, [known.replace("-p", "-p9")])
