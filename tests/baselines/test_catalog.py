"""The reference methods: each is what its entry in the catalog states, and controls have the errors they must have."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from baselines import catalog
from baselines.__main__ import main
from baselines.catalog import all_methods, all_networks, method_of
from baselines.controls import SeenGoal, seen_motion
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.perception.observed.pixels import observed_points
from kit1000.pose import Pose
from kit1000.prediction.catalog import Method
from kit1000.prediction.imported_sources import imported_modules
from kit1000.prediction.making import listed, make_predictor, source_hash
from kit1000.predictor import PredictedMotion, resolved
from kit1000.queries.motions import error_of, goal_motion, goal_pose
from kit1000.queries.tracks import ALL_TRACKS, GUESS_TRACKS
from kit1000.sim.cameras import CAMERA, draw_primary_pose
from kit1000.testing import check_predictor
from kit1000.values import Query, TrueGeometry, Truth, View
from tests.samples.checkout import ROOT

QueryTruths = list[tuple[Query, Truth]]
METHODS = all_methods()
CONTROLS = [name for name, method in METHODS.items() if method.control]


@pytest.fixture(scope="module")
def queries(data: Dataset) -> QueryTruths:
    """All queries of the training split with their ground truth."""
    return [(query, data.truth_of(query)) for query in data.split("train").queries()]


def predicted(name: str, data: Dataset, queries: QueryTruths, seed: int = 0) -> list[tuple[Query, Truth, Pose]]:
    """A method's motions for the queries of its tracks."""
    predictor = make_predictor(METHODS[name], data, seed)
    asked = [(query, truth) for query, truth in queries if query.track in METHODS[name].tracks]
    return [(query, truth, predictor(query, None).goal_from_now) for query, truth in asked]


@pytest.mark.parametrize("name", METHODS)
def test_the_catalog_and_the_code_agree(name: str, data: Dataset) -> None:
    method = METHODS[name]
    predictor = make_predictor(method, data, 0)
    assert getattr(predictor, "uses_true_geometry", method.uses_true_geometry) == method.uses_true_geometry
    assert set(method.tracks) <= set(ALL_TRACKS)
    assert listed(name, method).startswith(f"{name} ")
    assert "\n" not in listed(name, method)


@pytest.mark.parametrize("name", CONTROLS)
def test_controls_conform(name: str, data: Dataset, queries: QueryTruths) -> None:
    """Only the guess moves with the world: the others read goals by the query's id or draw along the world's axes."""
    asked = [query for query, _ in queries if query.track in METHODS[name].tracks]
    check_predictor(make_predictor(METHODS[name], data, 0), asked, name=name, moves=name == "guess")


def test_the_truth_is_the_drawn_goal(data: Dataset, queries: QueryTruths) -> None:
    for _, truth, motion in predicted("truth", data, queries):
        np.testing.assert_array_equal(motion.xyz, truth.goal_drawn.xyz)
        np.testing.assert_array_equal(motion.wxyz, truth.goal_drawn.wxyz)


def test_a_symmetric_truth_is_some_goal_rotated_about_the_free_axis(data: Dataset, queries: QueryTruths) -> None:
    for _, truth, motion in predicted("truth-symmetric", data, queries):
        slot = truth.slot
        angles = np.linspace(0, 2 * np.pi, 100_001) if slot.free_axis is not None else 0.0
        goals = [
            goal_motion(truth.world_from_part, truth.world_from_kit, goal_pose(slot, i, angles))
            for i in range(len(slot.goals))
        ]
        nearest = min(float((goal.inverse() @ motion).angle().min()) for goal in goals)
        shifts = [np.linalg.norm(goal.apply(truth.anchor) - motion.apply(truth.anchor), axis=-1) for goal in goals]
        assert nearest < 1e-4
        assert min(float(shift.min()) for shift in shifts) < 1e-5


