"""Training of the network that places fits: `placed_fits` (kept in files), `changes` (drawn anew), `task`."""

from dataclasses import replace

from baselines.catalog import Network
from baselines.training.config import UNET_TRAINING

NETWORKS = {
    "placement": Network(
        "baselines.training.tasks.placement.task:placement_task",
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
