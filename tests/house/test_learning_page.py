"""The Python on the page about learning: it runs, and its network learns."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import torch

from kit1000.dataset.reader import Dataset, Split
from kit1000.dataset.torch import QueryDataset
from tests.samples.checkout import ROOT


@pytest.fixture(scope="module")
def data(mini: Path) -> Dataset:
    """A recorded dataset of four scenes."""
    return Dataset(mini)


@pytest.fixture(scope="module")
def train(data: Dataset) -> Split:
    return data.split("train", truth=True)


def code_blocks() -> tuple[str, ...]:
    """The Python blocks of the page: a training loop, and your own item."""
    text = (ROOT / "docs/guides/write-a-method.md").read_text(encoding="utf-8")
    return tuple(re.findall(r"^```py\n(.*?)^```", text, re.MULTILINE | re.DOTALL))


def test_the_example_of_an_own_item_works(train: Split) -> None:
    _, own = code_blocks()
    exec(own, names := {})
    for item in QueryDataset(train, "snap", names["part_crop"]):
        assert item["crop"].shape == (128, 128)
        assert (item["crop"] > 0).any()


def test_the_example_network_learns(
    data: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tiny").symlink_to(data.root)
    torch.manual_seed(0)
    example, _ = code_blocks()
    exec(example, {})
    losses = [float(line.split()[2]) for line in capsys.readouterr().out.splitlines()]
    assert losses[0] > 15  # [mm] about the error of the guess
    assert losses[-1] < losses[0] / 2
