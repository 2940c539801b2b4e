"""Methods and weights of users: named by file, failing with their own line, one set of weights in a submission."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from baselines.catalog import all_methods, run_config
from baselines.training.shipping import ship
from kit1000.cli import main
from kit1000.errors import InputError, InternalError
from kit1000.files import write_json
from kit1000.perception.networks.weight_files import load_weights, save_weights
from kit1000.prediction.making import source_hash, with_weights
from kit1000.prediction.predict import predict
from kit1000.predictor import resolved
from kit1000.submission import read_manifest, read_submission, write_manifest
from kit1000.weights import WEIGHTS
from tests.samples.checkout import ROOT

GOOD = """
from kit1000 import PredictedMotion

def predict(query, geometry):
    return PredictedMotion(query.guess, 0.5)
predict.tracks = ("snap",)
"""
ENDING = {
    "call": "import sys\n\ndef predict(query, geometry):\n    sys.exit(0)\npredict.tracks = ('snap',)\n",
    "init": "import sys\n\nclass predict:\n    tracks = ('snap',)\n    def __init__(self, dataset):\n"
    "        sys.exit(0)\n    def __call__(self, query, geometry):\n        pass\n",
    "module": "import sys\n\n\nsys.exit(0)\n",
    "error": "def predict(query, geometry):\n    return 1 / 0\npredict.tracks = ('snap',)\n",
    "broken": "def predict(query, geometry:\n",
}
LINES = {"call": 4, "init": 6, "module": 4, "error": 2, "broken": 1}


def run(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """The command in a folder, in a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "kit1000", "predict", *words]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)


def test_a_method_of_the_folder_is_found_by_the_command(mini: Path, tmp_path: Path) -> None:
    (tmp_path / "my_method_a.py").write_text(GOOD)
    done = run(tmp_path, "./my_method_a.py:predict", "--data", str(mini), "--tracks", "snap", "--out", "o")
    assert done.returncode == 0, done.stderr
    assert read_manifest(tmp_path / "o/manifest.toml").method == "my_method_a.py:predict"


