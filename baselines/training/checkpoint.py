"""The state of a training run as one file, which is written whole or not at all; reading it executes nothing."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from kit1000.errors import InputError
from kit1000.files import write_bytes
from kit1000.perception.networks.weight_files import read_tensors_file


def write_state(path: Path, state: Mapping[str, Any]) -> None:
    """Write a state: tensors, numbers, texts, and dicts and lists of them."""
    data = io.BytesIO()
    torch.save(dict(state), data)
    write_bytes(path, data.getvalue())


def read_state(path: Path) -> dict[str, Any]:
    """Read what `write_state` wrote, with all tensors on the CPU.

    Raises:
        InputError: the file cannot be read, is damaged, or holds more than `torch.load(weights_only=True)` accepts.
    """
    data = read_tensors_file(path)
    try:
        state = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except Exception:  # PyTorch raises errors of many kinds for damaged files
        raise InputError(f"{path}: damaged, or no checkpoint of a training run: delete it to begin anew") from None
    if not isinstance(state, dict) or "settings" not in state:
        raise InputError(f"{path}: no checkpoint of a training run: delete it to begin anew")
    return state
