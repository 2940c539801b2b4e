"""Withholding: no byte of the public folder, and no combination of its queries, reveals the truth of the test split."""

from __future__ import annotations

import hashlib
import itertools
import json
import secrets
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import combinations
from operator import and_, or_
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from benchmark.score import read_checked, score
from kit1000 import Prediction, write_submission
from kit1000.dataset.geometry import Geometry
from kit1000.dataset.mcap_io import ObservationFile, ObservationWriter
from kit1000.dataset.reader import WITHHELD_FILE, Dataset
from kit1000.errors import InputError
from kit1000.export.recording import write_scene_recording
from kit1000.files import json_bytes, read_json
from kit1000.generation import build, withhold
from kit1000.generation.plan import dataset_id
from kit1000.generation.presets import PRESETS
from kit1000.generation.verify import verify
from kit1000.generation.withhold import withheld_preset
from kit1000.mesh import y_up
from kit1000.pictures.dataset_sheets import scene_sheet
from kit1000.pose import Pose
from kit1000.queries.motions import error_of
from kit1000.queries.tracks import TRACKS
from kit1000.submission import check
from kit1000.values import Query
from tests.samples.mini import HIDDEN, Published, file_hashes, l_shape_sources, publish_by_command
from tests.samples.submissions import manifest

RUN = 12  # consecutive vertices: more than the corners that all plates have
KEY = 8  # bytes that the search compares first
STEP = 2**127 // 5  # between the seeds that the tests draw


@pytest.fixture
def folders(withheld: Published) -> Published:
    return withheld


