"""Networks of methods, read from their weights."""

from __future__ import annotations

from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

import torch

from kit1000.errors import InputError
from kit1000.perception.networks.weight_files import load_into, load_weights


def ready(net: Any, config: type, make: type) -> Any:
    """A network in evaluation mode; read from the stem of its weights where a path is given.

    Args:
        net: the network, or the path.
        config: the class of its config, a flat dataclass whose values the file of weights names; what an older file
            does not name is at its default.
        make: the network's class, called with a config.

    Raises:
        InputError: damaged weights, or those of another network.
    """
    if not isinstance(net, Path):
        return net.eval()
    tensors, info = load_weights(net)
    values = info.get("about", {}).get("network", {})
    needed = {field.name for field in fields(config) if field.default is MISSING}
    differing = (set(values) - {field.name for field in fields(config)}) | (needed - set(values))
    if differing:
        raise InputError(f"{net}.json: no config of a {make.__name__}: it differs in {', '.join(sorted(differing))}")
    made = make(config(**{name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}))
    load_into(made, tensors, net)
    return made.to("cuda" if torch.cuda.is_available() else "cpu").eval()
