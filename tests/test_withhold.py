"""Laws of withholding: no byte of the open folder tells the seed, or a pose or a mesh of the test split.

A guess in a query is the truth plus a drawn error, so it is public: what is looked for are the true poses.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mini import MINI, contents, corners

from kit1000.cli import main
from kit1000.dataset.geometry import Geometry
from kit1000.dataset.mesh_files import y_up
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.files import json_bytes, read_json
from kit1000.generation import build, withhold
from kit1000.generation.build import generate
from kit1000.generation.plan import dataset_id
from kit1000.generation.presets import PRESETS, Preset
from kit1000.generation.verify import verify

HIDDEN = Preset("hidden", 1, 1, 1, kits=(1, 1))
RUN = 12  # vertices in a row: more than the corners that all plates have
SEED = 0xC0FFEE_5EED_0BAD_F00D_1234_5678_9ABC  # the same parts whenever the tests are run
KEY = 8  # bytes that a search looks for at first


@dataclass(frozen=True)
class Pair:
    """The whole dataset and its open part."""

    whole: Path
    shown: Path


def published(folder: Path, *options: str) -> Pair:
    """A dataset withheld by the command, as people do it."""
    asked = ["generate", "hidden", "--out", f"{folder}/open", "--withhold", f"{folder}/whole", "--workers", "1"]
    assert main([*asked, *options]) == 0
    return Pair(folder / "whole", folder / "open")


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Pair:
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(PRESETS, "hidden", HIDDEN)
        return published(tmp_path_factory.mktemp("withheld"), "--seed", str(SEED))


@pytest.fixture
def quick(sketches: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[str]:
    """Options that make a dataset in no time, its scenes sketched."""
    monkeypatch.setitem(PRESETS, "hidden", HIDDEN)
    corners(tmp_path / "files", (20, 26, 33))
    return ["--parts", f"{tmp_path}/files"]


def stretches(root: Path) -> Iterator[bytes]:
    """Every byte of a folder, and all that is compressed in its recordings, as the stock reader finds it."""
    for path in root.rglob("*"):
        if path.is_file():
            yield path.read_bytes()
        if path.suffix == ".mcap":
            with path.open("rb") as file:
                reader = make_reader(file)
                yield from (message.data for _, _, message in reader.iter_messages())
                yield from (json.dumps(record.metadata).encode() for record in reader.iter_metadata())


def occurring(root: Path, needles: set[bytes]) -> set[bytes]:
    """Which of some byte strings, KEY bytes or more each, occur in a folder, at whatever place."""
    by_key: dict[int, list[bytes]] = {}
    for needle in needles:
        by_key.setdefault(int.from_bytes(needle[:KEY], "little"), []).append(needle)
    keys = np.array(sorted(by_key), np.uint64)
    starts = np.zeros(1 << 16, bool)
    starts[keys & np.uint64(0xFFFF)] = True
    found = set()
    for data in stretches(root):
        for shift in range(min(KEY, len(data) - KEY + 1)):
            words = np.frombuffer(data, np.uint64, (len(data) - shift) // KEY, shift)
            near = np.flatnonzero(starts[words.view(np.uint16)[::4]])
            for at in near[np.isin(words[near], keys)]:
                place = shift + KEY * int(at)
                found |= {needle for needle in by_key[int(words[at])] if data.startswith(needle, place)}
    return found


def of_numbers(rows: np.ndarray) -> set[bytes]:
    """Rows of numbers as any program might write them."""
    told = {np.ascontiguousarray(row, kind).tobytes() for row in rows for kind in ("<f8", "<f4", ">f8", ">f4")}
    return told | {repr(value).encode() for value in np.ravel(rows).tolist() if len(repr(value)) > 10}


def of_seed(seed: int, identity: str) -> set[bytes]:
    words = [seed, seed % 2**64, seed >> 64]
    sizes = [16, 8, 8]
    binary = {word.to_bytes(n, order) for word, n in zip(words, sizes, strict=True) for order in ("little", "big")}
    return binary | {str(seed).encode(), f"{seed:x}".encode(), f"{seed:X}".encode(), identity.encode()}


def of_poses(whole: Path) -> set[bytes]:
    """True poses of the test split, single ones and with their neighbours."""
    rows: list[Any] = []
    for scene in Dataset(whole).split("test", truth=True):
        truth = scene.truth
        assert truth.goals is not None
        rows += [truth.world_from_assembly.xyz, truth.world_from_assembly.wxyz, *truth.goals.xyz, *truth.goals.wxyz]
        for part in truth.parts:
            rows += [part[key][entry] for key in ("world_from_part", "world_from_kit") for entry in ("xyz", "wxyz")]
        for query in truth.queries.values():
            rows += [query["goal_drawn"]["xyz"], query["goal_drawn"]["wxyz"]]
            rows += [query["draw"]["offset"], query["draw"]["rotvec"]] if query["draw"] else []
    return set().union(*(of_numbers(np.array([row])) for row in rows))


def of_meshes(whole: Path) -> set[bytes]:
    """Runs of vertices of the test split's meshes, as a GLB has them and in their own frame."""
    geometry, needles = Geometry(whole), set()
    kinds = {"parts": geometry.part, "kits": geometry.kit, "assemblies": geometry.assembly}
    for kind, get in kinds.items():
        for item_id in (i for i in getattr(geometry, kind) if i.startswith("test")):
            vertices = get(item_id).mesh.vertices
            for points in (vertices, y_up(vertices)):
                rows = points.astype("<f4")
                needles |= {rows[i : i + RUN].tobytes() for i in range(0, len(rows) - RUN + 1, RUN)}
    return needles


