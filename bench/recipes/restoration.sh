#!/usr/bin/env bash
# Trains the two networks that restore noisy depth images (docs/methods/restoration.md).
#
#     bash bench/recipes/restoration.sh [DATA]
#
# Run it in the root of a checkout, where `python` has kit1000[learn]. DATA is a dataset with ground truth, by default
# data/kit1000. `ship` replaces the weights in kit1000/weights. The same command resumes an interrupted recipe.
set -euo pipefail

data="${1:-data/kit1000}"
commit="$(git rev-parse HEAD)"

# First run of the network with masks: 3500 steps on 1500 views, new weights.
python -m baselines train restoration --preset pretraining --data "$data" --out runs/restoration-first

# Second run: 5000 steps on 3000 other views, from the best weights of the first.
python -m baselines train restoration --data "$data" --out runs/restoration \
    --start runs/restoration-first/best.safetensors
python -m baselines ship runs/restoration --commit "$commit" --precision float16

# The network without masks, for segmentation: 3500 steps on 1500 views, new weights.
python -m baselines train restoration-unmasked --data "$data" --out runs/restoration-unmasked
python -m baselines ship runs/restoration-unmasked --commit "$commit" --precision float16