def test_noise_is_two_millimetres_and_two_degrees_at_the_anchor(data: Dataset, queries: QueryTruths) -> None:
    for _, truth, motion in predicted("truth-noise", data, queries):
        goal = truth.goal_drawn.apply(truth.anchor)
        assert np.linalg.norm(motion.apply(truth.anchor) - goal) == pytest.approx(2e-3, abs=1e-12)
        assert (motion @ truth.goal_drawn.inverse()).angle() == pytest.approx(np.radians(2), abs=1e-9)


def misses(name: str, data: Dataset, queries: QueryTruths) -> np.ndarray:
    """(n,) [m] at the anchor, from the drawn goal."""
    goals = [
        (truth.goal_drawn.apply(truth.anchor), motion.apply(truth.anchor))
        for _, truth, motion in predicted(name, data, queries)
    ]
    return np.linalg.norm(np.subtract(*np.swapaxes(goals, 0, 1)), axis=1)


def test_a_seen_goal_takes_measured_points_to_measured_goals() -> None:
    rng, depth = np.random.default_rng(0), np.full((CAMERA.height, CAMERA.width), 0.8, np.float32)
    motion = Pose.from_rotvec(rng.normal(size=3), rng.normal(size=3))
    true = View(CAMERA, draw_primary_pose(rng), depth)
    error, scale = Pose.from_rotvec((0.002, 0.001, -0.003), (1e-3, 2e-3, -1e-3)), np.float32(1.0025)
    view = View(CAMERA, true.world_from_camera @ error, depth * scale)
    points = rng.normal(size=(20, 3))

    def measured(there: np.ndarray) -> np.ndarray:
        return view.world_from_camera.apply(float(scale) * true.world_from_camera.inverse().apply(there))

    carried = seen_motion(motion, true, view)
    np.testing.assert_allclose(carried.apply(measured(points)), measured(motion.apply(points)), atol=1e-6)
    same = seen_motion(motion, true, true)
    np.testing.assert_allclose(same.apply(points), motion.apply(points), atol=1e-12)


def test_the_table_corrects_what_the_recorded_calibration_misses(data: Dataset, queries: QueryTruths) -> None:
    recorded, corrected = (misses(name, data, queries) for name in ("truth-calibration", "truth-table"))
    assert 0.5e-3 < recorded.mean() < 6e-3
    assert corrected.mean() < 0.8 * recorded.mean()


def test_on_ideal_depth_a_seen_goal_is_the_goal(data: Dataset, queries: QueryTruths) -> None:
    asked = [(query, truth) for query, truth in queries if query.track == "snap"]
    for by_table, most in ((False, 1e-9), (True, 3e-4)):
        for query, truth in asked:
            motion = SeenGoal(data, by_table)(query, None).goal_from_now
            assert np.linalg.norm(motion.apply(truth.anchor) - truth.goal_drawn.apply(truth.anchor)) < most
            assert (motion @ truth.goal_drawn.inverse()).angle() < most


def test_the_guess_is_the_guess(data: Dataset, queries: QueryTruths) -> None:
    motions = predicted("guess", data, queries)
    assert {query.track for query, _, _ in motions} == {"snap", "snap-tilt", "snap-d415"}
    assert all(motion is query.guess for query, _, motion in motions)
    assert all(query.guess is None for query, _ in queries if query.track not in GUESS_TRACKS)
    without = next(query for query, _ in queries if query.guess is None)
    with pytest.raises(InputError, match=f"{without.id}: track {without.track} has no guess"):
        make_predictor(METHODS["guess"], data, 0)(without, None)


def test_chance_stays_near_a_guess_and_else_goes_to_the_kits_at_any_yaw(data: Dataset, queries: QueryTruths) -> None:
    for query, _, motion in predicted("chance", data, queries):
        if query.guess is not None:
            offset, rotvec = error_of(motion, query.guess, query.pivot)
            assert np.abs(offset).max() <= 28e-3
            assert np.linalg.norm(rotvec) <= np.radians(27.5) + 1e-9
            continue
        there = motion.apply(query.pivot)
        assert np.linalg.norm(observed_points(query, query.kit_region) - there, axis=1).min() < 1e-9
        np.testing.assert_allclose(motion.rotate((0.0, 0.0, 1.0)), (0, 0, 1), atol=1e-12)


