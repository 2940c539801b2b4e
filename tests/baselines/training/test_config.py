"""Settings of training runs: the learning rate over the steps, and numbers that are refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from baselines.training.config import TrainConfig
from kit1000.errors import InputError


def test_the_learning_rate_rises_then_falls() -> None:
    config = TrainConfig(steps=110, warmup=10, learning_rate=1.0)
    rates = [config.learning_rate_at(step) for step in range(110)]
    assert rates[:11] == pytest.approx([(i + 1) / 11 for i in range(10)] + [1.0])
    assert rates[60] == pytest.approx(0.5)
    assert np.all(np.diff(rates[10:]) < 0)
    assert 0 < rates[-1] < 1e-3
    assert replace(config, decay="linear").learning_rate_at(85) == pytest.approx(0.25)
    assert replace(config, decay="none").learning_rate_at(109) == 1.0


INVALID = {"steps": 0, "batch": -1, "learning_rate": 0.0, "ema_decay": 1.0, "clip": 0.0, "workers": -1}


@pytest.mark.parametrize(("name", "value"), INVALID.items())
def test_invalid_numbers_are_refused(name: str, value: Any) -> None:
    with pytest.raises(InputError, match=f"{name}: expected"):
        TrainConfig(**{name: value})