def test_no_byte_of_the_open_folder_tells_the_seed_a_pose_or_a_mesh(pair: Pair) -> None:
    plan, secret = read_json(pair.whole / "plan.json"), read_json(pair.whole / withhold.SECRET_FILE)
    seed = of_seed(plan["seed"], dataset_id(plan)) | {secret["salt"].encode()}
    poses, meshes = of_poses(pair.whole), of_meshes(pair.whole)
    assert not occurring(pair.shown, seed | poses | meshes)
    there = occurring(pair.whole, seed | poses | meshes)  # the search is not blind
    assert str(plan["seed"]).encode() in there
    assert len(there & poses) > 20
    assert len(there & meshes) >= len(meshes) / 2  # those in the order and frame of the files


def test_the_open_folder_has_neither_plan_nor_truth_nor_anything_of_the_test_parts(pair: Pair) -> None:
    names = set(contents(pair.shown))
    assert not [name for name in names if "truth" in name and name.startswith("test")]
    assert not names & {"plan.json", withhold.SECRET_FILE, withhold.BEGUN_FILE}
    assert not [name for name in names if name.startswith(("parts/test", "kits/test", "assemblies/test"))]
    assert {"test/0000.mcap", "test/0000.three.mcap", "train/0000.truth.mcap", "parts/val-0000.glb"} < names
    for name in ("parts.json", "kits.json", "assemblies.json"):
        assert b"test" not in (pair.shown / name).read_bytes()
        assert set(read_json(pair.shown / name)) == {"train-0000", "val-0000"}
    summary = read_json(pair.shown / "dataset.json")
    assert summary["seed"] is None
    assert "test" not in summary["statistics"]
    assert summary["config"]["curve_scenes"] == 0


def test_what_is_shown_is_what_the_whole_has(pair: Pair) -> None:
    shown, whole = contents(pair.shown), contents(pair.whole)
    anew = {"dataset.json", "README.md", "croissant.json", "parts.json", "kits.json", "assemblies.json"}
    assert {name for name in shown if shown[name] != whole.get(name)} == anew


def test_the_commitment_is_that_of_the_withheld_files(pair: Pair) -> None:
    secret, shown = read_json(pair.whole / withhold.SECRET_FILE), read_json(pair.shown / "dataset.json")
    hashes = {name: hashlib.sha256((pair.whole / name).read_bytes()).hexdigest() for name in secret["files"]}
    assert hashes == secret["files"]
    told = hashlib.sha256(secret["salt"].encode() + json_bytes(hashes)).hexdigest()
    assert shown["withheld"] == {"split": "test", "salted_sha256": told}
    assert len(secret["salt"]) == 64
    kept_back = set(contents(pair.whole)) - set(contents(pair.shown)) - {withhold.SECRET_FILE}
    assert set(secret["files"]) == kept_back | {"parts.json", "kits.json", "assemblies.json"}


def test_the_open_folder_is_read_as_far_as_it_goes(pair: Pair) -> None:
    shown, whole = Dataset(pair.shown), Dataset(pair.whole)
    assert shown.id != whole.id
    asked = [query.id for query in shown.split("test").queries()]
    assert asked == [query.id for query in whole.split("test").queries()] != []
    assert next(iter(shown.split("val", truth=True))).truths
    with pytest.raises(InputError, match=r"no file test/0000\.truth\.mcap \(withheld from this folder\)"):
        next(iter(shown.split("test", truth=True))).truth
    with pytest.raises(InputError, match="made without curves; a dataset whose answers are withheld has none"):
        len(shown.split("curves"))


def test_both_folders_pass_and_the_open_one_says_what_it_cannot_show(pair: Pair) -> None:
    found = verify(pair.shown, sample=2)
    assert (found.faults, found.rebuilt) == ((), ())
    assert found.notes == ("the plan is withheld: scenes can be built again from the whole dataset alone",)
    assert verify(pair.whole) == type(found)(found.files + len(set(read_secret(pair)["files"])) - 3, (), ())


def read_secret(pair: Pair) -> dict[str, Any]:
    return read_json(pair.whole / withhold.SECRET_FILE)


def test_the_same_command_again_changes_nothing(quick: list[str], tmp_path: Path) -> None:
    pair = published(tmp_path, *quick)
    before = contents(pair.whole), contents(pair.shown)
    published(tmp_path, *quick)
    assert (contents(pair.whole), contents(pair.shown)) == before