@pytest.mark.parametrize("name", ["truth-symmetric", "truth-noise", "chance"])
def test_draws_follow_the_seed(name: str, data: Dataset, queries: QueryTruths) -> None:
    drawn = [[(*motion.wxyz, *motion.xyz) for *_, motion in predicted(name, data, queries, s)] for s in (0, 0, 1)]
    assert drawn[0] == drawn[1]
    assert drawn[0] != drawn[2]


def test_observed_points_are_those_of_the_masked_pixels(queries: QueryTruths) -> None:
    query, _ = queries[0]
    points = observed_points(query, query.part_mask)
    uv = query.view.camera.project(query.view.world_from_camera.inverse().apply(points))
    u, v = np.rint(uv).astype(int).T
    assert query.part_mask[v, u].all()
    assert len(points) == (query.part_mask & (query.view.depth > 0)).sum()
    assert (points.min(0) < query.pivot).all()
    assert (query.pivot < points.max(0)).all()
    few = observed_points(query, query.part_mask, 100)
    assert 50 < len(few) <= 100
    assert (few[:, None] == points).all(2).any(1).all()
    assert observed_points(query, np.zeros_like(query.part_mask), 100).shape == (0, 3)


class Own:
    """A method of one's own.

    More of it.
    """

    tracks = ("place",)
    learned = True

    def __init__(self, dataset: Dataset, seed: int) -> None:
        self.dataset, self.seed = dataset, seed

    def __call__(self, query: Query, geometry: TrueGeometry | None) -> PredictedMotion:
        return PredictedMotion(Pose.identity(), 1.0)


def test_a_method_of_ones_own_is_made_from_its_module(data: Dataset) -> None:
    method = method_of(f"{__name__}:Own")
    assert method == Method(f"{__name__}:Own", "A method of one's own.", tracks=("place",), learned=True)
    predictor = make_predictor(method, data, 3)
    assert isinstance(predictor, Own)
    assert (predictor.dataset, predictor.seed) == (data, 3)
    assert make_predictor(method_of("baselines.controls:guess"), data, 0) is resolved("baselines.controls:guess")
    assert method_of("baselines.controls:NoisyGoal").uses_true_geometry
    assert not method_of("kit1000.registration.predictor:Registration").uses_true_geometry  # its instances have it


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("gues", "'gues'.*guess[?].*truth.*module:Object"),
        ("nowhere:Object", "nowhere:Object: No module named 'nowhere'"),
        ("baselines.controls:Gues", "baselines.controls has no Gues that can be called"),
        ("baselines.controls:NOISE", "has no NOISE that can be called"),
        ("baselines.controls:", "has no object that can be called"),
    ],
)
def test_an_unknown_method_gives_one_line(name: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        method_of(name)


def test_the_source_of_a_method_is_all_that_it_imports(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "lone_method.py").write_text("def predict(): ...\n")
    (tmp_path / "beside_method.py").write_text("")
    (tmp_path / "wide_method").mkdir()
    (tmp_path / "wide_method/__init__.py").write_text("")
    (tmp_path / "wide_method/method.py").write_text(
        "import beside_method\n\n\ndef predict():\n    from wide_method import deep\n"
    )
    (tmp_path / "wide_method/deep.py").write_text("")
    (tmp_path / "wide_method/unused.py").write_text("")
    lone, wide = (Method(f"{name}:predict", "") for name in ("lone_method", "wide_method.method"))
    before = source_hash(lone), source_hash(wide)
    (tmp_path / "wide_method/unused.py").write_text("x = 1\n")
    assert before == (source_hash(lone), source_hash(wide))
    for imported in ("wide_method/deep.py", "beside_method.py"):
        earlier = source_hash(wide)
        (tmp_path / imported).write_text("x = 1\n")
        assert source_hash(lone) == before[0]
        assert source_hash(wide) != earlier


def test_the_source_of_registration_covers_perception_and_predicted_masks() -> None:
    entry = METHODS["registration"].make.partition(":")[0]
    found = imported_modules([entry], {"kit1000": ROOT / "kit1000"})
    assert {"kit1000.registration.search", "kit1000.perception.restoration.restorer"} <= set(found)
    assert source_hash(METHODS["registration"]) != source_hash(method_of("registration+predicted-masks"))


def test_the_list_loads_no_network() -> None:
    code = "import sys; from baselines.__main__ import main; main(['list']); print('torch' in sys.modules)"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT).stdout
    lines = out.splitlines()
    assert [line.split()[0] for line in lines[:-1]] == list(METHODS)
    assert lines[-1] == "False"


