"""States of training runs as safetensors with JSON: reading them executes nothing.

A state is one file, written whole or not at all: its JSON is in the header, so tensors and JSON are never of different
steps.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save

from kit1000.errors import InputError
from kit1000.files import write_bytes
from kit1000.perception.networks.weight_files import Tensors, copied, loaded, read_tensors_file

GROUPS = ("model", "average", "optimizer")
"""Groups of a state's tensors: each is a prefix of their names."""


def write_state(path: Path, groups: Mapping[str, Mapping[str, torch.Tensor]], info: Mapping[str, Any]) -> None:
    """Write the state of a run as one file, with a checksum over tensors and JSON.

    Args:
        path: of the file.
        groups: tensors by name, under some of GROUPS.
        info: as JSON has it.
    """
    tensors = {f"{group}.{name}": copied(value) for group, named in groups.items() for name, value in named.items()}
    text = json.dumps(info, sort_keys=True, allow_nan=False)
    digest = _digest(text, save(tensors))
    write_bytes(path, save(tensors, {"info": text, "sha256": digest}))


def read_state(path: Path) -> tuple[dict[str, Tensors], dict[str, Any]]:
    """Read what `write_state` wrote: all GROUPS, empty where there is none, and the info.

    Raises:
        InputError: the file is missing, damaged, or of another kind.
    """
    data = read_tensors_file(path)
    groups: dict[str, Tensors] = {group: {} for group in GROUPS}
    try:
        header = json.loads(data[8 : _body(data)])["__metadata__"]
        text, digest = header["info"], header["sha256"]
    except (ValueError, LookupError, TypeError):
        raise InputError(f"{path}: no checkpoint of a training run, or damaged: delete it to begin anew") from None
    if digest != _digest(text, data):
        raise InputError(f"{path}: damaged: delete it to begin anew")
    for name, value in loaded(path, data).items():
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


def _body(data: bytes) -> int:
    """Offset of the tensors in a safetensors file: eight bytes of header length, then the header."""
    return 8 + int.from_bytes(data[:8], "little")


def _digest(text: str, data: bytes) -> str:
    """SHA-256 over the JSON of a state and the bytes of its tensors, which do not depend on the header."""
    digest = hashlib.sha256(text.encode())
    digest.update(memoryview(data)[_body(data) :])
    return digest.hexdigest()
