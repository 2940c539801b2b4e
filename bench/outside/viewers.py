"""Does a viewer that we did not write show our recordings? Opens some of a dataset in Rerun: `make viewers`.

Each recording must pass Rerun's own check, be converted with all its topics, and open without an error line. The
screenshots are for a person to look at: without a click, each has to show a scene. The exit status is 1 when a check
fails.
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

from mcap.reader import make_reader

from bench.outside.foreign import Report, dataset_of, kit1000, run, tail
from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.submission import Predictions, write_predictions
from kit1000.values import Prediction

SIZE = (1280, 800)  # [points] of the window, whose screenshots have twice as many pixels
SCREEN = (6000, 4000)  # [px]: the pointer stands in its middle, beside the window
COLOURED = re.compile(r"\x1b\[[0-9;]*m")
BAD = re.compile(r"\b(ERROR|PANIC|panicked)\b")
ROW = re.compile(r"^(\w+) +\d+ +\d+ +(/\S+) +(.*)$", re.MULTILINE)  # of a check: status, id, chunks, topic, issues


def topics(path: Path) -> set[str]:
    """The topics of a recording, as the library of MCAP reads it."""
    with open(path, "rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    return {channel.topic for channel in summary.channels.values()}


def check_fault(rerun: Path, path: Path, environment: dict[str, str]) -> str | None:
    """What `rerun mcap check` objects to, or None."""
    status, text = run([rerun, "mcap", "check", path, "--full"], environment)
    rows = ROW.findall(COLOURED.sub("", text))
    if status or not rows:
        return f"exit status {status}: {tail(text)}"
    bad = [f"{topic}: {issues}" for state, topic, issues in rows if state != "ok"]
    missing = topics(path) - {topic for _, topic, _ in rows}
    return "; ".join([*bad, *(f"{topic} is not listed" for topic in sorted(missing))]) or None


def convert_fault(rerun: Path, path: Path, out: Path, environment: dict[str, str]) -> str | None:
    """What goes wrong when Rerun converts a recording to its own format, or None."""
    command = [rerun, "mcap", "convert", path, "--output", out, "--application-id", "kit1000"]
    status, text = run(command, environment)
    text = COLOURED.sub("", text)
    if status:
        return f"exit status {status}: {tail(text)}"
    missing = sorted(topic for topic in topics(path) if not re.search(rf"^ *{topic},$", text, re.MULTILINE))
    bad = [line for line in text.splitlines() if BAD.search(line) or " WARN " in line]
    return "; ".join([*bad, *(f"{topic} is not converted" for topic in missing)]) or None


def screenshot_fault(rerun: Path, path: Path, picture: Path, environment: dict[str, str]) -> str | None:
    """The first error line of the viewer, or None; its window is saved as a picture."""
    picture.unlink(missing_ok=True)
    window, area = (f"{width}x{height}" for width, height in (SIZE, SCREEN))
    screen = ["xvfb-run", "--auto-servernum", "--server-args", f"-screen 0 {area}x24"]
    viewer = [rerun, path, "--screenshot-to", picture, "--window-size", window, "--port", "auto"]
    status, text = run([*screen, *viewer], environment)
    bad = [line for line in COLOURED.sub("", text).splitlines() if BAD.search(line)]
    if bad or status:
        return bad[0] if bad else f"exit status {status}: {tail(text)}"
    return None if picture.is_file() else f"no screenshot: {tail(text)}"


def guesses(scene: RecordedScene, path: Path) -> tuple[Path, str]:
    """Predictions that leave the guesses of a track as they are, and the track."""
    guessed = [(query, query.guess) for query in scene.queries if query.guess is not None]
    track = guessed[0][0].track
    rows = [Prediction(query.id, guess, 1.0, 0.0) for query, guess in guessed if query.track == track]
    write_predictions(path, Predictions.of(rows))
    return path, track


def recordings(dataset: Dataset, out: Path) -> tuple[list[Path], list[Path]]:
    """Recordings of the first test shard, those made for looking included; and those to take a screenshot of."""
    shard = next(iter(dataset.shards("test").values()))
    recorded = sorted(dataset.root.glob(f"{shard}*.mcap"))
    scenes = iter(dataset.split("test-all", truth=True))
    scene = next(scene for scene in scenes if any(query.guess is not None for query in scene.queries))
    predictions, track = guesses(scene, out / "guesses.csv")
    export = ("export", dataset.root, "--format", "mcap", "--ids", scene.id, "--track", track, "--out")
    kit1000(*export, out / "seen")
    kit1000(*export, out / "answers", "--truth", "--predictions", predictions)
    seen, answers = (out / folder / f"{scene.id}.mcap" for folder in ("seen", "answers"))
    return [*recorded, seen, answers], [dataset.root / f"{shard}.mcap", seen, answers]


def main() -> int:
    """Check the recordings of a dataset; returns 1 when a check fails."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rerun", type=Path, help="the program")
    parser.add_argument("--out", type=Path, required=True, help="folder of screenshots and converted recordings")
    parser.add_argument("--data", type=Path, help="a dataset; else a tiny one is generated in --out")
    options = parser.parse_args()
    out, rerun, report = options.out.absolute(), options.rerun.absolute(), Report()
    home = out / "home"  # Rerun keeps its settings there
    home.mkdir(parents=True, exist_ok=True)
    environment = {"HOME": str(home), "XDG_RUNTIME_DIR": str(home), "RUST_LOG": "info"}
    run([rerun, "analytics", "disable"], environment)
    all_of_them, pictured = recordings(Dataset(dataset_of(options.data, out)), out)
    for path in all_of_them:
        report.line(f"{path.name}: rerun mcap check", check_fault(rerun, path, environment))
        report.line(f"{path.name}: rerun mcap convert", convert_fault(rerun, path, out / "converted.rrd", environment))
    for path in pictured:
        picture = out / f"{path.parent.name}-{path.stem}.png"
        report.line(f"{path.name}: look at {picture}", screenshot_fault(rerun, path, picture, environment))
    return 1 if report.failed else 0


if __name__ == "__main__":
    sys.exit(main())
