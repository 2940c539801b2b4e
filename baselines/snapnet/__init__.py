"""SnapNet: two networks that correct a guess, its position by cross-correlation of volumes, its rotation from points.

After "Scene Editing as Teleoperation" (IROS 2022, arXiv 2110.04450).
"""

from dataclasses import replace

from baselines.catalog import Network, weight_paths
from baselines.training.config import TrainConfig
from kit1000.prediction.catalog import Method
from kit1000.queries.tracks import ALL_TRACKS

GTVOL = Method(
    "baselines.snapnet.method:SnapNet",
    "SnapNet, small preset, from true volumes",
    options={"source": "truth"},
    tracks=ALL_TRACKS,
    uses_true_geometry=True,
    learned=True,
    training_data="split train of kit1000, data versions 0.2.1 and 1.0.0",
    weights=weight_paths({"position": "snapnet-gtvol-position", "rotation": "snapnet-gtvol-rotation"}),
    label="SnapNet, true volumes",
    paper_row="snapnet-gtvol",
)
PARTIALVOL = replace(
    GTVOL,
    description="SnapNet, small preset, from one depth image; space hidden behind what it shows is filled in columns",
    options={"source": "depth"},
    uses_true_geometry=False,
    weights=weight_paths({"position": "snapnet-partialvol-position", "rotation": "snapnet-partialvol-rotation"}),
    label="SnapNet, partial volumes",
    paper_row="snapnet-partialvol",
)
COMPLETED = replace(
    PARTIALVOL,
    description="SnapNet, small preset, from one depth image; a network completes parts, columns fill the kits",
    weights=weight_paths({"position": "snapnet-position", "rotation": "snapnet-rotation", "completion": "completion"}),
    label="SnapNet",
    paper_row="snapnet",
)
KITS = replace(
    COMPLETED,
    description="SnapNet, small preset, from one depth image; networks complete parts and kits",
    weights={
        **COMPLETED.weights,
        **weight_paths({"rotation": "snapnet-kits-rotation", "kit_completion": "kit-completion"}),
    },
    label="SnapNet, completed kits",
    paper_row="",
)


def _with_second_pass(method: Method) -> Method:
    return replace(
        method,
        description=f"{method.description}; mean of the rotations around the best candidate, two passes",
        options={**method.options, "peak": "mean", "passes": 2},
        label=f"{method.label}, 2 passes",
        paper_row="",
    )


METHODS = {
    "snapnet": COMPLETED,
    "snapnet-2pass": _with_second_pass(COMPLETED),
    "snapnet-kits": KITS,
    "snapnet-gtvol": GTVOL,
    "snapnet-gtvol-2pass": _with_second_pass(GTVOL),
    "snapnet-partialvol": PARTIALVOL,
}

POSITION_TRAINING = {
    "small": TrainConfig(steps=4_000, batch=2, learning_rate=1e-3, warmup=200, ema_decay=0.999, validate_every=500),
    "paper": TrainConfig(steps=20_000, batch=4, learning_rate=1e-4, decay="none"),
}
ROTATION_TRAINING = {
    "small": TrainConfig(steps=3_000, batch=2, learning_rate=1e-3, warmup=200, ema_decay=0.999, validate_every=1000),
    "paper": TrainConfig(steps=150_000, batch=1, learning_rate=1e-4, decay="none", validate_every=500),
}
POSITION_TASK, ROTATION_TASK = "baselines.snapnet.task:position_task", "baselines.snapnet.task:rotation_task"

NETWORKS = {
    "snapnet-gtvol-position": Network(POSITION_TASK, POSITION_TRAINING, {"source": "truth"}),
    "snapnet-gtvol-rotation": Network(ROTATION_TASK, ROTATION_TRAINING, {"source": "truth"}),
    "snapnet-partialvol-position": Network(POSITION_TASK, POSITION_TRAINING, {"source": "depth"}),
    "snapnet-partialvol-rotation": Network(ROTATION_TASK, ROTATION_TRAINING, {"source": "depth"}),
    "snapnet-position": Network(POSITION_TASK, POSITION_TRAINING, {"source": "depth"}, {"completion": "completion"}),
    "snapnet-rotation": Network(ROTATION_TASK, ROTATION_TRAINING, {"source": "depth"}, {"completion": "completion"}),
    "snapnet-kits-rotation": Network(
        ROTATION_TASK,
        ROTATION_TRAINING,
        {"source": "depth"},
        {"completion": "completion", "kit_completion": "kit-completion"},
    ),
}
