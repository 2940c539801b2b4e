"""Solid volumes of a part and of kits from one depth image: observed surfaces, completed by how parts and kits are.

`ObservedPart` and `ObservedKits` fill columns, without learning. The completion network learned from fresh parts: read
`frame` (its grid), `drawn_parts`, `views` and `occupancy` (its examples), `network`, and `task` (its training).
"""

from dataclasses import replace

from baselines.catalog import Network
from baselines.completion.kits import ObservedKits
from baselines.completion.part import TABLE_MARGIN, ObservedPart
from baselines.training.config import UNET_TRAINING

__all__ = ["TABLE_MARGIN", "ObservedKits", "ObservedPart"]

SMALL = replace(UNET_TRAINING, steps=5600, ema_decay=0.998, checkpoint_every=250, workers=1)
KITS = replace(UNET_TRAINING, learning_rate=3e-3)
NETWORKS = {
    "completion": Network(
        "baselines.completion.task:completion_task",
        {
            "small": replace(SMALL, steps=6500, learning_rate=3e-3),
            "pretraining": SMALL,
        },
    ),
    "completion-d415": Network(
        "baselines.completion.task:completion_task",
        {
            "small": replace(SMALL, steps=4000, learning_rate=2e-3, seed=2),
        },
        {"d415_share": 1.0},
    ),
    "kit-completion": Network(
        "baselines.completion.kit_task:kit_completion_task",
        {
            "small": replace(KITS, steps=4000),
            "pretraining": replace(KITS, steps=3000, learning_rate=5e-3),
            "pretraining-2": replace(KITS, steps=2500),
        },
        weights={"restoration": "restoration"},
    ),
}
