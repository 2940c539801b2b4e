"""Training of the networks that complete parts: `sampled_parts` and `views` (the examples), `task`."""

from dataclasses import replace

from baselines.catalog import Network
from baselines.training.config import UNET_TRAINING

SMALL = replace(UNET_TRAINING, steps=5600, ema_decay=0.998, checkpoint_every=250, workers=1)
NETWORKS = {
    "completion": Network(
        "baselines.training.tasks.part_completion.task:completion_task",
        {
            "small": replace(SMALL, steps=6500, learning_rate=3e-3),
            "pretraining": SMALL,
        },
    ),
    "completion-d415": Network(
        "baselines.training.tasks.part_completion.task:completion_task",
        {
            "small": replace(SMALL, steps=4000, learning_rate=2e-3, seed=2),
            "measured": replace(SMALL, steps=4000, batch=64, learning_rate=2e-3, seed=3),
        },
        {"d415_share": 1.0},
    ),
}
