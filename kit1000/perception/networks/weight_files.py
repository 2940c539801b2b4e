"""Weights of networks as safetensors with JSON: reading them executes nothing.

Weights are a pair NAME.safetensors and NAME.json, linked by a SHA-256.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from kit1000.errors import InputError, did_you_mean
from kit1000.files import read_json, write_bytes, write_json
from kit1000.perception.networks.precision import Precision, restored, stored

try:
    import torch
    from safetensors import SafetensorError
    from safetensors.torch import load, save
except ImportError:
    raise InputError("the networks need PyTorch and safetensors: pip install 'kit1000[learn]'") from None

LARGEST = 16 * 2**20  # [bytes] of weights that are shipped with the project

Tensors = dict[str, torch.Tensor]


def save_weights(
    stem: Path,
    model: torch.nn.Module,
    info: Mapping[str, Any],
    precision: Precision = "float32",
    largest: int | None = LARGEST,
) -> None:
    """Write the tensors of a network and the information about them; the JSON is written last.

    Args:
        stem: path without suffix: stem.safetensors and stem.json are written.
        info: as JSON has it; "sha256" is added.
        precision: of the numbers in the file.
        largest: [bytes] limit for the file of tensors; None: no limit.

    Raises:
        InputError: a larger file, or a number beyond the range of the precision.
    """
    save_tensors(stem, copied_state(model), info, precision, largest)


def save_tensors(
    stem: Path,
    tensors: Tensors,
    info: Mapping[str, Any],
    precision: Precision = "float32",
    largest: int | None = LARGEST,
) -> None:
    """As `save_weights`, of the tensors of a network by name."""
    path = _with_suffix(stem, ".safetensors")
    try:
        data = save(stored(tensors, precision))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    if largest is not None and len(data) > largest:
        size = f"{len(data) / 2**20:.1f} MiB of weights, more than the {largest / 2**20:.3g} MiB a file may have"
        raise InputError(f"{path}: {size}" + ("; precision='float16' halves them" if precision == "float32" else ""))
    write_json(_with_suffix(stem, ".json"), {**info, "sha256": write_bytes(path, data)})


def load_weights(stem: Path) -> tuple[Tensors, dict[str, Any]]:
    """Read what `save_weights` wrote: tensors by name, on the CPU, floats as float32; and the info.

    Raises:
        InputError: a file is missing or damaged, or the two do not belong together.
    """
    path, json_path = _with_suffix(stem, ".safetensors"), _with_suffix(stem, ".json")
    info = read_json(json_path)
    if not isinstance(info, dict) or "sha256" not in info:
        raise InputError(f"{json_path}: describes no weights")
    data = read_tensors_file(path)
    if hashlib.sha256(data).hexdigest() != info.pop("sha256"):
        raise InputError(f"{path}: damaged, or not the weights that {json_path.name} describes")
    return restored(loaded(path, data)), info


def load_into(model: torch.nn.Module, tensors: Mapping[str, torch.Tensor], where: str | Path) -> None:
    """Copy tensors into a network, on whatever device it is.

    Args:
        model: keeps its own types, devices and memory.
        tensors: with the names and shapes of its state.
        where: their source, for the message.

    Raises:
        InputError: a tensor is missing, unknown, or of another shape; then the network is unchanged.
    """
    own = model.state_dict()
    _check_names(own, tensors, where)
    for name, value in own.items():
        if value.shape != tensors[name].shape:
            shapes = f"{tuple(tensors[name].shape)}, in this network {tuple(value.shape)}"
            raise InputError(f"{where}: {name} has the shape {shapes}; is it of another config?")
    model.load_state_dict(tensors)


def copied_state(model: torch.nn.Module) -> Tensors:
    """Copies of the state of a network on the CPU, by name."""
    return {name: copied(value) for name, value in model.state_dict().items()}


def _with_suffix(stem: Path, suffix: str) -> Path:
    """The stem with a suffix appended: names may have dots, so none is replaced."""
    return stem.with_name(stem.name + suffix)


def copied(tensor: torch.Tensor) -> torch.Tensor:
    """A copy on the CPU in memory of its own: safetensors refuses shared memory."""
    return tensor.detach().to("cpu", copy=True).contiguous()


def _check_names(own: Mapping[str, Any], given: Mapping[str, Any], where: str | Path) -> None:
    if missing := sorted(set(own) - set(given)):
        raise InputError(f"{where}: has no {missing[0]}, which this network has ({len(missing)} such)")
    if foreign := sorted(set(given) - set(own)):
        hint = did_you_mean(foreign[0], own)
        raise InputError(f"{where}: has {foreign[0]}, which this network has not; {hint}({len(foreign)} such)")


def read_tensors_file(path: Path) -> bytes:
    """The bytes of a file; raises InputError if it cannot be read."""
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"no file {path}") from None
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error


def loaded(path: Path, data: bytes) -> Tensors:
    """The tensors in the bytes of a safetensors file; raises InputError if they are damaged."""
    try:
        return load(data)
    except (SafetensorError, ValueError, KeyError) as error:
        raise InputError(f"{path}: damaged, or no safetensors ({' '.join(str(error).split())})") from error