@pytest.fixture
def drawn_dataset(fake_scenes: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[str]:
    """Options for a dataset of simple parts with fake scenes, of a random seed."""
    monkeypatch.setitem(PRESETS, "hidden", HIDDEN)
    l_shape_sources(tmp_path / "files", (18, 20, 24, 28, 33))
    return ["--parts", f"{tmp_path}/files"]


@pytest.fixture
def quick_dataset(drawn_dataset: list[str], monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The same, of a first seed, a second and so on that are those of every other test, and so are the kits."""
    draws = itertools.count(1)
    monkeypatch.setattr(secrets, "randbelow", lambda _: next(draws) * STEP)
    return drawn_dataset


def readable_bytes(root: Path) -> Iterator[bytes]:
    """All bytes of a folder, and all messages and metadata of its recordings, decompressed by the MCAP reader."""
    for path in root.rglob("*"):
        if path.is_file():
            yield path.read_bytes()
        if path.suffix == ".mcap":
            with path.open("rb") as file:
                reader = make_reader(file)
                yield from (message.data for _, _, message in reader.iter_messages())
                yield from (json.dumps(record.metadata).encode() for record in reader.iter_metadata())


def found_in(root: Path, needles: set[bytes]) -> set[bytes]:
    """Those of some byte strings, KEY bytes or more each, that occur anywhere in a folder."""
    by_key: dict[int, list[bytes]] = {}
    for needle in needles:
        by_key.setdefault(int.from_bytes(needle[:KEY], "little"), []).append(needle)
    keys = np.array(sorted(by_key), np.uint64)
    likely = np.zeros((2, 1 << 16), bool)  # the first two bytes of a key, the next two
    for half, known in enumerate(likely):
        known[keys >> np.uint64(16 * half) & np.uint64(0xFFFF)] = True
    found = set()
    for data in readable_bytes(root):
        for shift in range(min(KEY, len(data) - KEY + 1)):
            words = np.frombuffer(data, np.uint64, (len(data) - shift) // KEY, shift)
            halves = words.view(np.uint16)
            near = np.flatnonzero(likely[0][halves[::4]])
            near = near[likely[1][halves[4 * near + 1]]]
            for at in near[keys[np.searchsorted(keys[:-1], words[near])] == words[near]]:
                place = shift + KEY * int(at)
                found |= {needle for needle in by_key[int(words[at])] if data.startswith(needle, place)}
    return found


def number_bytes(rows: np.ndarray) -> set[bytes]:
    """Rows of numbers in the binary and text forms that a program may write."""
    number_forms = {np.ascontiguousarray(row, kind).tobytes() for row in rows for kind in ("<f8", "<f4", ">f8", ">f4")}
    return number_forms | {repr(value).encode() for value in np.ravel(rows).tolist() if len(repr(value)) > 10}


def seed_bytes(seed: int, identity: str) -> set[bytes]:
    words = [seed, seed % 2**64, seed >> 64]
    sizes = [16, 8, 8]
    binary = {word.to_bytes(n, order) for word, n in zip(words, sizes, strict=True) for order in ("little", "big")}
    return binary | {str(seed).encode(), f"{seed:x}".encode(), f"{seed:X}".encode(), identity.encode()}


def pose_bytes(full: Path) -> set[bytes]:
    """Numbers of the true poses of the test split."""
    rows: list[Any] = []
    for scene in Dataset(full).split("test", truth=True):
        truth = scene.truth
        assert truth.goals is not None
        rows += [truth.world_from_assembly.xyz, truth.world_from_assembly.wxyz, *truth.goals.xyz, *truth.goals.wxyz]
        for part in truth.parts:
            rows += [part[key][entry] for key in ("world_from_part", "world_from_kit") for entry in ("xyz", "wxyz")]
        for query in truth.queries.values():
            rows += [query["goal_drawn"]["xyz"], query["goal_drawn"]["wxyz"]]
            rows += [query["draw"]["offset"], query["draw"]["rotvec"]] if query["draw"] else []
    return set().union(*(number_bytes(np.array([row])) for row in rows))


def mesh_bytes(full: Path) -> set[bytes]:
    """Consecutive vertices of the test split's meshes, in the frame of a GLB and in their own frame."""
    geometry, needles = Geometry(full), set()
    kinds = {"parts": geometry.part, "kits": geometry.kit, "assemblies": geometry.assembly}
    for kind, get in kinds.items():
        for item_id in (i for i in getattr(geometry, kind) if i.startswith("test")):
            vertices = get(item_id).mesh.vertices
            for points in (vertices, y_up(vertices)):
                rows = points.astype("<f4")
                needles |= {rows[i : i + RUN].tobytes() for i in range(0, len(rows) - RUN + 1, RUN)}
    return needles


def test_no_byte_of_the_public_folder_reveals_the_seed_a_pose_or_a_mesh(folders: Published) -> None:
    plan, secret = read_json(folders.full / "plan.json"), read_json(folders.full / WITHHELD_FILE)
    seed = seed_bytes(plan["seed"], dataset_id(plan)) | {secret["salt"].encode()}
    poses, meshes = pose_bytes(folders.full), mesh_bytes(folders.full)
    assert not found_in(folders.public, seed | poses | meshes)
    found_in_full = found_in(folders.full, seed | poses | meshes)  # the search finds them where they are
    assert str(plan["seed"]).encode() in found_in_full
    assert len(found_in_full & poses) > 20
    assert len(found_in_full & meshes) >= len(meshes) / 2  # those in the order and frame of the files


def test_the_public_folder_has_neither_plan_nor_truth_nor_test_parts(folders: Published) -> None:
    names = set(file_hashes(folders.public))
    assert not [name for name in names if "truth" in name and name.startswith("test")]
    assert not names & {"plan.json", WITHHELD_FILE, withhold.BEGUN_FILE}
    assert not [name for name in names if name.startswith(("parts/test", "kits/test", "assemblies/test"))]
    assert {"test/0000.mcap", "test/0000.three.mcap", "train/0000.truth.mcap", "parts/val-0000.glb"} < names
    for name in ("parts.json", "kits.json", "assemblies.json"):
        assert b"test" not in (folders.public / name).read_bytes()
        assert set(read_json(folders.public / name)) == {"train-0000", "val-0000"}
    summary = read_json(folders.public / "dataset.json")
    assert summary["seed"] is None
    assert "test" not in summary["statistics"]
    assert summary["config"]["curve_scenes"] == 0


def test_public_files_equal_those_of_the_full_folder(folders: Published) -> None:
    public, full = file_hashes(folders.public), file_hashes(folders.full)
    rewritten = {"dataset.json", "README.md", "croissant.json", "parts.json", "kits.json", "assemblies.json"}
    changed = {name for name in public if public[name] != full.get(name)}
    assert changed == rewritten | {"test/0000.mcap", "test/0000.three.mcap"}


def test_the_commitment_is_that_of_the_withheld_files(folders: Published) -> None:
    secret, public = read_json(folders.full / WITHHELD_FILE), read_json(folders.public / "dataset.json")
    hashes = {name: hashlib.sha256((folders.full / name).read_bytes()).hexdigest() for name in secret["files"]}
    assert hashes == secret["files"]
    number_forms = hashlib.sha256(secret["salt"].encode() + json_bytes(hashes)).hexdigest()
    assert public["withheld"] == {"split": "test", "salted_sha256": number_forms}
    identity = secret["salt"] + dataset_id(read_json(folders.full / "plan.json"))
    assert public["dataset_id"] == hashlib.sha256(identity.encode()).hexdigest()[:16]
    assert len(secret["salt"]) == 64
    only_in_full = set(file_hashes(folders.full)) - set(file_hashes(folders.public)) - {WITHHELD_FILE}
    rewritten = {"parts.json", "kits.json", "assemblies.json", "test/0000.mcap", "test/0000.three.mcap"}
    assert set(secret["files"]) == only_in_full | rewritten


def test_the_public_folder_can_be_read_without_the_test_truth(folders: Published) -> None:
    public, full = Dataset(folders.public), Dataset(folders.full)
    assert public.id != full.id
    arguments = [query.id for query in public.split("test").queries()]
    assert arguments == [query.id for query in full.split("test").queries()] != []
    assert next(iter(public.split("val", truth=True))).truths
    with pytest.raises(InputError, match=r"no file test/0000\.truth\.mcap \(withheld from this folder\)"):
        next(iter(public.split("test", truth=True))).truth
    with pytest.raises(InputError, match="made without curves; a dataset with withheld truth has none"):
        len(public.split("curves"))


@pytest.mark.usefixtures("quick_pictures")
def test_a_scene_of_one_sensor_is_read_by_it(folders: Published, tmp_path: Path) -> None:
    public, full = Dataset(folders.public), Dataset(folders.full)
    for scene in public.split("test-all"):
        (sensor,) = scene.sensors
        whole = full.recorded_scene(scene.id)
        assert np.array_equal(scene.view().depth, whole.view(sensor).depth)
        assert np.array_equal(scene.labels, whole.labels)
        assert scene.labelled_depth() is scene.labelled_depth(sensor) is scene.queries[0].image
        assert np.array_equal(public.observation_file(scene.shard).view(scene.id).depth, scene.view().depth)
        assert scene_sheet(public, scene.id).startswith(b"\x89PNG")
        assert write_scene_recording(public, scene.id, tmp_path / "scene.mcap").is_file()
        with pytest.raises(InputError, match="the truth was not opened"):
            scene.render("top")
        other = next(iter({"ideal", "d415"} - {sensor}))
        with pytest.raises(InputError, match=f"scene {scene.id} has no view '{other}'; it has {sensor}$"):
            scene.view(other)
    assert {scene.sensors[0] for scene in public.split("test-all")} == {"ideal", "d415"}


def test_both_folders_verify_and_the_public_one_notes_the_withheld_plan(folders: Published) -> None:
    report = verify(folders.public, sample=2)
    assert (report.faults, report.rebuilt) == ((), ())
    (note,) = report.notes
    assert "the plan is withheld" in note
    assert verify(folders.full) == type(report)(report.files + len(set(read_secret(folders)["files"])) - 5, (), ())


def test_a_submission_made_on_the_public_folder_is_scored_on_the_full_one(folders: Published, tmp_path: Path) -> None:
    public, full = Dataset(folders.public), Dataset(folders.full)
    assert (public.public_id, full.public_id) == (None, public.id)
    queries = list(public.split("test").queries())
    predictions = [Prediction(query.id, full.truth_of(query).goal_drawn, 1.0, -1) for query in queries]
    described = manifest(public.id, tracks=tuple(sorted({query.track for query in queries})))
    write_submission(tmp_path / "truth", described, predictions)
    assert not check(tmp_path / "truth", folders.public).errors
    scores = score(read_checked(tmp_path / "truth", folders.full, "test"), full).summary["tracks"]
    assert sum(track["n"] for track in scores.values()) == len(queries)
    assert all(track["seated"]["rate"] == 1 and track["mssd_mm"]["mean"] < 1e-9 for track in scores.values())


def read_secret(folders: Published) -> dict[str, Any]:
    return read_json(folders.full / WITHHELD_FILE)


def test_the_same_command_again_changes_nothing(quick_dataset: list[str], tmp_path: Path) -> None:
    folders = publish_by_command(tmp_path, *quick_dataset)
    before = file_hashes(folders.full), file_hashes(folders.public)
    publish_by_command(tmp_path, *quick_dataset)
    assert (file_hashes(folders.full), file_hashes(folders.public)) == before


def test_files_of_either_folder_are_no_sources_of_the_next_run(quick_dataset: list[str], tmp_path: Path) -> None:
    before = file_hashes(publish_by_command(tmp_path, "--parts", f"{tmp_path}").public)
    assert file_hashes(publish_by_command(tmp_path, "--parts", f"{tmp_path}").public) == before


def test_two_datasets_have_different_long_seeds(
    drawn_dataset: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(PRESETS, "hidden", replace(HIDDEN, test=1, kits=(1, 1)))
    pairs = [publish_by_command(tmp_path / name, *drawn_dataset) for name in "ab"]
    seeds = [read_json(folders.full / "plan.json")["seed"] for folders in pairs]
    assert seeds[0] != seeds[1]
    assert min(seeds) >= 2**127
    salts = [read_secret(folders)["salt"] for folders in pairs]
    assert salts[0] != salts[1]
    assert [len(bytes.fromhex(salt)) for salt in salts] == [32, 32]


class Stop(BaseException):
    """An exception that no code handles."""


@pytest.mark.parametrize("place", ["make_shard", "link_or_copy", "description_files"])
def test_an_interrupted_run_continues_as_the_same_dataset(
    place: str, quick_dataset: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopping(*arguments: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls > 2:
            raise Stop
        return original(*arguments)

    calls = 0 if place == "link_or_copy" else 1
    module = build if place == "make_shard" else withhold
    original = getattr(module, place)
    with monkeypatch.context() as patch:
        patch.setattr(module, place, stopping)
        with pytest.raises(Stop):
            publish_by_command(tmp_path, *quick_dataset)
    assert not (tmp_path / "public/dataset.json").exists()
    seed = read_json(tmp_path / "full/plan.json")["seed"]
    secret = tmp_path / "full" / WITHHELD_FILE
    earlier_secret = secret.read_bytes() if secret.exists() else None
    folders = publish_by_command(tmp_path, *quick_dataset)
    assert read_json(folders.full / "plan.json")["seed"] == seed
    assert earlier_secret in (None, secret.read_bytes())
    assert (earlier_secret is None) == (place == "make_shard")
    assert verify(folders.public).faults == verify(folders.full).faults == ()


def test_a_drawn_seed_has_128_bits_of_which_all_but_the_first_are_random(tmp_path: Path) -> None:
    seeds = [withhold.secret_seed(tmp_path, None) for _ in range(64)]
    assert {seed.bit_length() for seed in seeds} == {128}
    assert reduce(or_, seeds) == 2**128 - 1
    assert reduce(and_, seeds) == 2**127
    for seed in (2**127, 2**128 - 1):
        assert withhold.secret_seed(tmp_path, seed) == seed


@pytest.mark.parametrize("seed", [7, 2**64, 2**127 - 1])
def test_a_folder_made_from_a_guessable_seed_is_refused(seed: int, tmp_path: Path) -> None:
    (tmp_path / "plan.json").write_bytes(json_bytes({"seed": seed}))
    with pytest.raises(InputError, match=f"seed {seed}, which can be guessed"):
        withhold.secret_seed(tmp_path, None)


@pytest.mark.parametrize("public", ["full", "full/public", ".", "link"])
def test_the_public_folder_must_be_outside_the_full_one(public: str, tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "full")
    with pytest.raises(InputError, match="--withhold: expected a folder outside --out"):
        withhold.check_separate(tmp_path / public, tmp_path / "full")


def test_a_folder_with_other_contents_is_refused(quick_dataset: list[str], tmp_path: Path) -> None:
    one, other = publish_by_command(tmp_path / "a", *quick_dataset), publish_by_command(tmp_path / "b", *quick_dataset)
    with pytest.raises(InputError, match="contains a full dataset: choose another --out"):
        withhold.check_separate(one.full, other.full)
    for public, full in ((one.public, other.full), (one.public, tmp_path / "new"), (tmp_path / "files", one.full)):
        with pytest.raises(InputError, match=r"not empty.* no public part of .*--out"):
            withhold.check_separate(public, full)
    withhold.check_separate(one.public, one.full)
    withhold.check_separate(tmp_path / "new", one.full)


def test_a_changed_record_of_the_withheld_files_is_reported(quick_dataset: list[str], tmp_path: Path) -> None:
    folders = publish_by_command(tmp_path, *quick_dataset)
    path, secret = folders.full / WITHHELD_FILE, read_secret(folders)
    changed = {key: {**value, "plan.json": "0"} if key == "files" else value[::-1] for key, value in secret.items()}
    for key, value in changed.items():
        path.write_bytes(json_bytes(secret | {key: value}))
        assert [fault.partition(":")[0] for fault in verify(folders.full).faults] == [WITHHELD_FILE]
        with pytest.raises(InputError, match=r"withheld\.json: .*restore it"):
            withhold.publish(folders.full, folders.public)


def test_truth_left_in_the_public_folder_is_found(quick_dataset: list[str], tmp_path: Path) -> None:
    folders = publish_by_command(tmp_path, *quick_dataset)
    for name in (WITHHELD_FILE, "plan.json", "test/0000.truth.mcap"):
        (folders.public / name).write_bytes((folders.full / name).read_bytes())
        assert verify(folders.public).faults == (f"{name}: not a file of this dataset",)
        (folders.public / name).unlink()


@dataclass(frozen=True)
class Clue:
    """What one query tells about the goal of its part."""

    query: Query
    goal: Pose | None = None
    """goal_from_now that the guess misses, where the test knows it."""

    @property
    def guess(self) -> Pose:
        assert self.query.guess is not None
        return self.query.guess


def clues_by_part(root: Path, truth: bool, splits: Iterable[str]) -> dict[tuple[str, int], list[Clue]]:
    """The queries of a folder with a guess, by scene and part; with their goals if `truth`."""
    found = defaultdict(list)
    for split in splits:
        for scene in Dataset(root).split(split, truth=truth):
            for query in scene.queries:
                if query.guess is not None:
                    goal = scene.truths[query.id].goal_drawn if truth else None
                    found[query.scene_id, query.part].append(Clue(query, goal))
    return found


def groups(clues: Sequence[Clue]) -> list[tuple[Clue, ...]]:
    """All pairs and triples of queries about a part, of whatever tracks, sensors and levels."""
    return [group for size in (2, 3) for group in combinations(clues, size)]


def test_a_withheld_folder_has_no_two_queries_to_combine(withheld: Published) -> None:
    clues = clues_by_part(withheld.public, False, ["test-all"])
    assert clues
    assert [group for part in clues.values() for group in groups(part)] == []
    queries = list(Dataset(withheld.public).split("test-all").queries())
    parts = [(query.scene_id, query.part) for query in queries]
    assert len(parts) == len(set(parts))  # also none without a guess beside one with a guess


def test_a_withheld_scene_has_one_track_and_the_images_of_its_sensor_alone(withheld: Published) -> None:
    # A guess about one part would show a track without guesses which slot is left for another part.
    public, full = Dataset(withheld.public), Dataset(withheld.full)
    tracks = {scene.id: {query.track for query in scene.queries} for scene in public.split("test-all")}
    assert {len(names) for names in tracks.values()} == {1}
    for shard in {*public.shards("test").values()}:
        for camera_set in (None, "three"):
            file, whole = public.observation_file(shard, camera_set), full.observation_file(shard, camera_set)
            for scene_id in file.scene_ids:
                (track,) = tracks[scene_id]
                assert {key.rpartition("/")[2] for key in file.view_keys(scene_id)} == {TRACKS[track].sensor}
                assert {key.rpartition("/")[2] for key in whole.view_keys(scene_id)} == {"ideal", "d415", "photoneo"}
    assert len({track for (track,) in tracks.values()}) > 1


def test_scenes_for_training_and_validation_keep_all_tracks_and_sensors(withheld: Published) -> None:
    for split in ("train", "val"):
        scenes = list(Dataset(withheld.public).split(split))
        scanner = {"photoneo"} if split == "val" else set()
        assert {sensor for scene in scenes for sensor in scene.sensors} == {"ideal", "d415"} | scanner
        assert {"snap", "snap-tilt", "snap-d415"} <= {query.track for scene in scenes for query in scene.queries}


def test_a_recording_holds_nothing_but_its_observations(withheld: Published, tmp_path: Path) -> None:
    paths = sorted((withheld.public / "test").glob("*.mcap"))
    assert paths
    for path in paths:
        file = ObservationFile(path)
        with ObservationWriter(tmp_path / path.name) as writer:
            for scene_id in file.scene_ids:
                writer.add(file.observation(scene_id))
        assert (tmp_path / path.name).read_bytes() == path.read_bytes()


def test_a_withheld_dataset_has_no_curves() -> None:
    for preset in PRESETS.values():
        assert (withheld_preset(preset).curve_scenes, withheld_preset(preset).one_track) == (0, True)
        assert not preset.one_track


def test_no_two_guesses_share_an_error_or_its_direction(mini: Path) -> None:
    tracks = set()
    for clues in clues_by_part(mini, True, ["train", "val", "test-all"]).values():
        errors = []
        for clue in clues:
            assert clue.goal is not None
            errors.append(error_of(clue.guess, clue.goal, clue.query.pivot))
            tracks.add(clue.query.track)
        for (one, turn), (other, other_turn) in combinations(errors, 2):
            assert np.linalg.norm(np.cross(one, other)) > 1e-3 * np.linalg.norm(one) * np.linalg.norm(other)
            assert np.linalg.norm(turn - other_turn) > 1e-4
            assert np.abs(one - other).min() > 1e-6
        for group in groups(clues):
            assert len({tuple(np.round(clue.guess.wxyz, 6)) for clue in group}) == len(group)
    assert tracks == {"snap", "snap-tilt", "snap-d415", "snap-photoneo"}
