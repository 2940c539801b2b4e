"""The leaderboard pages: their content, that text of manifests is escaped, and that they are deterministic."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from html import unescape
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

from benchmark.entries import read_entries
from benchmark.pages import build
from benchmark.pages.board import TrackTable, percent, read_board, runtime_class, track_tables
from benchmark.protocol import ABLATION, FOUND, NO_MASKS
from benchmark.quantities import POSITION
from benchmark.table1 import PAPER_ROWS
from benchmark.table1 import read_table as table1
from kit1000.errors import InputError
from kit1000.queries.tracks import TRACKS
from kit1000.submission.manifest import write_manifest
from tests.samples.board import GUESS, METHODS, SNAPS, write_board, write_scored
from tests.samples.mini import file_hashes

VOID = {"meta", "link", "img", "input", "br"}


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Pages of all made-up methods, without a dataset."""
    folder = tmp_path_factory.mktemp("board")
    build(write_board(folder / "submissions"), folder / "site")
    return folder / "site"


def page(site: Path, name: str = "index") -> str:
    return (site / (f"methods/{name}.html" if name in METHODS else f"{name}.html")).read_text("utf-8")


class Outline(HTMLParser):
    """The tags of a page: their attributes, and whether every one is closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def all_pages(site: Path) -> dict[Path, Outline]:
    return {path: Outline(path.read_text("utf-8")) for path in sorted(site.rglob("*.html"))}


def test_there_is_a_page_for_each_method_and_every_tag_is_closed(site: Path) -> None:
    pages = all_pages(site)
    assert {path.relative_to(site).as_posix() for path in pages} == {
        "index.html",
        "table1.html",
        *(f"methods/{n}.html" for n in METHODS),
    }
    assert not [path for path, outline in pages.items() if outline.open]


def test_links_lead_to_files_and_anchors_of_the_site_and_nothing_external_is_loaded(site: Path) -> None:
    pages = all_pages(site)
    for path, outline in pages.items():
        ids = [attrs["id"] for _, attrs in outline.tags if "id" in attrs]
        assert len(ids) == len(set(ids))
        for tag, attrs in outline.tags:
            target = attrs.get("href") or attrs.get("src")
            if target is None or target == "data:,":
                continue
            if re.match(r"[a-z]+:", target):
                assert (tag, target) == ("a", SNAPS.url)
                continue
            file, _, anchor = target.partition("#")
            assert (path.parent / file).exists()
            assert not anchor or file or anchor in ids
    assert not re.search(r"@import|url\(", (site / "style.css").read_text("utf-8"))


def test_the_text_of_a_manifest_is_never_markup(site: Path) -> None:
    for outline in all_pages(site).values():
        assert [attrs.get("src") for tag, attrs in outline.tags if tag == "script"] in (["board.js"], ["../board.js"])
        assert not [attrs for tag, attrs in outline.tags if tag == "b"]
        assert not [name for _, attrs in outline.tags for name in attrs if name.startswith("on")]
    assert "Snaps &lt;b&gt;well&lt;/b&gt; &amp; often" in page(site)
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in page(site, "snaps")


def test_every_page_names_protocol_metrics_dataset_evaluator_and_licence(site: Path) -> None:
    for path in all_pages(site):
        text = path.read_text("utf-8")
        for name in (
            "kit1000-2026",
            "frozen",
            "mssd@v1",
            "0123456789abcdef",
            "fedcba9876543210",
            "2026-0",
            "CC-BY-4.0",
        ):
            assert name in text, (path.name, name)


def test_every_page_says_whether_its_scores_are_rescored(site: Path, tmp_path: Path) -> None:
    build(site.parent / "submissions", tmp_path, rescored=True)
    for path in all_pages(site):
        submitted, rescored = path.read_text("utf-8"), (tmp_path / path.relative_to(site)).read_text("utf-8")
        assert "<dt>Scores</dt><dd>scores as submitted</dd>" in submitted
        assert rescored == submitted.replace("scores as submitted", "rescored with this dataset")


def test_the_board_shows_what_scores_json_holds(site: Path) -> None:
    scores = json.loads((site.parent / "submissions/snaps/scores.json").read_text("utf-8"))
    text = page(site)
    for track in TRACKS:
        mean = scores["tracks"][track]["position_mm"]["mean"]
        assert f'data-value="{mean}"><span>{mean:.2f}</span>' in text
    assert text.count("methods/snaps.html") == len(TRACKS)
    assert text.count("methods/oracle.html") == 2  # its tracks


def test_the_page_of_a_method_has_all_its_parts(site: Path) -> None:
    text = page(site, "snaps")
    assert SNAPS.reproduce in text
    for title in ("Robustness", "Position errors", "MSSD by confidence", "Kits in the assembly", "Largest errors"):
        assert title in text
    rotations = page(site, "rotations")
    assert "rotation only" in rotations
    assert "Rotation errors" in rotations
    assert "Position errors" not in rotations
    assert "Robustness" not in page(site, "oracle")  # without curves


def test_the_same_scores_give_the_same_bytes(site: Path, tmp_path: Path) -> None:
    build(site.parent / "submissions", tmp_path)
    assert file_hashes(tmp_path) == file_hashes(site)
    build(site.parent / "submissions", tmp_path)  # over itself
    assert file_hashes(tmp_path) == file_hashes(site)


def test_table1_has_the_rows_of_the_paper_and_the_methods_on_its_tracks(site: Path) -> None:
    rows = re.findall(r'<tr( class="control")?><th scope="row">(.*?)</th>', page(site, "table1"))
    controls = {unescape(label) for control, label in rows if control}
    assert [unescape(label) for _, label in rows][len(PAPER_ROWS) :] == [
        *("Learned", "Rotations only", SNAPS.method),
        GUESS.method,
    ]
    assert controls == {GUESS.method}


def test_a_single_control_makes_a_board(tmp_path: Path) -> None:
    write_board(tmp_path / "s", ("guess",))
    (tmp_path / "s/empty").mkdir()
    shutil.copy(tmp_path / "s/guess/manifest.toml", tmp_path / "s/empty")
    build(tmp_path / "s", tmp_path / "site")
    text = page(tmp_path / "site")
    assert "No method has been scored on this track yet" in text
    assert "Not scored yet: empty" in text
    assert 'id="robustness"' not in text  # controls are no methods


def edited(folder: Path, **changes: Any) -> None:
    path = folder / "scores.json"
    path.write_text(json.dumps(json.loads(path.read_text("utf-8")) | changes), encoding="utf-8")


def test_masks_that_no_camera_gives_and_known_shapes_have_tables_of_their_own(tmp_path: Path) -> None:
    """On noisy depth alone; a better figure by given masks is never above one by found masks."""
    write_board(tmp_path, ("guess", "snaps"))
    for name, kind in (("found", {"masks": "predicted"}), ("shapes", {"reads": "shapes"})):
        write_scored(tmp_path / name, replace(SNAPS, method=name, **kind), 9.0, 9.0, 1.0)
    tables = {table.name: table for table in track_tables(read_board(tmp_path))}
    assert groups(tables["snap"]) == {"": ["snaps", "found", "guess"], "Known shapes": ["shapes"]}
    assert groups(tables["snap-d415"]) == {
        "Masks found in the image": ["found"],
        "Masks given: an ablation": ["snaps"],
        "Known shapes, masks given: an ablation": ["shapes"],
    }
    entries = {entry.name: entry for entry in read_entries(tmp_path)}
    assert {name: entry.masks("snap-photoneo") for name, entry in entries.items()} == {
        "found": FOUND,
        "guess": NO_MASKS,
        "shapes": ABLATION,
        "snaps": ABLATION,
    }
    assert not any(entry.masks("snap") for entry in entries.values())
    build(tmp_path, tmp_path / "site")
    robustness = page(tmp_path / "site").partition('id="robustness"')[2]
    assert "found" in robustness
    assert "shapes" not in robustness


def groups(table: TrackTable) -> dict[str, list[str]]:
    """Names of the methods of a track by the title of their table."""
    return {group.title: [row.entry.name for row in group.rows] for group in table.groups}


def test_scores_that_cannot_be_compared_share_no_board(tmp_path: Path) -> None:
    write_board(tmp_path, ("snaps", "guess"))
    edited(tmp_path / "snaps", evaluator="0" * 16)
    build(tmp_path, tmp_path / "site")
    assert "2 versions of the evaluator" in page(tmp_path / "site")
    edited(tmp_path / "snaps", dataset_id="another")
    with pytest.raises(InputError, match=r"snaps: .*dataset_id another.*guess 0123"):
        build(tmp_path, tmp_path / "site")


def tampered(folder: Path) -> None:
    path = folder / "predictions.csv"
    path.write_bytes(path.read_bytes().replace(b"0.5", b"0.6"))


CHANGED = replace(SNAPS, uses_true_geometry=True, label="Other")
CHANGES: dict[str, tuple[Callable[[Path], Any], str]] = {
    "scores": (
        lambda folder: edited(folder, predictions_sha256="0" * 64),
        r"predictions\.csv has SHA-256 [0-9a-f]{16}, the scored one had 0{16}",
    ),
    "predictions": (tampered, r"predictions\.csv has SHA-256 [^;]*"),
    "manifest": (
        lambda folder: write_manifest(folder / "manifest.toml", CHANGED),
        r"manifest\.toml has another label, uses_true_geometry",
    ),
    "copied scores": (
        lambda folder: shutil.copy(folder.parent / "guess/scores.json", folder),
        r"manifest\.toml has another control, method, tracks",
    ),
    "renamed": (lambda folder: edited(folder, method="Another name"), r"manifest\.toml has another method"),
    "no manifest": (lambda folder: edited(folder, manifest=None), "its manifest is no table"),
}


@pytest.mark.parametrize("case", CHANGES)
def test_scores_of_other_files_are_refused_by_name(case: str, tmp_path: Path) -> None:
    write_board(tmp_path, ("snaps", "guess"))
    change, expected = CHANGES[case]
    change(tmp_path / "snaps")
    message = (
        rf"snaps: scores\.json was made of other files: {expected}; `python -m benchmark score .*snaps --data DIR`"
    )
    for command in (lambda: build(tmp_path, tmp_path / "site"), lambda: table1(tmp_path)):
        with pytest.raises(InputError, match=message) as refused:
            command()
        assert "\n" not in str(refused.value)


def test_scores_without_their_predictions_are_refused(tmp_path: Path) -> None:
    write_board(tmp_path, ("snaps",))
    (tmp_path / "snaps/predictions.csv").unlink()
    with pytest.raises(InputError, match=r"snaps/predictions\.csv: does not exist"):
        build(tmp_path, tmp_path / "site")
    os.mkfifo(tmp_path / "snaps/predictions.csv")  # never opened: reading it would wait for ever
    with pytest.raises(InputError, match=r"snaps/predictions\.csv: is not a regular file"):
        table1(tmp_path)


def test_folders_without_scores_are_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no folder of submissions"):
        build(tmp_path / "nowhere", tmp_path / "site")
    with pytest.raises(InputError, match="no scored submission"):
        build(tmp_path, tmp_path / "site")
    write_scored(tmp_path / "guess", GUESS, 27.0, 13.8, None)
    (tmp_path / "guess/scores.json").write_text('{"method": "x"}', encoding="utf-8")
    with pytest.raises(InputError, match=r"scores\.json: expected scores of .* there is no protocol, "):
        build(tmp_path, tmp_path / "site")


def test_numbers_are_written_with_the_decimals_of_their_column() -> None:
    assert [POSITION.text(value) for value in (0.0, -1e-12, 3.875, 181.3)] == ["0.00", "0.00", "3.88", "181.30"]
    assert [percent(share) for share in (0.0, 0.995, 1.0)] == ["0 %", "99.5 %", "100 %"]
    assert [runtime_class(seconds) for seconds in (None, 1.0, 1.1, 10.0, 60.0)] == [
        "unknown",
        "fast",
        "medium",
        "medium",
        "slow",
    ]


def test_real_scenes_are_tracks_of_their_own(tmp_path: Path) -> None:
    """Empty until somebody sends scenes; then of another dataset than the rest of the board."""
    folder = write_board(tmp_path / "submissions", ("guess", "learned"))
    build(folder, tmp_path / "empty")
    empty = page(tmp_path / "empty")
    assert 'id="track-real"' in empty
    assert "None was sent yet" in empty
    shutil.copytree(folder / "learned", folder / "real/learned")
    scores = json.loads((folder / "real/learned/scores.json").read_text("utf-8"))
    (folder / "real/learned/scores.json").write_text(json.dumps(scores | {"dataset_id": "ea1dea1dea1dea1d"}))
    build(folder, tmp_path / "site")
    index = page(tmp_path / "site")
    tracks = re.findall(r'id="track-(real[^"]*)"', index)
    assert tracks == [f"real-{track}" for track in TRACKS if track in scores["tracks"]]
    assert "methods/real-learned.html" in index
    own = (tmp_path / "site/methods/real-learned.html").read_text("utf-8")
    assert "ea1dea1dea1dea1d" in own
    assert "ea1dea1dea1dea1d" not in page(tmp_path / "site", "learned")
