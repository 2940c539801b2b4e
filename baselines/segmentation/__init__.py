"""Instance masks of the kits and of each part from one depth image.

A noisy image is restored first, by a network that reads no masks (`baselines.restoration`), and another one tells its
parts apart; exact images need neither.

Read it in the order of the method: `bodies` (what stands on the table, and on which half), `pieces` (smooth surfaces
between steps and creases), `merging` (which pieces are of one part), `instances` (the masks), `queries` (queries with
these masks in place of the given ones). `fit` fits the weights of `merging` to the training split. In restored images
each pixel votes for the middle of its part: `network`, `views` (its examples), `task` (its training), `votes` (from
votes to parts) and `learned` (its use).
"""

from dataclasses import replace

from baselines.catalog import Network
from baselines.training.config import UNET_TRAINING

SMALL = replace(UNET_TRAINING, clip=1.0)
NETWORKS = {
    "segmentation": Network(
        "baselines.segmentation.task:centres_task",
        {
            "small": replace(SMALL, steps=4500, learning_rate=3e-3, seed=1),
            "pretraining": SMALL,
        },
        weights={"restoration": "restoration-unmasked"},
    ),
}
