"""Weights of networks, and states of training runs, as safetensors with JSON: arrays and words, nothing that runs.

Weights are a pair NAME.safetensors and NAME.json that belong together by a SHA-256. A state is one file, which is there
entirely or not at all: the JSON stands in its header, so tensors and words are never of different steps.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from kit1000.errors import InputError, did_you_mean
from kit1000.files import read_json, write_bytes, write_json

try:
    import torch
    from safetensors import SafetensorError
    from safetensors.torch import load, save
except ImportError:
    raise InputError("the networks need PyTorch and safetensors: pip install 'kit1000[learn]'") from None

LARGEST = 16 * 2**20  # [bytes] of weights that travel with the project
PARTS = ("model", "average", "optimizer")
"""Of a state, each a prefix of its tensors' names."""

Tensors = dict[str, torch.Tensor]


def save_weights(
    stem: Path, model: torch.nn.Module, info: Mapping[str, Any], half: bool = False, largest: int | None = LARGEST
) -> None:
    """Write the tensors of a network and what is to be said about them; the JSON comes last.

    Args:
        stem: path without suffix: stem.safetensors and stem.json are written.
        info: as JSON has it; "sha256" is added.
        half: as float16, half as long and rounded by up to 1 in 2048.
        largest: [bytes] the file of tensors may have; any number when None.

    Raises:
        InputError: a file longer than that, or a number that float16 cannot hold.
    """
    path = _beside(stem, ".safetensors")
    data = save({name: _halved(path, name, value) if half else value for name, value in stored(model).items()})
    if largest is not None and len(data) > largest:
        sizes = f"{len(data) / 2**20:.1f} MiB of weights, more than the {largest / 2**20:.3g} MiB a file may have"
        raise InputError(f"{path}: {sizes}" + ("" if half else "; half=True halves them"))
    write_json(_beside(stem, ".json"), {**info, "sha256": write_bytes(path, data)})


def load_weights(stem: Path) -> tuple[Tensors, dict[str, Any]]:
    """Read what `save_weights` wrote: tensors by name, on the CPU, floats as float32; and the info.

    Raises:
        InputError: a file is missing or damaged, or the two do not belong together.
    """
    path, words = _beside(stem, ".safetensors"), _beside(stem, ".json")
    info = read_json(words)
    if not isinstance(info, dict) or "sha256" not in info:
        raise InputError(f"{words}: tells of no weights")
    data = _read(path)
    if hashlib.sha256(data).hexdigest() != info.pop("sha256"):
        raise InputError(f"{path}: damaged, or not the weights that {words.name} tells of")
    tensors = _loaded(path, data)
    return {name: value.float() if value.is_floating_point() else value for name, value in tensors.items()}, info


def fill(model: torch.nn.Module, tensors: Mapping[str, torch.Tensor], where: str | Path) -> None:
    """Put tensors into a network, on whatever device it is.

    Args:
        model: keeps its own types, devices and memory.
        tensors: as many and of the same names and sizes as its state.
        where: they come from, for the message.

    Raises:
        InputError: a tensor is missing, is too many, or has another size; then the network is unchanged.
    """
    own = model.state_dict()
    _check_names(own, tensors, where)
    for name, value in own.items():
        if value.shape != tensors[name].shape:
            sizes = f"{tuple(tensors[name].shape)}, in this network {tuple(value.shape)}"
            raise InputError(f"{where}: {name} has the shape {sizes}; is it of another configuration?")
    model.load_state_dict(tensors)


def stored(model: torch.nn.Module) -> Tensors:
    """Copies of the state of a network on the CPU, by name."""
    return {name: _apart(value) for name, value in model.state_dict().items()}


def write_state(path: Path, parts: Mapping[str, Mapping[str, torch.Tensor]], words: Mapping[str, Any]) -> None:
    """Write a state of a run in one go, with a checksum over tensors and words.

    Args:
        parts: tensors by name, under some of PARTS.
        words: as JSON has it.
    """
    tensors = {f"{part}.{name}": _apart(value) for part, named in parts.items() for name, value in named.items()}
    text = json.dumps(words, sort_keys=True, allow_nan=False)
    digest = _digest(text, save(tensors))
    write_bytes(path, save(tensors, {"words": text, "sha256": digest}))


