"""Training of the networks that restore noisy depth images: `views` (the examples), `crop_task`, `task`."""

from dataclasses import replace

from baselines.catalog import Network
from baselines.training.config import UNET_TRAINING

SMALL = replace(UNET_TRAINING, clip=1.0)
MEASURED = replace(SMALL, steps=5000, batch=64, learning_rate=3e-3, seed=3)
NETWORKS = {
    "restoration": Network(
        "baselines.training.tasks.restoration.task:restoration_task",
        {
            "small": replace(SMALL, steps=5000, learning_rate=3e-3, seed=1),
            "pretraining": SMALL,
            "measured": MEASURED,
            "large": replace(MEASURED, learning_rate=5e-3),
        },
    ),
    "restoration-unmasked": Network(
        "baselines.training.tasks.restoration.task:restoration_task",
        {
            "small": SMALL,
            "measured": MEASURED,
        },
        {"labelled": False},
    ),
}
