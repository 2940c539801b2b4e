"""The command `python -m baselines`: lists the reference methods, trains networks, answers the queries of a dataset."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from kit1000.errors import InputError
from kit1000.usage import run

PROGRAM = "python -m baselines"
ABOUT = """The reference methods of KIT1000: each reads a dataset and writes a submission.

`python -m benchmark` scores submissions.

`python -m baselines COMMAND --help` says more about a command.

Results go to stdout, progress to stderr. Exit status: 0 good, 1 the answer is no, 2 wrong usage or bad input,
3 a fault of the method or of kit1000, 130 interrupted."""

Whole = Annotated[int | None, tyro.conf.arg(metavar="N")]


@dataclass(frozen=True)
class List:
    """List the methods: what each does, what it reads, which tracks it answers."""

    def run(self) -> int:
        """Print a table."""
        from baselines.methods import METHODS, described

        print("\n".join(described(name, method) for name, method in METHODS.items()))
        return 0


@dataclass(frozen=True)
class Predict:
    """Answer the queries of a dataset; run the same command again to continue a run that was interrupted."""

    name: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="NAME")]
    """A method of the list, or module:Object of your own."""
    data: Path
    """Dataset folder."""
    out: Path
    """Submission folder; to one of the same method and dataset the answers are added."""
    split: tuple[str, ...] = ("test",)
    """test, curves, val, test-all, train: one or several."""
    tracks: tuple[str, ...] = ()
    """Just these; all that the method answers when absent."""
    workers: Whole = None
    """Processes; one per core when absent. Any number gives the same answers."""
    limit: Whole = None
    """Just the first N queries."""
    seed: int = 0
    """Of all draws of the method."""

    def run(self) -> int:
        """Predict, then say what was written."""
        from baselines.predict import Asked, predict

        for name, value, least in (("workers", self.workers, 1), ("limit", self.limit, 1), ("seed", self.seed, 0)):
            _check_least(name, value, least)
        asked = Asked(self.name, self.split, self.tracks or None, self.seed, self.limit)
        submission = predict(asked, self.data, self.out, self.workers)
        seconds = submission.predictions.seconds.mean()
        tracks = ", ".join(submission.manifest.tracks)
        print(f"{self.out}: {len(submission.predictions)} predictions of {self.name} ({tracks}), {seconds:.3g} s each")
        return 0


@dataclass(frozen=True)
class Rerun:
    """Answer queries of submissions again and say whether the answers are those written there."""

    submissions: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="SUBMISSION...")]
    """Folders that `predict` wrote with seed 0."""
    data: Path
    """Dataset folder."""
    first: Annotated[int, tyro.conf.arg(metavar="N")] = 50
    """How many queries of each, from the first on."""
    workers: Whole = None
    """Processes; one per core when absent."""

    def run(self) -> int:
        """Answer and compare."""
        from baselines.rerun import DEGREES, MILLIMETRES, rerun

        _check_least("first", self.first, 1)
        _check_least("workers", self.workers, 1)
        good = True
        for folder in self.submissions:
            found = rerun(folder, self.data, self.first, self.workers)
            most = f"at most {found.position_mm.max():.2g} mm and {found.rotation_deg.max():.2g}° from those there"
            others = [query_id for query_id, same in zip(found.query_ids, found.same, strict=True) if not same]
            told = f"; {len(others)} beyond {MILLIMETRES:g} mm or {DEGREES:g}°, the first {others[0]}" if others else ""
            print(f"{folder}: {len(found.query_ids)} answers, {most}{told}", flush=True)
            good &= not others
        return 0 if good else 1


@dataclass(frozen=True)
class Train:
    """Train a network; run the same command again to go on after a stop, a crash or a kill."""

    name: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="NAME")]
    """Such as snapnet-gtvol-position; a wrong name lists them all."""
    data: Path
    """Dataset folder, with its truth."""
    out: Path
    """Folder of this run: checkpoint, log, best weights."""
    preset: Literal["small", "paper"] = "small"
    """small for two cores of a CPU, paper in the sizes of the paper for a GPU."""
    steps: Whole = None
    """Of training; the preset's own when absent, like the next two."""
    batch: Whole = None
    """Examples of a step."""
    seed: Whole = None
    """Of first weights and all draws."""
    workers: Whole = None
    """Processes that make examples."""
    threads: Whole = None
    """Of PyTorch."""
    time_limit_s: Annotated[float | None, tyro.conf.arg(metavar="S")] = None
    """Stop after this long, with a checkpoint."""

    def run(self) -> int:
        """Train, then say how it ended."""
        from baselines.networks import train_network

        fields = ("steps", "batch", "seed", "workers", "threads", "time_limit_s")
        changes = {name: value for name in fields if (value := getattr(self, name)) is not None}
        trained = train_network(self.name, self.data, self.out, self.preset, changes)
        best = ", ".join(f"{name} median {values['median']:.3g}" for name, values in trained.measures.items())
        ended = f"step {trained.step} ({trained.why}), {trained.seconds:.0f} s"
        print(f"{self.out}: {ended}; best so far: {best or 'none'}")
        return 0


@dataclass(frozen=True)
class Ship:
    """Put the best weights of a run where the methods look for them."""

    run_folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RUN")]
    """Folder that `train` wrote."""
    commit: str
    """Of the code that trained them: `git rev-parse HEAD`."""

    def run(self) -> int:
        """Copy, then say where."""
        from baselines.methods import WEIGHTS
        from baselines.ship import ship

        print(ship(self.run_folder, WEIGHTS, self.commit))
        return 0


def _check_least(name: str, value: int | None, least: int) -> None:
    if value is not None and value < least:
        raise InputError(f"--{name}: expected {least} or more, got {value}")


COMMANDS = {"list": List, "predict": Predict, "rerun": Rerun, "train": Train, "ship": Ship}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    return run(PROGRAM, COMMANDS, ABOUT, arguments)


if __name__ == "__main__":
    sys.exit(main())