def test_what_either_folder_holds_is_no_source_of_the_next_run(quick: list[str], tmp_path: Path) -> None:
    before = contents(published(tmp_path, "--parts", f"{tmp_path}").shown)
    assert contents(published(tmp_path, "--parts", f"{tmp_path}").shown) == before


def test_two_datasets_have_two_seeds_that_nobody_guesses(quick: list[str], tmp_path: Path) -> None:
    pairs = [published(tmp_path / name, *quick) for name in "ab"]
    seeds = [read_json(pair.whole / "plan.json")["seed"] for pair in pairs]
    assert seeds[0] != seeds[1]
    assert min(seeds) >= 2**64
    assert read_secret(pairs[0])["salt"] != read_secret(pairs[1])["salt"]


class Stop(BaseException):
    """What no code of ours expects."""


@pytest.mark.parametrize("place", ["make_shard", "_copied", "described"])
def test_an_interrupted_run_goes_on_as_the_same_dataset(
    place: str, quick: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopping(*arguments: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls > 2:
            raise Stop
        return known(*arguments)

    calls = 0 if place == "_copied" else 1
    module = build if place == "make_shard" else withhold
    known = getattr(module, place)
    with monkeypatch.context() as patch:
        patch.setattr(module, place, stopping)
        with pytest.raises(Stop):
            published(tmp_path, *quick)
    assert not (tmp_path / "open/dataset.json").exists()
    seed = read_json(tmp_path / "whole/plan.json")["seed"]
    secret = tmp_path / "whole" / withhold.SECRET_FILE
    known_secret = secret.read_bytes() if secret.exists() else None
    pair = published(tmp_path, *quick)
    assert read_json(pair.whole / "plan.json")["seed"] == seed
    assert known_secret in (None, secret.read_bytes())
    assert (known_secret is None) == (place == "make_shard")
    assert verify(pair.shown).faults == verify(pair.whole).faults == ()


def test_a_seed_may_be_brought_along(quick: list[str], tmp_path: Path) -> None:
    pair = published(tmp_path, *quick, "--seed", str(2**64))
    assert read_json(pair.whole / "plan.json")["seed"] == 2**64
    assert not occurring(pair.shown, {str(2**64).encode()})


def test_a_seed_that_can_be_guessed_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"--seed: 7 can be guessed, .*expected at least 2\*\*64, or leave --seed out"):
        withhold.secret_seed(tmp_path, 7)


def test_a_folder_made_from_a_guessable_seed_is_refused(sketches: None, tmp_path: Path) -> None:
    generate(MINI, tmp_path / "whole", workers=1, sources=corners(tmp_path / "files"))
    with pytest.raises(InputError, match="was made from seed 7, which can be guessed; choose another folder"):
        withhold.secret_seed(tmp_path / "whole", None)


@pytest.mark.parametrize("shown", ["whole", "whole/open", ".", "link"])
def test_one_folder_cannot_be_both(shown: str, tmp_path: Path) -> None:
    (tmp_path / "whole").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "whole")
    with pytest.raises(InputError, match="--withhold: expected a folder apart from --out"):
        withhold.check_separate(tmp_path / shown, tmp_path / "whole")


def test_a_folder_that_holds_something_else_is_refused(quick: list[str], tmp_path: Path) -> None:
    one, other = published(tmp_path / "a", *quick), published(tmp_path / "b", *quick)
    with pytest.raises(InputError, match="holds a whole dataset: choose another --out"):
        withhold.check_separate(one.whole, other.whole)
    for shown, whole in ((one.shown, other.whole), (one.shown, tmp_path / "new"), (tmp_path / "files", one.whole)):
        with pytest.raises(InputError, match=r"is not empty and holds no open part of .*: choose another --out"):
            withhold.check_separate(shown, whole)
    withhold.check_separate(one.shown, one.whole)
    withhold.check_separate(tmp_path / "new", one.whole)


def test_a_record_of_what_is_withheld_that_does_not_hold_is_told(quick: list[str], tmp_path: Path) -> None:
    pair = published(tmp_path, *quick)
    path, secret = pair.whole / withhold.SECRET_FILE, read_secret(pair)
    changed = {key: {**value, "plan.json": "0"} if key == "files" else value[::-1] for key, value in secret.items()}
    for key, value in changed.items():
        path.write_bytes(json_bytes(secret | {key: value}))
        assert [fault.partition(":")[0] for fault in verify(pair.whole).faults] == [withhold.SECRET_FILE]
        with pytest.raises(InputError, match=r"withheld\.json: .*; restore it, or delete it to publish under another"):
            withhold.publish(pair.whole, pair.shown)


def test_answers_left_in_the_open_folder_are_found(quick: list[str], tmp_path: Path) -> None:
    pair = published(tmp_path, *quick)
    for name in (withhold.SECRET_FILE, "plan.json", "test/0000.truth.mcap"):
        (pair.shown / name).write_bytes((pair.whole / name).read_bytes())
        assert verify(pair.shown).faults == (f"{name}: not a file of this dataset",)
        (pair.shown / name).unlink()
