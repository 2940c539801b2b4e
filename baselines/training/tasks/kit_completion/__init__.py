"""Training of the network that completes kits: `sampled_kits` and `views` (the examples), `task`."""

from dataclasses import replace

from baselines.catalog import Network
from baselines.training.config import UNET_TRAINING

KITS = replace(UNET_TRAINING, learning_rate=3e-3)
NETWORKS = {
    "kit-completion": Network(
        "baselines.training.tasks.kit_completion.task:kit_completion_task",
        {
            "small": replace(KITS, steps=4000),
            "pretraining": replace(KITS, steps=3000, learning_rate=5e-3),
            "pretraining-2": replace(KITS, steps=2500),
            "measured": replace(KITS, steps=3000, seed=3),
        },
        weights={"restoration": "restoration"},
    ),
}
