"""Instance masks of the kits and of each part from one depth image.

A noisy image is restored first, by a network that reads no masks (`baselines.restoration`), and another one tells its
parts apart; exact images need neither.

Read it in the order of the method: `bodies` (what stands on the table, and on which half), `pieces` (smooth surfaces
between steps and creases), `merging` (which pieces are of one part), `instances` (the masks), `queries` (queries with
these masks in place of the given ones). `fit` fits the weights of `merging` to the training split. In restored images
each pixel votes for the middle of its part: `network`, `views` (its examples), `task` (its training), `votes` (from
votes to parts) and `learned` (its use).
"""

from baselines.catalog import Network
from baselines.training.config import TrainConfig

NETWORKS = {
    "segmentation": Network(
        "baselines.segmentation.task:centres_task",
        {
            "small": TrainConfig(
                steps=3500,
                batch=16,
                optimizer="muon",
                learning_rate=5e-3,
                warmup=100,
                decay="linear",
                weight_decay=0.05,
                clip=1.0,
                ema_decay=0.997,
                mixed_precision="bfloat16",
                validate_every=500,
                checkpoint_every=100,
                workers=0,
                threads=1,
            ),
        },
        weights={"restoration": "restoration-unmasked"},
    ),
}
