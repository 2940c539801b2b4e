"""Networks read from their weights, ready to predict on the CPU, on which the last digits are known."""

from __future__ import annotations

from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

import numpy as np
import torch

from kit1000.errors import InputError
from kit1000.perception.networks.unet import folded, in_float64
from kit1000.perception.networks.weight_files import load_into, load_weights

FORMER = frozenset(
    ("views", "views_seed", "parts", "parts_seed", "d415_share", "drawn_share", "drawn_kits", "stretched_share")
    + ("sensor_model", "level", "weight", "flag", "candidates")
)
"""Values that files of weights name from when configs had them: of training alone, or the same in all networks."""


def ready(net: Any, config: type, make: type) -> Any:
    """A network in evaluation mode, read from its weights if a path is given.

    Args:
        net: the network, or the stem of its weights.
        config: the class of its config, a flat dataclass. The file of weights names its values; those that an older
            file lacks have their defaults, and those that it has beside them are FORMER ones.
        make: the network's class, called with a config.

    Raises:
        InputError: damaged weights, or those of another network.
    """
    if not isinstance(net, Path):
        return net.eval()
    tensors, info = load_weights(net)
    about = info.get("about", {}).get("network", {})
    values = {name: value for name, value in about.items() if name not in FORMER}
    needed = {field.name for field in fields(config) if field.default is MISSING}
    differing = (set(values) - {field.name for field in fields(config)}) | (needed - set(values))
    if differing:
        raise InputError(f"{net}.json: no config of a {make.__name__}: it differs in {', '.join(sorted(differing))}")
    made = make(config(**{name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}))
    load_into(made, tensors, net)
    return made.to("cuda" if torch.cuda.is_available() else "cpu").eval()


def on_cpu(net: Any, config: type, make: type, fold: bool = True, exact: bool = False) -> Any:
    """A network that predicts on the CPU; arguments: see `ready`.

    Args:
        net: the network, or the stem of its weights.
        config: the class of its config.
        make: the network's class.
        fold: whether its batch normalisation is folded into its convolutions.
        exact: whether it calculates in float64. Of 399 predictions from images restored in float32 a quarter depended
            on the processor, by up to 2 mm, because about one pixel in 200,000 was rounded otherwise.
    """
    net = ready(net, config, make)
    net = (folded(net) if fold else net).to("cpu")
    return in_float64(net) if exact else net.to(memory_format=torch.channels_last)


def on_grid(values: np.ndarray, step: float) -> np.ndarray:
    """Values rounded to multiples of a step: the last digits of sums depend on the processor."""
    return np.rint(values / step) * step


def with_mirror(values: np.ndarray) -> torch.Tensor:
    """(2, ...): values and their mirror image along the second axis."""
    return torch.from_numpy(np.stack([values, values[:, ::-1]]))
