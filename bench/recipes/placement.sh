#!/usr/bin/env bash
# Trains the network that places fits in their plates (docs/methods/placement.md).
#
#     bash bench/recipes/placement.sh [DATA]
#
# Run it in the root of a checkout, where `python` has kit1000[learn]. DATA is a dataset with ground truth, by default
# data/kit1000. The fits of its scenes are made when first needed, some two seconds each, and kept in DATA.fits. They
# come from kit1000/weights: run restoration.sh and completion.sh first to replace those, and delete DATA.fits. `ship`
# replaces the weights in kit1000/weights. The same command resumes an interrupted recipe.
set -euo pipefail

data="${1:-data/kit1000}"
commit="$(git rev-parse HEAD)"

# 900 steps of 32 fits, new weights. Those of the released run were 2218 fits, of guesses within 15 mm and 8 degrees:
# repeated, it gives others.
python -m baselines train placement --data "$data" --out runs/placement
python -m baselines ship runs/placement --commit "$commit" --precision float16
