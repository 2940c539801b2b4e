"""TransporterNet in 6 DoF: features of the kits, correlated with those of the part, score positions and yaws.

After Zeng et al., "Transporter Networks" (CoRL 2020, arXiv 2010.14406), as a baseline of "Scene Editing as
Teleoperation".
"""

from baselines.catalog import Network, weight_paths
from baselines.training.config import TrainConfig
from kit1000.prediction.catalog import Method
from kit1000.queries.tracks import ALL_TRACKS, TRACKS

METHODS = {
    "transporter": Method(
        "baselines.transporter.method:Transporter",
        "TransporterNet, small preset: height maps of three cameras, no colour",
        tracks=tuple(name for name in ALL_TRACKS if name not in TRACKS or TRACKS[name].sensor == "ideal"),
        learned=True,
        training_data="split train of kit1000, data version 1.0.0",
        camera_set="three",
        weights=weight_paths({"network": "transporter"}),
        label="TransporterNet",
        paper_row="transporternet",
    ),
}

TRAINING = {
    "small": TrainConfig(
        steps=3_500,
        batch=1,
        learning_rate=1e-3,
        warmup=100,
        clip=1.0,
        ema_decay=0.998,
        mixed_precision="bfloat16",
        validate_every=500,
    ),
    "paper": TrainConfig(steps=100_000, batch=1, learning_rate=1e-4, decay="none", validate_every=1000),
}

NETWORKS = {"transporter": Network("baselines.transporter.examples:transporter_task", TRAINING)}
