"""Weights of networks, and states of training runs, as safetensors with JSON: reading them executes nothing.

Weights are a pair NAME.safetensors and NAME.json, linked by a SHA-256. A state is one file, written whole or not at
all: its JSON is in the header, so tensors and JSON are never of different steps.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from baselines.training.precision import Precision, restored, stored
from kit1000.errors import InputError, did_you_mean
from kit1000.files import read_json, write_bytes, write_json

try:
    import torch
    from safetensors import SafetensorError
    from safetensors.torch import load, save
except ImportError:
    raise InputError("the networks need PyTorch and safetensors: pip install 'kit1000[learn]'") from None

LARGEST = 16 * 2**20  # [bytes] of weights that are shipped with the project
GROUPS = ("model", "average", "optimizer")
"""Of a state's tensors: each is a prefix of their names."""

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
    data = _read(path)
    if hashlib.sha256(data).hexdigest() != info.pop("sha256"):
        raise InputError(f"{path}: damaged, or not the weights that {json_path.name} describes")
    return restored(_loaded(path, data)), info


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
    return {name: _copied(value) for name, value in model.state_dict().items()}


def write_state(path: Path, groups: Mapping[str, Mapping[str, torch.Tensor]], info: Mapping[str, Any]) -> None:
    """Write the state of a run as one file, with a checksum over tensors and JSON.

    Args:
        path: of the file.
        groups: tensors by name, under some of GROUPS.
        info: as JSON has it.
    """
    tensors = {f"{group}.{name}": _copied(value) for group, named in groups.items() for name, value in named.items()}
    text = json.dumps(info, sort_keys=True, allow_nan=False)
    digest = _digest(text, save(tensors))
    write_bytes(path, save(tensors, {"info": text, "sha256": digest}))


def read_state(path: Path) -> tuple[dict[str, Tensors], dict[str, Any]]:
    """Read what `write_state` wrote: all GROUPS, empty where there is none, and the info.

    Raises:
        InputError: the file is missing, damaged, or of another kind.
    """
    data = _read(path)
    groups: dict[str, Tensors] = {group: {} for group in GROUPS}
    try:
        header = json.loads(data[8 : _body(data)])["__metadata__"]
        text, digest = header["info"], header["sha256"]
    except (ValueError, LookupError, TypeError):
        raise InputError(f"{path}: no checkpoint of a training run, or damaged: delete it to begin anew") from None
    if digest != _digest(text, data):
        raise InputError(f"{path}: damaged: delete it to begin anew")
    for name, value in _loaded(path, data).items():
        group, _, rest = name.partition(".")
        groups.setdefault(group, {})[rest] = value
    return groups, json.loads(text)


def optimizer_tensors(model: torch.nn.Module, optimizer: torch.optim.Optimizer) -> Tensors:
    """The state of an optimizer for each parameter, named by its kind, such as `exp_avg`, and the parameter."""
    names: dict[torch.Tensor, str] = {parameter: name for name, parameter in model.named_parameters()}
    return {
        f"{kind}.{names[parameter]}": value
        for parameter, kinds in optimizer.state.items()
        for kind, value in kinds.items()
    }


def load_into_optimizer(
    model: torch.nn.Module, optimizer: torch.optim.Optimizer, tensors: Mapping[str, torch.Tensor], where: str | Path
) -> None:
    """Restore an optimizer from `optimizer_tensors`; raises InputError where they are of another network."""
    parameters = dict(model.named_parameters())
    index_of = {
        parameter: i for i, parameter in enumerate(p for group in optimizer.param_groups for p in group["params"])
    }
    state: dict[int, Tensors] = {}
    for name, value in tensors.items():
        kind, _, of = name.partition(".")
        if of not in parameters or value.shape not in ((), parameters[of].shape):
            raise InputError(f"{where}: the optimizer's {name} fits no parameter of this network")
        state.setdefault(index_of[parameters[of]], {})[kind] = value.clone()  # an optimizer writes into its state
    optimizer.load_state_dict({"state": state, "param_groups": optimizer.state_dict()["param_groups"]})


def _with_suffix(stem: Path, suffix: str) -> Path:
    """The stem with a suffix appended: names may have dots, so none is replaced."""
    return stem.with_name(stem.name + suffix)


def _copied(tensor: torch.Tensor) -> torch.Tensor:
    """A copy on the CPU in memory of its own: safetensors refuses shared memory."""
    return tensor.detach().to("cpu", copy=True).contiguous()


def _check_names(own: Mapping[str, Any], given: Mapping[str, Any], where: str | Path) -> None:
    if missing := sorted(set(own) - set(given)):
        raise InputError(f"{where}: has no {missing[0]}, which this network has ({len(missing)} such)")
    if foreign := sorted(set(given) - set(own)):
        hint = did_you_mean(foreign[0], own)
        raise InputError(f"{where}: has {foreign[0]}, which this network has not; {hint}({len(foreign)} such)")


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"no file {path}") from None
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error


def _loaded(path: Path, data: bytes) -> Tensors:
    try:
        return load(data)
    except (SafetensorError, ValueError, KeyError) as error:
        raise InputError(f"{path}: damaged, or no safetensors ({' '.join(str(error).split())})") from error


def _body(data: bytes) -> int:
    """Offset of the tensors in a safetensors file: eight bytes of header length, then the header."""
    return 8 + int.from_bytes(data[:8], "little")


def _digest(text: str, data: bytes) -> str:
    """SHA-256 over the JSON of a state and the bytes of its tensors, which do not depend on the header."""
    digest = hashlib.sha256(text.encode())
    digest.update(memoryview(data)[_body(data) :])
    return digest.hexdigest()
