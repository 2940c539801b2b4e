"""Training of the network that separates parts: `views` (the examples), `task`; and `fit`, of the merging weights."""

from dataclasses import replace

from baselines.catalog import Network
from baselines.training.config import UNET_TRAINING

SMALL = replace(UNET_TRAINING, clip=1.0)
NETWORKS = {
    "segmentation": Network(
        "baselines.training.tasks.segmentation.task:centres_task",
        {
            "small": replace(SMALL, steps=4500, learning_rate=3e-3, seed=1),
            "pretraining": SMALL,
            "measured": replace(SMALL, steps=4000, batch=64, learning_rate=3e-3, seed=3),
        },
        weights={"restoration": "restoration-unmasked"},
    ),
}
