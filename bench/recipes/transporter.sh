#!/usr/bin/env bash
# Trains TransporterNet, the scores of position and yaw, height and tilt (docs/methods/transporter.md).
#
#     bash bench/recipes/transporter.sh [DATA]
#
# Run it in the root of a checkout, where `python` has kit1000[learn]. DATA is a dataset with ground truth, by default
# data/kit1000. The height maps of its scenes are rendered when first needed and kept in DATA.heights. `ship` replaces
# the weights in baselines/weights. The same command resumes an interrupted recipe.
set -euo pipefail

data="${1:-data/kit1000}"
commit="$(git rev-parse HEAD)"

# 3500 steps, each of a query without a guess and one with, new weights; the released transporter.
python -m baselines train transporter --data "$data" --out runs/transporter --steps 3500
python -m baselines ship runs/transporter --commit "$commit"
