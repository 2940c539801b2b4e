#!/usr/bin/env bash
# Trains KitNet, the rotation between a part and a cavity (docs/methods/kitnet.md).
#
#     bash bench/recipes/kitnet.sh [DATA]
#
# Run it in the root of a checkout, where `python` has kit1000[learn]. DATA is a dataset with ground truth, by default
# data/kit1000. The height maps of its scenes are rendered when first needed and kept in DATA.heights. `ship` replaces
# the weights in baselines/weights. The same command resumes an interrupted recipe.
set -euo pipefail

data="${1:-data/kit1000}"
commit="$(git rev-parse HEAD)"

# 3000 steps of 32 examples, new weights; the released kitnet.
python -m baselines train kitnet --data "$data" --out runs/kitnet --steps 3000 --batch 32
python -m baselines ship runs/kitnet --commit "$commit"
