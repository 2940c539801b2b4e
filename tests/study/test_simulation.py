"""A study carried out by simulated operators on a small dataset, by the command."""

from __future__ import annotations

from pathlib import Path

import pytest

from kit1000.cli import main
from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.predictor import PredictedMotion
from kit1000.study.plan import StudyPlan, read_plan, write_plan
from kit1000.study.records import read_participants
from kit1000.study.tasks import SIZES, Task, Tasks
from kit1000.values import Query, TrueGeometry
from tests.samples.studies import PAPER


def near(query: Query, geometry: TrueGeometry | None) -> PredictedMotion:
    """A method that finds nothing better than the guess."""
    assert query.guess is not None
    return PredictedMotion(query.guess, 0.5)


@pytest.fixture(scope="module")
def plan(mini: Path) -> StudyPlan:
    """Four people; the tasks are scenes of a small dataset, of any size."""

    def is_editable(scene: RecordedScene, size: int) -> bool:
        return {query.part for query in scene.queries if query.track == "snap"} == set(range(size))

    split = Dataset(mini).split("test-all", truth=True)
    sizes = {scene.id: len(scene.scene.bodies) - 1 for scene in split}
    tasks = [Task(i, size) for i, size in sizes.items() if is_editable(split.scene(i), size)]
    some = tuple(tasks[k % len(tasks)] for k in range(len(SIZES)))
    sets = Tasks(tasks[0], (some, some))
    return StudyPlan(Dataset(mini).id, "ideal", f"{__name__}:near", ("scene-snap", "hand"), 4, 3, sets)


def files_of(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.mark.parametrize("name", ["exact", "paper"])
def test_a_simulated_study_is_whole_and_repeats_to_the_last_byte(
    mini: Path, plan: StudyPlan, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    """Finished trials stay; removed ones return with the same bytes."""
    write_plan(tmp_path, plan)
    arguments = ["study", str(mini), "--out", str(tmp_path), "--simulate", name]
    assert main([*arguments, "--report"]) == 0
    folder = tmp_path / f"simulated/{name}"
    assert capsys.readouterr().out.splitlines() == [str(folder), str(folder / "report.md")]
    whole, trials = files_of(tmp_path), sorted(folder.rglob("trial.json"))
    stamp = trials[0].stat().st_mtime_ns
    for path in trials[2::3]:
        path.unlink()
    assert main(arguments) == 0
    assert files_of(tmp_path) == whole
    assert trials[0].stat().st_mtime_ns == stamp
    people = read_participants(tmp_path, read_plan(tmp_path), f"simulated/{name}")
    assert [len(person.trials) for person in people] == [8] * 4
    assert not any(person.ratings for person in people)
    for trial in (trial for person in people for trial in person.trials):
        uploaded = [part for part in trial.parts if part.outcome != "not uploaded"]
        assert trial.out_of_time == (len(uploaded) < trial.kits)
        assert trial.execution_s == 23 * len(uploaded)
        assert trial.uploads == (len(uploaded) if trial.condition == "hand" else 1)
        assert trial.specification_s <= 60 * trial.kits
        assert all(part.outcome == "seated" for part in uploaded) or name == "paper"
        errors = [part.position_mm for part in uploaded if part.position_mm is not None]
        assert max(errors) < (0.01 if name == "exact" else 28 * 3**0.5)


@pytest.mark.parametrize(
    "option", ["--people 8", "--conditions scene hand", "--sensor d415", "--snap none", "--seed 0"], ids=str.split
)
def test_an_option_that_contradicts_the_plan_is_refused(
    mini: Path, plan: StudyPlan, tmp_path: Path, option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    write_plan(tmp_path, plan)
    assert main(["study", str(mini), "--out", str(tmp_path), *option.split()]) == 2
    error = capsys.readouterr().err
    assert option in error
    assert str(tmp_path) in error


@pytest.mark.parametrize(
    ("options", "fact"),
    [
        (["--simulate", "papper"], "did you mean paper"),
        (["--participant", "1", "--report"], "--participant"),
        (["--participant", "1", "--simulate", "paper"], "--participant"),
    ],
)
def test_what_cannot_be_combined_is_refused(
    mini: Path, tmp_path: Path, options: list[str], fact: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["study", str(mini), "--out", str(tmp_path), *options]) == 2
    assert fact in capsys.readouterr().err
    assert PAPER not in files_of(tmp_path)