TOY = '''
"""A network that learns one number: the mean height of pivots."""

from pathlib import Path

import torch

from baselines.catalog import Network
from kit1000.perception.networks.weight_files import load_weights
from baselines.training.config import TrainConfig
from kit1000.prediction.catalog import Method
from kit1000.pose import Pose
from kit1000.predictor import PredictedMotion

METHODS = {
    "toy": Method("toy_method:Toy", "a toy", learned=True, options={"half": True}, weights={"stem": "toy-height"})
}
NETWORKS = {
    "toy-height": Network("toy_method:height_task", {"tiny": TrainConfig(steps=2, batch=1)}, {"split": "train"})
}


class Toy:
    def __init__(self, dataset, half, stem):
        self.weights, self.half = stem, half

    def __call__(self, query, geometry):
        return PredictedMotion(Pose.identity(), 0.5 if self.half else 1.0)


class HeightTask:
    def __init__(self, queries):
        self.model = torch.nn.Linear(1, 1)
        self.model.config = TrainConfig()
        self.queries = queries

    def example(self, rng):
        return {"height": self.queries[rng.integers(len(self.queries))].pivot[2:].astype("float32")}

    def validation_keys(self):
        return range(1)

    def validation_example(self, key):
        return {"height": self.queries[key].pivot[2:].astype("float32")}

    def loss(self, batch):
        return (self.model(torch.ones_like(batch["height"])) - batch["height"]).square().mean()

    def measure(self, batch):
        return {"error": (self.model(torch.ones_like(batch["height"])) - batch["height"])[:, 0].abs()}


def height_task(dataset, preset, split):
    return HeightTask(list(dataset.split(split).queries()))
'''


def test_a_learned_method_is_a_folder_and_a_line(
    mini: Path, data: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is listed, trained by its name and preset, and makes predictions, with nothing but a line of the tables."""
    (tmp_path / "toy_method").mkdir()
    (tmp_path / "toy_method/__init__.py").write_text(TOY)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(catalog, "METHOD_TABLES", (*catalog.METHOD_TABLES, "toy_method"))
    monkeypatch.setattr(catalog, "NETWORK_TABLES", (*catalog.NETWORK_TABLES, "toy_method"))
    assert list(all_methods()) == [*METHODS, "toy"]
    assert list(all_networks())[-1] == "toy-height"
    query = next(data.split("train").queries())
    assert make_predictor(method_of("toy"), data, 0)(query, None).confidence == 0.5

    train = ["train", "toy-height", "--data", str(mini), "--out", str(tmp_path / "run"), "--workers", "0"]
    assert main([*train, "--preset", "tinny"]) == 2
    error = capsys.readouterr().err
    assert all(fact in error for fact in ("'tinny'", "toy-height", "did you mean tiny?"))
    assert main([*train, "--preset", "tiny"]) == 0
    assert "step 2 (steps)" in capsys.readouterr().out
    assert (tmp_path / "run/best.safetensors").is_file()


def test_a_name_declared_twice_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(catalog, "METHOD_TABLES", (*catalog.METHOD_TABLES, "baselines.icp"))
    with pytest.raises(InputError, match=r"baselines\.icp\.METHODS: icp is declared twice"):
        all_methods()
