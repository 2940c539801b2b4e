"""KitNet: a network that rotates a part into its slot, from one depth view of each.

After Devgon et al., "Kit-Net" (CASE 2021, arXiv 2107.05789), as a baseline of "Scene Editing as Teleoperation".
"""

from dataclasses import replace

from baselines.catalog import Network, weight_paths
from baselines.training.config import TrainConfig
from kit1000.prediction.catalog import Method

KITNET = Method(
    "baselines.kitnet.method:KitNetMethod",
    "KitNet, small preset: from 12 yaws, the best overlap with a cavity; rotations alone",
    options={"position": "none"},
    tracks=("place", "place-paper"),
    learned=True,
    predicts="rotation",
    training_data="split train of kit1000, data version 1.0.0",
    camera_set="three",
    weights=weight_paths({"network": "kitnet"}),
    label="KitNet",
    paper_row="kitnet",
)
METHODS = {
    "kitnet": KITNET,
    "kitnet-centroid": replace(
        KITNET,
        description="KitNet, and the centroid of the part over that of the cavity",
        options={"position": "centroid"},
        predicts="pose",
        label="KitNet, centroids",
        paper_row="",
    ),
    "kitnet-guess": replace(
        KITNET,
        description="KitNet from the guess, and the centroid of the part over that of the nearest cavity",
        options={"position": "centroid"},
        tracks=("snap", "snap-tilt", "curves"),
        predicts="pose",
        label="KitNet from the guess, centroids",
        paper_row="",
    ),
}

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
NETWORKS = {"kitnet": Network("baselines.kitnet.examples:kitnet_task", TRAINING)}
