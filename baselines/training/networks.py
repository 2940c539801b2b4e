"""The networks of perception and registration: how each is trained, by preset."""

from __future__ import annotations

from dataclasses import replace

from baselines.catalog import Network
from baselines.training.config import UNET_TRAINING

PARTS = replace(UNET_TRAINING, steps=5600, ema_decay=0.998, checkpoint_every=250, workers=1)
KITS = replace(UNET_TRAINING, learning_rate=3e-3)
CLIPPED = replace(UNET_TRAINING, clip=1.0)
MEASURED = replace(CLIPPED, steps=5000, batch=64, learning_rate=3e-3, seed=3)
PRETRAINING = replace(UNET_TRAINING, clip=1.0, steps=3000)

NETWORKS = {
    "completion": Network(
        "baselines.training.tasks.part_completion:completion_task",
        {
            "small": replace(PARTS, steps=6500, learning_rate=3e-3),
            "pretraining": PARTS,
        },
    ),
    "completion-d415": Network(
        "baselines.training.tasks.part_completion:completion_task",
        {
            "small": replace(PARTS, steps=4000, learning_rate=2e-3, seed=2),
            "measured": replace(PARTS, steps=4000, batch=64, learning_rate=2e-3, seed=3),
        },
        {"d415_share": 1.0},
    ),
    "kit-completion": Network(
        "baselines.training.tasks.kit_completion:kit_completion_task",
        {
            "small": replace(KITS, steps=4000),
            "pretraining": replace(KITS, steps=3000, learning_rate=5e-3),
            "pretraining-2": replace(KITS, steps=2500),
        },
        weights={"restoration": "restoration"},
    ),
    "restoration": Network(
        "baselines.training.tasks.restoration:restoration_task",
        {
            "small": replace(CLIPPED, steps=5000, learning_rate=3e-3, seed=1),
            "pretraining": CLIPPED,
            "measured": MEASURED,
        },
    ),
    "restoration-unmasked": Network(
        "baselines.training.tasks.restoration:restoration_task",
        {
            "small": CLIPPED,
            "measured": MEASURED,
        },
        {"labelled": False},
    ),
    "hole-filling": Network(
        "baselines.training.tasks.hole_filling:hole_filling_task",
        {
            "small": replace(PRETRAINING, steps=4000, learning_rate=3e-3, seed=1),
            "pretraining": PRETRAINING,
        },
    ),
    "segmentation": Network(
        "baselines.training.tasks.segmentation:centres_task",
        {
            "small": replace(CLIPPED, steps=4500, learning_rate=3e-3, seed=1),
            "pretraining": CLIPPED,
            "measured": replace(CLIPPED, steps=4000, batch=64, learning_rate=3e-3, seed=3),
            "hard": replace(CLIPPED, steps=1500, batch=32, learning_rate=1e-3, seed=4, mixed_precision="off"),
        },
        weights={"restoration": "restoration-unmasked"},
    ),
    "placement": Network(
        "baselines.training.tasks.placement:placement_task",
        {
            "small": replace(
                UNET_TRAINING,
                steps=900,
                batch=32,
                warmup=50,
                clip=1.0,
                ema_decay=0.98,
                mixed_precision="off",  # the least squares want all digits
                validate_every=900,  # the last weights are shipped
                threads=None,
            )
        },
        weights={"completion": "completion-d415", "restoration": "restoration"},
    ),
}
