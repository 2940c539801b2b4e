"""What methods read of a noisy depth image: calibrated by its table, its shadows closed, its edges where they are.

`edges` does so by rules, without learning. A network learned it from fresh views of the scenes of the train split: read
`disparity` (what it reads), `views` (its examples), `network`, `crop_task` and `task` (its training), `learned` (its
use).
"""

from dataclasses import replace

from baselines.catalog import Network
from baselines.restoration.edges import calibrated_image, restored, restored_edges, restored_query
from baselines.training.config import UNET_TRAINING

__all__ = ["calibrated_image", "restored", "restored_edges", "restored_query"]

SMALL = replace(UNET_TRAINING, clip=1.0)
NETWORKS = {
    "restoration": Network(
        "baselines.restoration.task:restoration_task",
        {
            "small": replace(SMALL, steps=5000, learning_rate=3e-3, seed=1),
            "pretraining": SMALL,
        },
    ),
    "restoration-unmasked": Network(
        "baselines.restoration.task:restoration_task",
        {
            "small": SMALL,
        },
        {"labelled": False},
    ),
}
