"""What methods read of a noisy depth image: calibrated by its table, its shadows closed, its edges where they are.

`edges` does so by rules, without learning. A network learned it from fresh views of the scenes of the train split: read
`disparity` (what it reads), `views` (its examples), `network`, `task` (its training) and `learned` (its use).
"""

from baselines.catalog import Network
from baselines.restoration.edges import calibrated_image, restored, restored_edges, restored_query
from baselines.training.config import TrainConfig

__all__ = ["calibrated_image", "restored", "restored_edges", "restored_query"]

SMALL = TrainConfig(
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
)
NETWORKS = {
    "restoration": Network(
        "baselines.restoration.task:restoration_task",
        {
            "small": SMALL,
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
