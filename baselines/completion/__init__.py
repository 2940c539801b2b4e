"""Solid volumes of a part and of kits from one depth image: observed surfaces, completed by how parts and kits are.

`ObservedPart` and `ObservedKits` fill columns, without learning. The completion network learned from fresh parts: read
`frame` (its grid), `drawn_parts`, `views` and `occupancy` (its examples), `network`, and `task` (its training).
"""

from dataclasses import replace

from baselines.catalog import Network
from baselines.completion.kits import ObservedKits
from baselines.completion.part import TABLE_MARGIN, ObservedPart
from baselines.training.config import TrainConfig

__all__ = ["TABLE_MARGIN", "ObservedKits", "ObservedPart"]

SMALL = TrainConfig(
    steps=5600,
    batch=16,
    optimizer="muon",
    learning_rate=5e-3,
    warmup=100,
    decay="linear",
    weight_decay=0.05,
    ema_decay=0.998,
    mixed_precision="bfloat16",
    validate_every=500,
    checkpoint_every=250,
    workers=1,
    threads=1,
)
KITS = TrainConfig(
    steps=2500,
    batch=16,
    optimizer="muon",
    learning_rate=3e-3,
    warmup=100,
    decay="linear",
    weight_decay=0.05,
    ema_decay=0.997,
    mixed_precision="bfloat16",
    validate_every=500,
    checkpoint_every=100,
    workers=0,
    threads=1,
)
NETWORKS = {
    "completion": Network(
        "baselines.completion.task:completion_task",
        {
            "small": SMALL,
        },
    ),
    "kit-completion": Network(
        "baselines.completion.kit_task:kit_completion_task",
        {
            "small": KITS,
            "pretraining": replace(KITS, steps=3000, learning_rate=5e-3),
        },
        weights={"restoration": "restoration"},
    ),
}