def read_state(path: Path) -> tuple[dict[str, Tensors], dict[str, Any]]:
    """Read what `write_state` wrote: all PARTS, empty where there is none, and the words.

    Raises:
        InputError: the file is missing, damaged, or of another kind.
    """
    data = _read(path)
    parts: dict[str, Tensors] = {part: {} for part in PARTS}
    try:
        header = json.loads(data[8 : _body(data)])["__metadata__"]
        text, digest = header["words"], header["sha256"]
    except (ValueError, LookupError, TypeError):
        raise InputError(f"{path}: no checkpoint of a training run, or damaged: delete it to begin anew") from None
    if digest != _digest(text, data):
        raise InputError(f"{path}: damaged: delete it to begin anew")
    for name, value in _loaded(path, data).items():
        part, _, rest = name.partition(".")
        parts.setdefault(part, {})[rest] = value
    return parts, json.loads(text)


def optimizer_tensors(model: torch.nn.Module, optimizer: torch.optim.Optimizer) -> Tensors:
    """What an optimizer remembers of each parameter, named `exp_avg.` and so on and the parameter's name."""
    names: dict[torch.Tensor, str] = {parameter: name for name, parameter in model.named_parameters()}
    return {
        f"{kind}.{names[parameter]}": value
        for parameter, kinds in optimizer.state.items()
        for kind, value in kinds.items()
    }


def fill_optimizer(
    model: torch.nn.Module, optimizer: torch.optim.Optimizer, tensors: Mapping[str, torch.Tensor], where: str | Path
) -> None:
    """Let an optimizer remember what `optimizer_tensors` gave; raises InputError for what is of another network."""
    parameters = dict(model.named_parameters())
    places = {
        parameter: i for i, parameter in enumerate(p for group in optimizer.param_groups for p in group["params"])
    }
    state: dict[int, Tensors] = {}
    for name, value in tensors.items():
        kind, _, of = name.partition(".")
        if of not in parameters or value.shape not in ((), parameters[of].shape):
            raise InputError(f"{where}: the optimizer's {name} fits no parameter of this network")
        state.setdefault(places[parameters[of]], {})[kind] = value.clone()  # an optimizer writes into what it is given
    optimizer.load_state_dict({"state": state, "param_groups": optimizer.state_dict()["param_groups"]})


def _beside(stem: Path, suffix: str) -> Path:
    """Names may hold dots, so no suffix of theirs is replaced."""
    return stem.with_name(stem.name + suffix)


def _apart(tensor: torch.Tensor) -> torch.Tensor:
    """On the CPU, on memory of its own: safetensors refuses what is shared."""
    return tensor.detach().to("cpu", copy=True).contiguous()


def _halved(path: Path, name: str, tensor: torch.Tensor) -> torch.Tensor:
    if not tensor.is_floating_point():
        return tensor
    half = tensor.half()
    if (half.isinf() & tensor.isfinite()).any():
        raise InputError(f"{path}: {name} holds numbers that are too large for float16")
    return half


def _check_names(own: Mapping[str, Any], given: Mapping[str, Any], where: str | Path) -> None:
    if missing := sorted(set(own) - set(given)):
        raise InputError(f"{where}: holds no {missing[0]}, which this network has ({len(missing)} such)")
    if foreign := sorted(set(given) - set(own)):
        hint = did_you_mean(foreign[0], own)
        raise InputError(f"{where}: holds {foreign[0]}, which this network has not; {hint}({len(foreign)} such)")


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
    """Where the tensors of a safetensors file begin: after eight bytes of length and as many of header."""
    return 8 + int.from_bytes(data[:8], "little")


def _digest(text: str, data: bytes) -> str:
    """SHA-256 over the words of a state and the bytes of its tensors, which the words in the header do not move."""
    digest = hashlib.sha256(text.encode())
    digest.update(memoryview(data)[_body(data) :])
    return digest.hexdigest()
