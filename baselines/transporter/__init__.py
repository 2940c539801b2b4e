"""TransporterNet in 6 DoF: features of the kits, correlated with those of the part, score positions and yaws.

After Zeng et al., "Transporter Networks" (CoRL 2020, arXiv 2010.14406), as a baseline of "Scene Editing as
Teleoperation".
"""

from baselines.catalog import Network
from baselines.training.config import TrainConfig

TRAINING = {
    "small": TrainConfig(
        steps=6_000,
        batch=1,
        learning_rate=1e-3,
        warmup=100,
        clip=1.0,
        ema_decay=0.998,
        mixed_precision="bfloat16",
        validate_every=250,
    ),
    "paper": TrainConfig(steps=100_000, batch=1, learning_rate=1e-4, decay="none", validate_every=1000),
}

NETWORKS = {"transporter": Network("baselines.transporter.task:transporter_task", TRAINING)}
