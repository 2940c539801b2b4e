"""How the numbers of weights are stored: as float32, as float16, or as int8 with a scale for each row of a matrix.

It imports no PyTorch, so that the command line can name the precisions without loading it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Literal

from kit1000.errors import InputError

if TYPE_CHECKING:
    import torch

    Tensors = dict[str, torch.Tensor]

Precision = Literal["float32", "float16", "int8"]
"""float16: half the size, rounded by up to 1 in 2048; int8: a quarter, tensors of two or more axes rounded to 127ths of
the largest number of their row, the first axis."""
SCALE = ".int8-scale"  # suffix of the name of the scales of a tensor
MOST = 127  # of int8
LEAST = 1e-30  # least value that stands for the largest number of a row


def stored(tensors: Mapping[str, torch.Tensor], precision: Precision) -> Tensors:
    """Tensors by name as they are written; raises InputError for a number beyond the range."""
    written: Tensors = {}
    for name, value in tensors.items():
        if precision == "int8" and value.is_floating_point() and value.ndim >= 2:
            scale = value.abs().flatten(1).amax(1).clamp(min=LEAST) / MOST
            if not scale.isfinite().all():
                raise InputError(f"{name} has numbers that are not finite")
            written[name] = (value / _column(scale, value)).round().char()
            written[name + SCALE] = scale
        else:
            written[name] = _halved(name, value) if precision == "float16" else value
    return written


def restored(written: Mapping[str, torch.Tensor]) -> Tensors:
    """The tensors that `stored` was given, floats as float32."""
    tensors: Tensors = {}
    for name, value in written.items():
        if name + SCALE in written:
            scale = written[name + SCALE]
            tensors[name] = value.float() * _column(scale, value)
        elif not name.endswith(SCALE):
            tensors[name] = value.float() if value.is_floating_point() else value
    return tensors


def _column(scale: torch.Tensor, value: torch.Tensor) -> torch.Tensor:
    """Scales (n,) to multiply the rows of a tensor with."""
    return scale.view(-1, *[1] * (value.ndim - 1))


def _halved(name: str, tensor: torch.Tensor) -> torch.Tensor:
    if not tensor.is_floating_point():
        return tensor
    half = tensor.half()
    if (half.isinf() & tensor.isfinite()).any():
        raise InputError(f"{name} has numbers too large for float16")
    return half
