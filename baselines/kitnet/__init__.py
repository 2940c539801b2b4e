"""KitNet: a network that turns a part into its slot, from one depth view of each.

After Devgon et al., "Kit-Net" (CASE 2021, arXiv 2107.05789), as a baseline of "Scene Editing as Teleoperation".
"""

from baselines.catalog import Network
from baselines.training.config import TrainConfig

TRAINING = {
    "small": TrainConfig(
        steps=3_000,
        batch=32,
        learning_rate=2e-3,
        warmup=200,
        clip=1.0,
        ema_decay=0.998,
        mixed_precision="bfloat16",
        validate_every=500,
    ),
    "paper": TrainConfig(steps=100_000, batch=12, learning_rate=2e-3, decay="none", validate_every=1000),
}
TASK = "baselines.kitnet.task:kitnet_task"

NETWORKS = {"kitnet": Network("baselines.kitnet.task:kitnet_task", TRAINING)}
