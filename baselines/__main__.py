"""The command `python -m baselines`: lists the reference methods, runs them on a dataset, trains their networks."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from kit1000.cli.command_line import check_least, run
from kit1000.cli.options import OptionalFloat, OptionalInt
from kit1000.cli.scenes import Predict as LibraryPredict
from kit1000.perception.networks.precision import Precision

PROGRAM = "python -m baselines"
ABOUT = """The reference methods of KIT1000: each reads a dataset and writes a submission.

`python -m benchmark` scores submissions.

`python -m baselines COMMAND --help` explains a command.

Results go to stdout, progress to stderr. Exit status: 0 good, 1 the check found differences, 2 wrong usage or bad
input, 3 a fault of the method or of kit1000, 130 interrupted."""


@dataclass(frozen=True)
class List:
    """List the methods: what each does, what it reads, and the tracks that it does not predict for."""

    def run(self) -> int:
        """Print a line for each method."""
        from baselines.catalog import all_methods
        from kit1000.prediction.making import listed

        print("\n".join(listed(name, method) for name, method in all_methods().items()))
        return 0


@dataclass(frozen=True)
class Predict(LibraryPredict):
    """Run a method on the queries of a dataset; the same command again resumes an interrupted run."""

    def run(self) -> int:
        """Predict by a method of the list or of the user."""
        from baselines.catalog import METHOD_TABLES

        return self.run_from(METHOD_TABLES)


@dataclass(frozen=True)
class Rerun:
    """Predict queries of submissions again and compare with the predictions in them."""

    submissions: Annotated[Positional[tuple[Path, ...]], arg(metavar="SUBMISSION...")]
    """Folders that `predict` wrote with seed 0."""
    data: Path
    """Dataset folder."""
    first: int = 50
    """Number of queries of each submission, from the first on."""
    workers: OptionalInt = None
    """Number of processes. Default: one per core."""

    def run(self) -> int:
        """Predict and compare; 1 where a prediction differs."""
        from baselines.rerun import rerun

        check_least(first=(self.first, 1), workers=(self.workers, 1))
        good = True
        for folder in self.submissions:
            again = rerun(folder, self.data, self.first, self.workers)
            print(f"{folder}: {again.summary()}", flush=True)
            good &= bool(again.same.all())
        return 0 if good else 1


@dataclass(frozen=True)
class Train:
    """Train a network; the same command again resumes after a stop, a crash or a kill."""

    name: Annotated[Positional[str], arg(metavar="NAME")]
    """Name of the network, such as snapnet-gtvol-position; a wrong name lists them all."""
    data: Path
    """Dataset folder, with its ground truth."""
    out: Path
    """Folder of this run: checkpoint, log, best weights."""
    preset: str = "small"
    """Sizes and training: small for two cores, paper for a GPU; pretraining, then pretraining-2, to start from."""
    steps: OptionalInt = None
    """Number of training steps. Default: that of the preset."""
    batch: OptionalInt = None
    """Number of examples of a step. Default: that of the preset."""
    seed: OptionalInt = None
    """Seed of the initial weights and all draws. Default: that of the preset."""
    learning_rate: OptionalFloat = None
    """Learning rate at its peak. Default: that of the preset."""
    start: Path | None = None
    """Weights to start from, a .safetensors file of the same network. Default: new ones."""
    workers: OptionalInt = None
    """Number of processes that make examples. Default: that of the preset."""
    threads: OptionalInt = None
    """Number of PyTorch threads. Default: that of the preset, or one per core."""
    time_limit_s: OptionalFloat = None
    """Time [s] after which training stops, with a checkpoint. Default: no limit."""

    def run(self) -> int:
        """Train, then print how it ended."""
        from baselines.train import train_network

        fields = ("steps", "batch", "seed", "learning_rate", "workers", "threads", "time_limit_s")
        changes = {name: value for name in fields if (value := getattr(self, name)) is not None}
        result = train_network(self.name, self.data, self.out, self.preset, changes, self.start)
        best = ", ".join(f"{name} median {values['median']:.3g}" for name, values in result.measures.items())
        print(f"{self.out}: step {result.step} ({result.stopped_by}), {result.seconds:.0f} s; best: {best or 'none'}")
        return 0


@dataclass(frozen=True)
class Ship:
    """For maintainers: replace the published weights of a network by the best ones of a run.

    `predict --weights RUN` uses weights of your own and replaces nothing."""

    run_folder: Annotated[Positional[Path], arg(metavar="RUN")]
    """Folder that `train` wrote."""
    commit: str
    """Commit of the code that trained the weights: `git rev-parse HEAD`."""
    precision: Precision = "float32"
    """Number type of the stored weights: float16 is half as large, rounded by up to 1 in 2048; int8 a quarter, rounded
    to 127ths of the largest number of each row."""

    def run(self) -> int:
        """Copy, then print where to."""
        from baselines.catalog import weights_folder
        from baselines.training.shipping import ship

        print(ship(self.run_folder, weights_folder, self.commit, self.precision))
        return 0


COMMANDS = {"list": List, "predict": Predict, "rerun": Rerun, "train": Train, "ship": Ship}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    return run(PROGRAM, COMMANDS, ABOUT, arguments)


if __name__ == "__main__":
    sys.exit(main())
