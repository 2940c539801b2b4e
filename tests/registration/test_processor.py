"""Registration predicts the same to the last bit whatever kernels the libraries pick for the processor."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.outside.portable import OLD_PROCESSOR
from kit1000.numerics.elimination import solve_positive
from kit1000.pose import Pose
from kit1000.registration.geometry.sweeps import rotation_matrix
from tests.samples.checkout import ROOT

SEEDS = st.integers(0, 2**32 - 1)

# Queries with a guess from the image and one without by true volumes: every digit of the predictions. And the cameras
# that noisy views have by their table.
CODE = """
import sys
from pathlib import Path
from hashlib import sha256
from kit1000.perception.calibration import calibrated_by
from kit1000.perception.sensor_facts import simulated_sensor
from kit1000.registration.predictor import Registration
from kit1000.dataset.reader import Dataset

data = Dataset(Path(sys.argv[1]))
for sensor in ("d415", "photoneo"):
    image = next(query for query in data.split("val").queries() if query.track == f"snap-{sensor}").image
    view = calibrated_by(image.view, image.labels, simulated_sensor(sensor))
    pose = view.world_from_camera
    print(sensor, pose.wxyz.tolist(), pose.xyz.tolist(), sha256(view.depth.tobytes()).hexdigest())
for track, source in (("snap", "depth"), ("place", "truth")):
    scenes = data.split("train", truth=True)
    scene, query = next((scene, query) for scene in scenes for query in scene.queries if query.track == track)
    true = data.geometry.true_geometry(scene.truth_of(query.id)) if source == "truth" else None
    motion, confidence = Registration(data, source)(query, true)
    print(query.id, source, motion.wxyz.tolist(), motion.xyz.tolist(), confidence)
"""

# Queries by d415 and scanner with networks, and rounded disparities of the one that restores it, of images of noise.
NETWORKS = """
import sys
from hashlib import sha256
from pathlib import Path
import numpy as np
from baselines.catalog import method_of
from kit1000.prediction.making import make_predictor
from kit1000.weights import WEIGHTS
from kit1000.perception.restoration.restorer import Restorer
from kit1000.dataset.reader import Dataset

restorer, shape = Restorer(WEIGHTS / "restoration"), (160, 192)
for seed in range(40):
    rng = np.random.default_rng(seed)
    evidence = {
        "disparity": rng.normal(2, 2, shape).astype(np.float32),
        "returned": rng.random(shape) < 0.9,
        "labels": rng.integers(0, 3, shape, np.uint8),
        "slope": rng.normal(0, 0.02, 2).astype(np.float32),
        "level": rng.uniform(0, 0.3, 1).astype(np.float32),
    }
    print(sha256(restorer.likeliest(evidence, (slice(0, shape[0]), slice(0, shape[1]))).tobytes()).hexdigest())
data = Dataset(Path(sys.argv[1]))
for split, track in (("train", "snap-d415"), ("val", "snap-photoneo")):
    query = next(query for query in data.split(split).queries() if query.track == track)
    motion, confidence = make_predictor(method_of("registration-completed"), data, 0)(query)
    print(query.id, motion.wxyz.tolist(), motion.xyz.tolist(), confidence)
"""


def printed(code: str, mini: Path) -> tuple[str, str]:
    """What a program prints on this processor and on an old one."""
    command = [sys.executable, "-W", "ignore", "-c", code, str(mini)]
    old = {**os.environ, **OLD_PROCESSOR}
    runs = [
        subprocess.Popen(command, cwd=ROOT, env=env, text=True, stdout=subprocess.PIPE) for env in (os.environ, old)
    ]
    here, there = (run.communicate()[0] for run in runs)
    assert [run.returncode for run in runs] == [0, 0]
    return here, there


def test_predictions_do_not_depend_on_the_processor(mini: Path) -> None:
    here, there = printed(CODE, mini)
    assert here.count("\n") == 4
    assert here == there


@pytest.mark.slow
def test_predictions_by_networks_do_not_depend_on_the_processor(mini: Path) -> None:
    here, there = printed(NETWORKS, mini)
    assert here.count("\n") == 42
    assert here == there


@given(SEEDS, st.integers(1, 6), st.sampled_from([1e-6, 1.0, 1e6]))
def test_elimination_solves_as_lapack_does(seed: int, n: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    half, right = rng.normal(size=(n, n)), rng.normal(size=n)
    matrix = scale * (half @ half.T + 0.1 * np.eye(n))
    np.testing.assert_allclose(
        solve_positive(matrix, right), np.linalg.solve(matrix, right), rtol=1e-9, atol=1e-9 / scale
    )


def test_a_singular_system_has_no_finite_solution() -> None:
    assert not np.isfinite(solve_positive(np.zeros((6, 6)), np.ones(6))).any()


@given(SEEDS, st.sampled_from([0.0, 1e-9, 1e-3, 1.0]))
def test_rodrigues_vectors_are_rotations_and_nearly_rotation_vectors(seed: int, size: float) -> None:
    vector = size * np.random.default_rng(seed).uniform(-1, 1, 3)
    rotation = rotation_matrix(np.append(vector, np.zeros(3)))
    np.testing.assert_allclose(rotation, Pose(np.append(1.0, vector / 2), np.zeros(3)).rotation_matrix(), atol=1e-15)
    np.testing.assert_allclose(rotation, Pose.from_rotvec(vector).rotation_matrix(), atol=1e-12 + size**3 / 2)
