"""Training of the network that fills holes in a scanner's image: `views` (the examples), `task`."""

from dataclasses import replace

from baselines.catalog import Network
from baselines.training.config import UNET_TRAINING

PRETRAINING = replace(UNET_TRAINING, clip=1.0, steps=3000)
NETWORKS = {
    "hole-filling": Network(
        "baselines.training.tasks.hole_filling.task:hole_filling_task",
        {
            "small": replace(PRETRAINING, steps=4000, learning_rate=3e-3, seed=1),
            "pretraining": PRETRAINING,
        },
    ),
}