@pytest.mark.parametrize("name", ["./my_method_b.py:predict", "my_method_c.py:predict", "sub/my_method_d.py:predict"])
def test_a_method_is_named_by_its_file(name: str, mini: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / name.partition(":")[0]
    file.parent.mkdir(exist_ok=True)
    file.write_text(GOOD)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    line = ["predict", name, "--data", str(mini), "--tracks", "snap", "--out", "o", "--workers", "1"]
    assert main(line) == 0
    assert read_manifest(tmp_path / "o/manifest.toml").method == f"{file.name}:predict"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("./my_method.py", "expected the file and its function or class, such as ./my_method.py:predict"),
        ("./missing.py:predict", "no file missing.py"),
        ("json.py:predict", "another module is called json; rename the file"),
    ],
)
def test_a_wrong_file_is_one_line(
    name: str, message: str, mini: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    (tmp_path / "json.py").write_text(GOOD)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    assert main(["predict", name, "--data", str(mini), "--out", "o"]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_a_method_that_ends_the_process_ends_the_command_with_its_line(mini: Path, tmp_path: Path) -> None:
    (tmp_path / "method_call.py").write_text(ENDING["call"])
    done = run(tmp_path, "method_call:predict", "--data", str(mini), "--tracks", "snap", "--out", "o", "--workers", "2")
    lines = [line for line in done.stderr.splitlines() if line.startswith("kit1000: ")]
    assert done.returncode == 3, done.stderr
    assert lines == ["kit1000: test-s0000-p0-snap: it ends the process by sys.exit(0) (method_call.py:4)"]
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize("kind", ENDING)
def test_a_method_that_fails_or_exits_anywhere_is_named_with_its_line(
    kind: str, mini: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "path", list(sys.path))
    file = tmp_path / f"failing_{kind}.py"
    file.write_text(ENDING[kind])
    with pytest.raises(InternalError) as caught:
        predict(run_config(f"{file}:predict", ("test",), ("snap",)), mini, tmp_path / "o", 1)
    message = str(caught.value)
    assert f"(failing_{kind}.py:{LINES[kind]})" in message
    assert "please report this bug" not in message
    assert kind in ("module", "broken") or message.startswith("test-s0000-p0-snap: ")


def test_an_unloadable_module_keeps_its_message() -> None:
    with pytest.raises(InputError, match="No module named 'nobody_has_this'"):
        resolved("nobody_has_this:predict")
    assert issubclass(InternalError, Exception)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder as `train` writes it, with weights of the completion network that differ from the published ones."""
    tensors, info = load_weights(WEIGHTS / "completion")
    module = torch.nn.Module()
    for name, value in tensors.items():
        module.register_buffer(name.replace(".", "__"), value)
    folder = tmp_path_factory.mktemp("run")
    about = {
        "name": "completion",
        "dataset_id": "feedfeedfeedfeed",
        "preset": "small",
        "network": info["about"]["network"],
    }
    save_weights(folder / "best", module, {"about": about, "step": 20}, "float16", None)
    (folder / "log.jsonl").write_text('{"step": 20, "seconds": 1, "loss": 1, "measures": {}}\n')
    return folder


@pytest.fixture
def own_run(trained: Path, tmp_path: Path) -> Path:
    """A copy of that folder."""
    return shutil.copytree(trained, tmp_path / "run")


def test_weights_of_a_run_replace_the_published_ones_of_their_network_alone(own_run: Path) -> None:
    method = all_methods()["registration-completed"]
    own = with_weights(method, [own_run])
    assert own.weights["completion"] == own_run / "best"
    assert {k: v for k, v in own.weights.items() if k != "completion"} == {
        k: v for k, v in method.weights.items() if k != "completion"
    }
    assert "completion: split train of dataset feedfeedfeedfeed" in own.training_data
    assert method.training_data in own.training_data
    assert own.label.endswith(", own weights")
    assert with_weights(method, [own_run / "best.safetensors"]) == own
    assert source_hash(own) != source_hash(method)
    assert with_weights(method, []) is method


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda run: (run / "best.safetensors").unlink(), r"no file .*best\.safetensors; expected the folder of a run"),
        (
            lambda run: write_json(run / "best.json", {"about": {"name": "kitnet"}}),
            "weights of kitnet, which the method",
        ),
        (lambda run: write_json(run / "best.json", {}), "describes no weights of a training run"),
    ],
)
def test_other_weights_are_refused(change: Any, message: str, own_run: Path) -> None:
    change(own_run)
    with pytest.raises(InputError, match=message):
        with_weights(all_methods()["registration-completed"], [own_run])
    write_json(own_run / "best.json", {"about": {"name": "kitnet"}})
    (own_run / "best.safetensors").touch()
    with pytest.raises(InputError, match="it uses no weights"):
        with_weights(all_methods()["registration"], [own_run])


def test_one_submission_holds_one_code_and_one_set_of_weights(mini: Path, tmp_path: Path) -> None:
    predict(run_config("guess", ("test",), ("snap",)), mini, tmp_path / "o", 1)
    manifest = read_manifest(tmp_path / "o/manifest.toml")
    assert len(manifest.source) == 64
    predict(run_config("guess", ("test",), ("snap-tilt",)), mini, tmp_path / "o", 1)
    rows = (tmp_path / "o/predictions.csv").read_bytes()
    write_manifest(tmp_path / "o/manifest.toml", replace(manifest, source="0" * 64))
    with pytest.raises(InputError, match=r"holds rows of other code or other weights .source 000000000000, now"):
        predict(run_config("guess", ("test",), ("snap-d415",)), mini, tmp_path / "o", 1)
    write_manifest(tmp_path / "o/manifest.toml", replace(manifest, source="", training_data="mine"))
    with pytest.raises(InputError, match="holds rows of weights trained on 'mine', not on 'nothing'"):
        predict(run_config("guess", ("test",), ("snap-d415",)), mini, tmp_path / "o", 1)
    assert (tmp_path / "o/predictions.csv").read_bytes() == rows
    assert len(read_submission(tmp_path / "o").predictions) > 0


def test_shipping_refuses_weights_of_another_dataset(own_run: Path, tmp_path: Path) -> None:
    published = tmp_path / "weights"
    published.mkdir()
    write_json(published / "completion.json", {"about": {"name": "completion", "dataset_id": "0123"}, "sha256": "0"})
    with pytest.raises(InputError, match=r"were trained on dataset 0123, these on feedfeedfeedfeed.*--weights RUN"):
        ship(own_run, lambda _: published, "0123abc")
    assert json.loads((published / "completion.json").read_text())["sha256"] == "0"
